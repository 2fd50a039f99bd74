"""How the options of a table become a VTK filter's settings.

``factor = Number(…)`` gives the filter ``SetFactor``, ``GetFactor``, the property ``factor`` and
the constructor keyword ``factor``; a flag ``FactorOn`` and ``FactorOff``; rows ``AddRow`` and
``ClearFactors``.
"""

from collections.abc import Callable, Iterable

from ..errors import InputError
from ..options import Flag, Option, Picture, Rows, Vector


def add_settings(filter_class: type, options: dict[str, Option]) -> None:
    """Give a filter class the methods of its options; images come through ports instead."""
    for name, option in options.items():
        if isinstance(option, Picture):
            continue
        setattr(filter_class, name, option)
        for method, function in _methods(option).items():
            _add(filter_class, method, function, option)


def _methods(option: Option) -> dict[str, Callable]:
    name, title = option.name, option.title

    def store(filter, value):
        setattr(filter, name, value)

    def store_all(filter, *values):
        setattr(filter, name, values[0] if len(values) == 1 else values)

    several = isinstance(option, Vector) and not isinstance(option, Rows)
    found = {
        f"Set{title}": store_all if several else store,
        f"Get{title}": lambda f: getattr(f, name),
    }
    if isinstance(option, Flag):
        found |= {f"{title}On": lambda f: store(f, True), f"{title}Off": lambda f: store(f, False)}
    if isinstance(option, Rows):

        def append(filter, *row):
            one = row[0] if len(row) == 1 and isinstance(row[0], Iterable) else row
            store(filter, (*getattr(filter, name), one))

        found |= {f"Add{option.row}": append, f"Clear{title}": lambda f: store(f, ())}
    return found


def _add(owner: type, name: str, function: Callable, option: Option) -> None:
    appends = isinstance(option, Rows) and name.startswith("Add")

    def method(self, *values):
        if not self.refusals_wait:
            return function(self, *values)
        if not appends:
            self._refused.pop(option.name, None)
        try:
            return function(self, *values)
        except InputError as error:
            self._refused.setdefault(option.name, error)
            self.Modified()  # runs again, and fails with this

    method.__name__, method.__qualname__ = name, f"{owner.__qualname__}.{name}"
    method.__doc__ = option.__doc__
    setattr(owner, name, method)
