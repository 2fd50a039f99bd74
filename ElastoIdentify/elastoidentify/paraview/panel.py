"""The form that ParaView draws for a filter, written from the filter's own declarations.

ParaView wants an XML description of every property. All that it has to say (name, type, default,
range, documentation) is declared with the filter's options and ports already, so it is derived
here and never written twice.
"""

from collections.abc import Iterable, Mapping, Sequence
from xml.sax.saxutils import escape, quoteattr

from ..filters.base import Filter, Port
from ..options import Choice, File, Flag, Number, Option, Rows, Text, Vector, pascal

IDLE = {"slice_index": ("SliceAxis", "none"), "refine": ("Method", "sequential")}
"""Option → property and its value with which the option says nothing."""


def documentation(filter_class: type[Filter]) -> str:
    """Return the proxy's documentation: the first sentence of the docstring, and all of it."""
    text = filter_class.__doc__.replace("``", "").replace(":meth:", "")
    paragraphs = [" ".join(part.split()) for part in text.split("\n\n")]
    short, whole = quoteattr(paragraphs[0]), "\n\n".join(paragraphs)
    return (
        f"<Documentation short_help={short} long_help={short}>{escape(whole)}</Documentation>"
        if whole
        else ""
    )


def inputs(filter_class: type[Filter], array_domains: Mapping[str, str] | None = None) -> str:
    """Return an InputProperty per port. `array_domains`: port name → further domains (XML)."""
    single = len(filter_class.ports) == 1
    return "".join(
        _input(number, port, "Input" if single else _title(port.name), array_domains or {})
        for number, port in enumerate(filter_class.ports)
    )


def _input(number: int, port: Port, name: str, array_domains) -> str:
    if port.repeatable:  # ParaView's usual RemoveAllInputs would disconnect port 0 as well
        command = f'command="AddInputConnection" clean_command="Clear{name}" multiple_input="1"'
    else:
        command = 'command="SetInputConnection"'
    return f"""
    <InputProperty name="{name}" label="{_label(name)}" port_index="{number}" {command}>
      <ProxyGroupDomain name="groups"><Group name="sources"/><Group name="filters"/>
      </ProxyGroupDomain>
      <DataTypeDomain name="input_type" composite_data_supported="{int(number == 0)}">
        <DataType value="{port.data_type}"/>
      </DataTypeDomain>
      {array_domains.get(port.name, "")}
    </InputProperty>"""


def outputs(*names: str) -> str:
    """Return an OutputPort per name, for filters with several."""
    return "".join(
        f'<OutputPort name="{name}" index="{number}"/>' for number, name in enumerate(names)
    )


def settings(filter_class: type[Filter], special: Mapping[str, str] | None = None) -> str:
    """Return a property per option, in order, under the headings of their groups.

    `special`: option → XML to take instead.
    """
    special = special or {}
    options = filter_class.options()
    properties = [
        special[name] if name in special else _PROPERTIES[_kind(option)](option)
        for name, option in options.items()
    ]
    return "".join([*properties, *_groups(options.values())])


def _groups(options: Iterable[Option]) -> list[str]:
    """Return a heading per group; one that has only options for the advanced hides with them."""
    groups = {}
    for option in options:
        if option.group:
            groups.setdefault(option.group, []).append(option)
    return [
        f"<PropertyGroup label={quoteattr(label)}{_visibility(members)}>"
        + "".join(f'<Property name="{option.title}"/>' for option in members)
        + "</PropertyGroup>"
        for label, members in groups.items()
    ]


def _visibility(options: Iterable[Option]) -> str:
    return ' panel_visibility="advanced"' if all(one.advanced for one in options) else ""


def array_selection(name: str, command: str, text: str, icon: str = "point") -> str:
    """Return a list with check boxes that the filter fills (a vtkDataArraySelection)."""
    selection = 'si_class="vtkSIDataArraySelectionProperty"'
    return f"""
    <StringVectorProperty name="{name}Info" command="{command}" information_only="1"
        number_of_elements_per_command="2" {selection}/>
    <StringVectorProperty name="{name}" label="{_label(name)}" command="{command}"
        information_property="{name}Info" number_of_elements_per_command="2" element_types="2 0"
        repeat_command="1" {selection}>
      <ArraySelectionDomain name="array_list">
        <RequiredProperties><Property function="ArrayList" name="{name}Info"/></RequiredProperties>
      </ArraySelectionDomain>
      {_text(text)}
      <Hints><ArraySelectionWidget icon_type="{icon}"/></Hints>
    </StringVectorProperty>"""


