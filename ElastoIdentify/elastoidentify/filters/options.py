"""The settings of a filter, each declared once.

A declaration such as ::

    class Shrink(Filter):
        factor = Number(0.5, "How much is left of each cell, between 0 and 1.", minimum=0.0)

gives the filter ``SetFactor``, ``GetFactor``, the property ``factor`` and the constructor keyword
``factor``. Hosts that draw a form (the ParaView plugin) read the same declarations.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence

import numpy as np

from ..errors import InputError


def pascal(name: str) -> str:
    """Return ``edge_length`` as ``EdgeLength``."""
    return "".join(word.capitalize() for word in name.split("_"))


class Option:
    """A setting with a default, a check, and a sentence of documentation.

    Parameters
    ----------
    default : object
    doc : str
        What it means, with its unit.
    """

    def __init__(self, default, doc: str):
        self.default, self.__doc__ = default, doc

    def __set_name__(self, owner, name):
        self.name, self.title = name, pascal(name)
        self._slot = f"_option_{name}"
        self._add_method(owner, f"Set{self.title}", lambda filter, value: self.store(filter, value))
        self._add_method(owner, f"Get{self.title}", lambda filter: self.__get__(filter))

    def _add_method(self, owner, name: str, function: Callable):
        function.__name__, function.__qualname__ = name, f"{owner.__qualname__}.{name}"
        function.__doc__ = self.__doc__
        setattr(owner, name, function)

    def __get__(self, filter, owner=None):
        return self if filter is None else vars(filter).get(self._slot, self.default)

    def __set__(self, filter, value):
        getattr(filter, f"Set{self.title}")(value)

    def store(self, filter, value):
        """Check `value` and keep it; the filter runs again only if it is another one."""
        value = self.checked(filter, value)
        if value != self.__get__(filter):
            vars(filter)[self._slot] = value
            filter.Modified()

    def checked(self, filter, value):
        """Return `value` in its proper type, or raise InputError."""
        return value

    def _refuse(self, filter, value, wanted: str):
        raise InputError(f"{filter.GetClassName()}.{self.name} must be {wanted}, not {value!r}")


class Number(Option):
    """A finite number, `minimum` ≤ number ≤ `maximum`; `optional` ones may be None (or NaN)."""

    def __init__(self, default, doc, *, minimum=-np.inf, maximum=np.inf, kind=float):
        super().__init__(default, doc)
        self.minimum, self.maximum, self.kind = minimum, maximum, kind

    def checked(self, filter, value):
        if self.default is None and (value is None or value != value):
            return None
        try:
            number = self.kind(value)
        except (TypeError, ValueError, OverflowError):
            number = np.nan
        if not self.minimum <= number <= self.maximum or number != value or np.isinf(number):
            self._refuse(filter, value, self._wanted())
        return number

    def _wanted(self) -> str:
        what = "a whole number" if self.kind is int else "a finite number"
        bounds = []
        if self.minimum > -np.inf:
            bounds.append(f"at least {self.minimum:g}")
        if self.maximum < np.inf:
            bounds.append(f"at most {self.maximum:g}")
        return " ".join([what, " and ".join(bounds)]).strip()


class Choice(Option):
    """One of a few words. Case does not matter."""

    def __init__(self, default, doc, choices: Sequence[str]):
        super().__init__(default, doc)
        self.choices = tuple(choices)

    def checked(self, filter, value):
        word = str(value).lower()
        if word not in self.choices:
            self._refuse(filter, value, "one of " + ", ".join(map(repr, self.choices)))
        return word


class Flag(Option):
    """On or off."""

    def checked(self, filter, value):
        return bool(value)

    def __set_name__(self, owner, name):
        super().__set_name__(owner, name)
        self._add_method(owner, f"{self.title}On", lambda filter: self.__set__(filter, True))
        self._add_method(owner, f"{self.title}Off", lambda filter: self.__set__(filter, False))


class Text(Option):
    """A word or a path; hosts pass None or "None" for an empty field."""

    def checked(self, filter, value):
        return "" if value in (None, "None") else str(value)


class File(Text):
    """A path of a file to read; ``""``: none. `extensions` without the dot."""

    def __init__(self, doc, *, extensions: str = "", description: str = ""):
        super().__init__("", doc)
        self.extensions, self.description = extensions, description


class Vector(Option):
    """A fixed number of finite numbers, given as one sequence or as so many arguments."""

    def __set_name__(self, owner, name):
        super().__set_name__(owner, name)
        self._add_method(
            owner,
            f"Set{self.title}",
            lambda filter, *value: self.store(filter, value[0] if len(value) == 1 else value),
        )

    def checked(self, filter, value):
        return self._numbers(filter, value, len(self.default))

    def _numbers(self, filter, value, *lengths: int) -> tuple[float, ...]:
        try:
            numbers = tuple(float(number) for number in value)
        except (TypeError, ValueError):
            numbers = ()
        if len(numbers) not in lengths or not np.all(np.isfinite(numbers)):
            wanted = " or ".join(map(str, lengths))
            self._refuse(filter, value, f"{wanted} finite number{'s' * (wanted != '1')}")
        return numbers


class Rows(Vector):
    """A table: any number of rows of numbers.

    ``rigid_labels = Rows("RigidLabel", …)`` gives ``AddRigidLabel(*row)``, ``ClearRigidLabels()``
    and the property, which takes all rows at once.

    Parameters
    ----------
    row : str
        What one row is called, as in ``AddRow``.
    doc : str
    columns : sequence of str
        The columns' names.
    kinds : sequence of type, optional
        float where not given.
    lengths : sequence of int, optional
        Allowed row lengths, where not ``len(columns)``.
    start : sequence, optional
        The row that a host's form begins with.
    """

    def __init__(self, row, doc, columns, *, kinds=None, lengths=None, start=None):
        super().__init__((), doc)
        self.row, self.columns, self.start = row, tuple(columns), start
        self.kinds = tuple(kinds or [float] * len(self.columns))
        self.lengths = tuple(lengths or [len(self.columns)])

    def __set_name__(self, owner, name):
        super().__set_name__(owner, name)
        self._add_method(owner, f"Set{self.title}", lambda filter, rows: self.store(filter, rows))
        self._add_method(owner, f"Add{self.row}", lambda filter, *row: self._append(filter, row))
        self._add_method(owner, f"Clear{self.title}", lambda filter: self.store(filter, ()))

    def _append(self, filter, row):
        one = row[0] if len(row) == 1 and isinstance(row[0], Iterable) else row
        self.store(filter, (*self.__get__(filter), one))

    def checked(self, filter, value):
        if isinstance(value, Mapping):
            value = [(key, *np.atleast_1d(rest)) for key, rest in value.items()]
        return tuple(self._checked_row(filter, row) for row in value or ())

    def _checked_row(self, filter, row):
        row = row if isinstance(row, Iterable) else (row,)
        numbers = self._numbers(filter, row, *self.lengths)
        converted = tuple(kind(number) for number, kind in zip(numbers, self.kinds, strict=False))
        for was, number, column in zip(numbers, converted, self.columns, strict=False):
            if was != number:
                self._refuse(filter, was, f"a whole number in the column {column!r}")
        return converted if len(self.columns) > 1 else converted[0]
