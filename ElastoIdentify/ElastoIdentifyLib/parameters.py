"""The parameter node's fields and the widgets of *Advanced*, from the table of options."""

from typing import Annotated

import qt
from elastoidentify.errors import InputError
from elastoidentify.options import Choice, File, Flag, Number, Option, Picture, Rows, Text
from elastoidentify.study import STEPS
from slicer.parameterNodeWrapper import Choice as OneOf
from slicer.parameterNodeWrapper import WithinRange

from .translation import translated

OF_NODES = ("known_materials", "rigid_labels", "reaction_boxes", "slice_axis", "sliding_boxes")
"""Options that Slicer gives otherwise: materials by segment, boxes by ROIs, the slice by a view."""

LIMIT = 1e9  # of numbers that the table does not bound: a spin box needs some
NEARLY = 1e-3


def options() -> dict[str, Option]:
    """Return the options that are fields of the parameter node, by their names in the table."""
    every = {k: v for table in STEPS.values() for k, v in table.options().items()}
    return {
        name: option
        for name, option in every.items()
        if not isinstance(option, Picture) and name not in OF_NODES
    }


def field(name: str) -> str:
    """Return ``edge_length`` as ``edgeLength``."""
    first, *rest = name.split("_")
    return first + "".join(word.capitalize() for word in rest)


def annotations(defaults: dict) -> dict:
    """Return {field: type} of all options; their defaults are put into `defaults`."""
    found = {}
    for name, option in options().items():
        start = option.default if option.form_start is None else option.form_start
        defaults[field(name)] = in_field(option, start)
        found[field(name)] = _type(option)
    return found


def _type(option: Option):
    if isinstance(option, Choice):
        return Annotated[str, OneOf(list(option.choices))]
    if isinstance(option, Number):
        return Annotated[option.kind, WithinRange(*bounds(option))]
    return {Flag: bool, File: str, Text: str, Rows: str}[type(option)]


def in_field(option: Option, value):
    """Return a value as the parameter node holds it: rows are a line of text, ``1:2, 1:3``."""
    if not isinstance(option, Rows) or isinstance(value, str):
        return value
    rows = [row if isinstance(row, tuple) else (row,) for row in value]
    return ", ".join(":".join(f"{one:g}" for one in row) for row in rows)


def bounds(option: Number) -> tuple:
    """Return the least and the largest value of a number, as a spin box has them."""
    low = max(option.minimum, option.above + NEARLY, -LIMIT)
    high = min(option.maximum, option.below - NEARLY, LIMIT)
    return option.kind(low), option.kind(high)


def chosen(node) -> dict:
    """Return {name in the table: value} of a parameter node."""
    return {name: getattr(node, field(name)) for name in options()}


def rows_of_text(text: str, option: Rows, names: dict[int, str]) -> tuple:
    """Return the rows that a line of text stands for: ``Pad:Tissue, Pad:Lesion``; ``0.01, 0.02``.

    Parameters
    ----------
    names : {label: name of the segment}
        In columns of labels; the label itself will do, too.

    Raises
    ------
    InputError
    """
    labels, rows = {name: number for number, name in names.items()}, []
    if option.kinds == (float,):  # names have blanks in them, numbers have not
        text = ",".join(text.replace(",", " ").split())
    for row in filter(None, (part.strip() for part in text.split(","))):
        words = [word.strip() for word in row.split(":")]
        if len(words) != len(option.kinds):
            example = ":".join(["Pad", "Tissue"][: len(option.kinds)])
            raise InputError(
                f"{label(option)}: {row!r} is not of the form {example}, with commas between"
            )
        rows.append(
            tuple(
                labels[word] if kind is int and word in labels else _number(kind, word, option)
                for kind, word in zip(option.kinds, words, strict=True)
            )
        )
    return tuple(rows)


def _number(kind: type, word: str, option: Rows):
    try:
        return kind(word)
    except ValueError:
        what = "segment" if kind is int else "number"
        raise InputError(f"{label(option)}: there is no {what} {word!r}") from None


# ---- widgets


def add_widgets(layout, ui, tr) -> dict:
    """Add a row for every option that the panel's own form leaves out.

    Parameters
    ----------
    layout : QFormLayout
    ui : object
        The panel's widgets by name; options that are there already get no second one.
    tr : callable
        Translates texts.

    Returns
    -------
    {name of the widget: widget}
    """
    made = {}
    for name, option in options().items():
        if any(hasattr(ui, f"{field(name)}{kind}") for kind in _KINDS):
            continue
        widget = _widget(option, tr)
        widget.objectName = f"{field(name)}Option"
        widget.setProperty("SlicerParameterName", field(name))
        widget.toolTip = translated(option.__doc__)
        layout.addRow(f"{tr(label(option))}:", widget)
        made[widget.objectName] = widget
    return made


_KINDS = ("ComboBox", "SpinBox", "CheckBox", "Edit")


def enable_what_is_used(ui, node) -> None:
    """Switch off the widgets of options that say nothing beside the parameter node's others."""
    for name, option in options().items():
        if option.needs:
            used = getattr(node, field(option.needs[0])) == option.needs[1]
            for kind in (*_KINDS, "Option"):
                if hasattr(ui, f"{field(name)}{kind}"):
                    getattr(ui, f"{field(name)}{kind}").enabled = used


def label(option: Option) -> str:
    """Return the words before a widget, with the unit: ``Edge length (mm)``."""
    unit = {"length": " (mm)"}.get(option.unit, f" ({option.unit})" if option.unit else "")
    return option.name.replace("_", " ").capitalize() + unit


def _widget(option: Option, tr):
    if isinstance(option, Choice):
        widget = qt.QComboBox()
        widget.addItems(list(option.choices))
    elif isinstance(option, Flag):
        widget = qt.QCheckBox()
    elif isinstance(option, Number):
        widget = qt.QSpinBox() if option.kind is int else qt.QDoubleSpinBox()
        low, high = bounds(option)
        widget.setRange(*(low, min(high, 2**31 - 1)) if option.kind is int else (low, high))
        if option.kind is float:
            widget.setDecimals(4)
        if option.own_choice == low:
            widget.specialValueText = tr("automatic")
    else:
        widget = qt.QLineEdit()
    return widget