def file_names(option: File) -> str:
    """Return the property of a reader's files, which `File ▸ Open` fills."""
    return f"""
    <StringVectorProperty name="{option.title}" label="{_label(option.title)}"
        command="Add{option.title.removesuffix("s")}" clean_command="Clear{option.title}"
        repeat_command="1" number_of_elements="0" number_of_elements_per_command="1">
      <FileListDomain name="files"/>
      {_text(option.__doc__)}
    </StringVectorProperty>
    <DoubleVectorProperty name="TimestepValues" command="GetTimestepValues" information_only="1"
        repeatable="1" si_class="vtkSITimeStepsProperty"/>"""


def target(option: File) -> str:
    """Return the property of a writer's file, which `File ▸ Save Data` fills."""
    return f"""
    <StringVectorProperty name="{option.title}" command="Set{option.title}"
        number_of_elements="1" default_values="" panel_visibility="never">
      <FileListDomain name="files"/>
      {_text(option.__doc__)}
    </StringVectorProperty>"""


def opens(description: str, *, extensions: Sequence[str] = (), folders: bool = False) -> str:
    """Return the hint that puts a source among the readers of `File ▸ Open`."""
    what = (
        'is_directory="1" filename_patterns="*"'
        if folders
        else (f'extensions="{" ".join(extensions)}"')
    )
    return f'<ReaderFactory file_description="{description}" {what}/>'


def box_widget(corner: Vector, size: Vector, hints: str) -> str:
    """Return the group that lets a box be drawn with the mouse.

    With position and scale alone, and no input, ParaView's widget is relative to the unit box: they
    are the box's first corner and the lengths of its edges.
    """
    return f"""
    <PropertyGroup label="Box" panel_widget="InteractiveBox">
      <Property function="Position" name="{corner.title}"/>
      <Property function="Scale" name="{size.title}"/>
      {_hints(hints)}
    </PropertyGroup>"""


def last_error() -> str:
    """Return the property by which a script on a client reads the last failure."""
    return """
    <StringVectorProperty name="LastError" command="GetLastError" information_only="1"
        number_of_elements="1" default_values="" panel_visibility="advanced">
      <SimpleStringInformationHelper/>
      <Documentation>The last run's failure in one line; empty if it went well.</Documentation>
    </StringVectorProperty>"""


def report() -> str:
    """Return the property that shows in the panel what the last run has to say."""
    return """
    <StringVectorProperty name="Report" command="GetReport" information_only="1"
        number_of_elements="1" default_values="" panel_visibility="default">
      <SimpleStringInformationHelper/>
      <Documentation>How the last run was made, what it found, and how far to trust it.
      </Documentation>
      <Hints><Widget type="multi_line"/></Hints>
    </StringVectorProperty>"""


def array_name(option: Text, input_name: str, domain: str) -> str:
    """Return a list of the input's arrays to choose from; "None" leaves the choice to the filter.

    `domain`: the input's InputArrayDomain.
    """
    return f"""
    <StringVectorProperty {_head(option)} number_of_elements="1" default_values="None">
      <ArrayListDomain name="array_list" input_domain_name="{domain}" none_string="None">
        <RequiredProperties><Property function="Input" name="{input_name}"/></RequiredProperties>
      </ArrayListDomain>
      {_text(option.__doc__)}
    </StringVectorProperty>"""


def shown_if(property_name: str, value: str, inverse: bool = False) -> str:
    """Return the hint that hides a property unless another one has a value (`inverse`: has not)."""
    return (
        '<PropertyWidgetDecorator type="GenericDecorator" mode="visibility" '
        f'property="{property_name}" value="{value}" inverse="{int(inverse)}"/>'
    )


# ---- one function per kind of option


def _number(option: Number) -> str:
    kind = "Int" if option.kind is int else "Double"
    start = option.default if option.form_start is None else option.form_start
    hints = shown_if(pascal(option.needs[0]), option.needs[1]) if option.needs else ""
    if option.name in IDLE:
        hints = shown_if(*IDLE[option.name], inverse=True)
    bounds = "".join(
        f' {name}="{bound:g}"'
        for name, bound in (("min", option.minimum), ("max", option.maximum))
        if abs(bound) < float("inf")
    )
    return f"""
    <{kind}VectorProperty {_head(option)} number_of_elements="1" default_values="{start}">
      <{kind}RangeDomain name="range"{bounds}/>
      {_text(option.__doc__)}{_hints(hints)}
    </{kind}VectorProperty>"""


def _choice(option: Choice) -> str:
    words = "".join(f'<String value="{word}"/>' for word in option.choices)
    return f"""
    <StringVectorProperty {_head(option)} number_of_elements="1" default_values="{option.default}">
      <StringListDomain name="list">{words}</StringListDomain>
      {_text(option.__doc__)}
    </StringVectorProperty>"""


def _flag(option: Flag) -> str:
    start = int(option.default)
    return f"""
    <IntVectorProperty {_head(option)} number_of_elements="1" default_values="{start}">
      <BooleanDomain name="bool"/>
      {_text(option.__doc__)}
    </IntVectorProperty>"""


def _word(option: Text) -> str:
    return f"""
    <StringVectorProperty {_head(option)} number_of_elements="1" default_values="{option.default}">
      {_text(option.__doc__)}
    </StringVectorProperty>"""


def _file(option: File) -> str:
    chooser = (
        f'<FileChooser extensions="{option.extensions}" file_description="{option.description}"/>'
    )
    return f"""
    <StringVectorProperty {_head(option)} number_of_elements="1" default_values="">
      <FileListDomain name="files"/>
      {_text(option.__doc__)}{_hints(chooser)}
    </StringVectorProperty>"""


def _vector(option: Vector) -> str:
    start = " ".join(map(str, option.default))
    return f"""
    <DoubleVectorProperty {_head(option)} number_of_elements="{len(option.default)}"
        default_values="{start}">
      <DoubleRangeDomain name="range"/>
      {_text(option.__doc__)}
    </DoubleVectorProperty>"""


def _rows(option: Rows) -> str:
    """Return an editable table; all its columns are numbers, the filter checks whole ones."""
    n = len(option.columns)
    labels = "".join(
        f'<ComponentLabel component="{i}" label={quoteattr(column)}/>'
        for i, column in enumerate(option.columns)
    )
    return f"""
    <DoubleVectorProperty {_name(option)}
        command="Add{option.row}" clean_command="Clear{option.title}"
        repeat_command="1" number_of_elements_per_command="{n}">
      <DoubleRangeDomain name="range"/>
      {_text(option.__doc__)}
      {_hints(f"<ShowComponentLabels>{labels}</ShowComponentLabels><AllowRestoreDefaults/>")}
    </DoubleVectorProperty>"""


_PROPERTIES = {
    Number: _number,
    Choice: _choice,
    Flag: _flag,
    File: _file,
    Text: _word,
    Rows: _rows,
    Vector: _vector,
}


def _kind(option: Option) -> type:
    return next(kind for kind in type(option).__mro__ if kind in _PROPERTIES)


def _head(option: Option) -> str:
    return f'{_name(option)} command="Set{option.title}"'


def _name(option: Option) -> str:
    return f'name="{option.title}" label="{_label(option.title)}"{_visibility([option])}'


def _label(title: str) -> str:
    """Return ``EdgeLength`` as ``Edge Length``: Python in ParaView takes the blanks out again."""
    return "".join(f" {c}" if c.isupper() else c for c in title).strip()


def _title(name: str) -> str:
    return "".join(word.capitalize() for word in name.split())


def _text(text: str) -> str:
    return f"<Documentation>{escape(' '.join(text.split()))}</Documentation>"


def _hints(hints: str) -> str:
    return f"<Hints>{hints}</Hints>" if hints else ""
