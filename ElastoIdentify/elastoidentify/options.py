"""Kinds of options: what a value may be, its default, and the sentence that explains it.

A table of options is a class whose attributes declare them::

    class Shrink(Table):
        factor = Number(0.5, "How much is left of each cell.", minimum=0.0)

    Shrink(factor=0.3).factor      # 0.3; Shrink(factor=-1) raises InputError

Command line, VTK filters, ParaView's panel, Slicer's parameter node and the page of options are
made from the tables in :mod:`elastoidentify.study`, so that an option is declared once. Only the
standard library is used: ``--help`` need not wait for numpy.
"""

import difflib
import math
import numbers
import os
from collections.abc import Iterable, Mapping, Sequence

from .errors import InputError


def pascal(name: str) -> str:
    """Return ``edge_length`` as ``EdgeLength``."""
    return "".join(word.capitalize() for word in name.split("_"))


class Option:
    """One option.

    Parameters
    ----------
    default : object
    doc : str
        What it means, in a sentence or two.
    unit : str
        Unit of the value, for people; ``length`` and ``modulus`` stand for the study's own.
    group : str
        Heading under which forms and pages show it.
    advanced : bool
        Forms hide it until asked.
    flags : sequence of str
        Names on the command line; by default ``--edge-length`` of ``edge_length``.
    metavar : str
        What the command line calls its value.
    keyword : str
        Parameter of the library function that takes it, where it is called otherwise there; ""
        where no library function takes it.
    own_choice : object
        The value that leaves the choice to the library (it gets None).
    required : bool
        There is no sensible default: the command line wants it said.
    needs : (str, object), optional
        Another option and its value, without which this one says nothing: forms hide it then, the
        library does not get it, and :func:`unused` says so.
    form_start : object
        What a form begins with where the default is None.
    """

    def __init__(
        self, default, doc, *, unit="", group="", advanced=False, flags=(), metavar=None,
        keyword=None, own_choice=None, required=False, needs=None, form_start=None,
    ):  # fmt: skip
        self.default, self.__doc__ = default, doc
        self.unit, self.group, self.advanced, self.required = unit, group, advanced, required
        self._flags, self.metavar, self._keyword = tuple(flags), metavar, keyword
        self.own_choice, self.needs, self.form_start = own_choice, needs, form_start

    def __set_name__(self, owner, name):
        self.name, self.title = name, pascal(name)

    @property
    def flags(self) -> tuple[str, ...]:
        return self._flags or ("--" + self.name.replace("_", "-"),)

    @property
    def keyword(self) -> str:
        return self.name if self._keyword is None else self._keyword

    def __get__(self, holder, owner=None):
        return self if holder is None else vars(holder).get(f"_option_{self.name}", self.default)

    def __set__(self, holder, value):
        value = self.checked(value, type(holder).__name__)
        if not self.is_same(value, self.__get__(holder)):
            vars(holder)[f"_option_{self.name}"] = value
            changed = getattr(holder, "Modified", None)  # a VTK filter runs again
            if changed is not None:
                changed()

    def checked(self, value, where: str = ""):
        """Return `value` in its proper type, or raise InputError that names `where`."""
        return value

    def is_same(self, first, second) -> bool:
        """Tell whether a new value changes nothing."""
        return type(first) is type(second) and bool(first == second)

    def argument(self, holder):
        """Return the value of `holder` as the library takes it: None where it may choose."""
        if self.needs is not None and getattr(holder, self.needs[0]) != self.needs[1]:
            return None
        value = self.__get__(holder)
        return None if self.own_choice is not None and value == self.own_choice else value

    def wanted(self) -> str:
        """Say which values are allowed, to follow «must be»."""
        return "something else"

    def refuse(self, value, where: str, wanted: str = ""):
        """Raise InputError."""
        name = f"{where}.{self.name}" if where else self.name
        raise InputError(f"{name} must be {wanted or self.wanted()}, not {_shown(value)}")


def _shown(value) -> str:
    """Return any value in one short line."""
    line = " ".join(repr(value).split())
    return line if len(line) <= 80 else f"{line[:77]}…"


class Number(Option):
    """A finite number, `minimum` ≤ number ≤ `maximum` (`above` < number < `below`).

    With a default of None it may be None (or NaN).
    """

    def __init__(
        self, default, doc, *, minimum=-math.inf, maximum=math.inf, above=-math.inf,
        below=math.inf, kind=float, **more,
    ):  # fmt: skip
        super().__init__(default, doc, **more)
        self.minimum, self.maximum, self.kind = minimum, maximum, kind
        self.above, self.below = above, below

    def checked(self, value, where=""):
        if self.default is None and (value is None or _is_nan(value)):
            return None
        if self.own_choice is not None and value is None:
            return self.own_choice
        number = _number(self.kind, value)
        inside = self.minimum <= number <= self.maximum and self.above < number < self.below
        if not (inside or number == self.own_choice) or _is_other(number, value):
            self.refuse(value, where)
        return number

    def wanted(self):
        what = "a whole number" if self.kind is int else "a finite number"
        words = [
            f"{word} {bound:g}"
            for word, bound in (
                ("at least", self.minimum),
                ("above", self.above),
                ("at most", self.maximum),
                ("below", self.below),
            )
            if math.isfinite(bound)
        ]
        return " ".join([what, " and ".join(words)]).strip()


def _number(kind: type, value):
    """Return one number of the kind, NaN where the value is not one; text is read."""
    if getattr(value, "shape", ()) or isinstance(value, bytes):
        return math.nan
    try:
        return kind(value)
    except (TypeError, ValueError, OverflowError):
        return math.nan


def _is_nan(value) -> bool:
    return isinstance(value, numbers.Real) and math.isnan(value)


def _is_other(number, value) -> bool:
    """Tell whether a conversion has changed the value, as 1.5 to a whole number; text is read."""
    return math.isinf(number) or not (isinstance(value, str) or number == value)


class Choice(Option):
    """One of a few words. Case does not matter."""

    def __init__(self, default, doc, choices: Sequence[str], **more):
        super().__init__(default, doc, **more)
        self.choices = tuple(choices)

    def checked(self, value, where=""):
        word = str(value).lower() if isinstance(value, str) else ""
        if word not in self.choices:
            self.refuse(value, where)
        return word

    def wanted(self):
        return "one of " + ", ".join(map(repr, self.choices))


class Flag(Option):
    """On or off. `off_flag`: the command line's word that switches it off."""

    def __init__(self, default, doc, *, off_flag: str = "", **more):
        super().__init__(default, doc, **more)
        self.off_flag = off_flag

    @property
    def flags(self):
        if not self.default:
            return super().flags
        return (self.off_flag or "--no-" + self.name.replace("_", "-"),)

    def checked(self, value, where=""):
        if getattr(value, "shape", ()) or value not in (0, 1):
            self.refuse(value, where)  # the word "no" would be true
        return bool(value)

    def wanted(self):
        return "True or False"


class Text(Option):
    """A line of text; hosts pass None or "None" for an empty field."""

    def checked(self, value, where=""):
        if value is None:
            return ""
        if not isinstance(value, str | os.PathLike) or not str(value).isprintable():
            self.refuse(value, where)
        return "" if value == "None" else str(value)

    def wanted(self):
        return "a line of text"


class File(Text):
    """A path of a file to read, or several; ``""``: none. `extensions` without the dot."""

    def __init__(self, doc, *, extensions: str = "", description: str = "", **more):
        super().__init__("", doc, own_choice="", **more)
        self.extensions, self.description = extensions, description

    def checked(self, value, where=""):
        if isinstance(value, (list, tuple)):
            paths = tuple(path for path in map(super().checked, value) if path)
            return paths if len(paths) > 1 else "".join(paths)
        return super().checked(value)


class Picture(Option):
    """An image, or several of them (`repeatable`); :class:`~elastoidentify.imaging.image.Image`.

    Each host has its own way to give one: a file, a pipeline's input, a volume of the scene.
    """

    def __init__(self, doc, *, repeatable=False, optional=False, **more):
        super().__init__(() if repeatable else None, doc, **more)
        self.repeatable, self.optional = repeatable, optional

    def checked(self, value, where=""):
        return tuple(value or ()) if self.repeatable else value

    def is_same(self, first, second):
        return first is second  # voxels are not compared


def _entries(value) -> tuple:
    """Return what is in a list or array; what is neither is one entry."""
    if isinstance(value, str | bytes) or not isinstance(value, Iterable):
        return (value,)
    return tuple(value) if getattr(value, "shape", True) else (value,)


class Vector(Option):
    """A fixed number of finite numbers."""

    def checked(self, value, where=""):
        return self._numbers(value, where, len(self.default))

    def _numbers(self, value, where: str, *lengths: int) -> tuple[float, ...]:
        row = tuple(_number(float, one) for one in _entries(value))
        if len(row) not in lengths or not all(map(math.isfinite, row)):
            wanted = " or ".join(map(str, lengths))
            self.refuse(value, where, f"{wanted} finite number{'s' * (wanted != '1')}")
        return row


class Rows(Vector):
    """A table: any number of rows of numbers.

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
    check_row : callable, optional
        Raises InputError for a row that makes no sense.
    unique : bool
        The first column names what the row is about: no two rows may have the same.
    """

    def __init__(
        self, row, doc, columns, *, kinds=None, lengths=None, check_row=None, unique=False, **more
    ):
        super().__init__((), doc, **more)
        self.row, self.columns, self.check_row, self.unique = row, tuple(columns), check_row, unique
        self.kinds = tuple(kinds or [float] * len(self.columns))
        self.lengths = tuple(lengths or [len(self.columns)])

    def checked(self, value, where=""):
        if isinstance(value, Mapping):
            value = [(key, *_entries(entry)) for key, entry in value.items()]
        rows = () if value is None else _entries(value)
        rows = tuple(self._checked_row(row, where) for row in rows)
        if self.unique:
            firsts = [row[0] if isinstance(row, tuple) else row for row in rows]
            twice = next((one for n, one in enumerate(firsts) if one in firsts[:n]), None)
            if twice is not None:
                name = f"{where}.{self.name}" if where else self.name
                raise InputError(f"{name} says two things of {self.columns[0]} {twice:g}: say one")
        return rows

    def _checked_row(self, row, where):
        row = self._numbers(row, where, *self.lengths)
        converted = tuple(kind(number) for number, kind in zip(row, self.kinds, strict=False))
        for was, number, column in zip(row, converted, self.columns, strict=False):
            if was != number:
                self.refuse(was, where, f"a whole number in the column {column!r}")
        if self.check_row is not None:
            self.check_row(*converted)
        return converted if len(self.columns) > 1 else converted[0]


class Table:
    """Values of a table of options; the class declares them, an instance holds them.

    Parameters
    ----------
    **values
        Options by name; the others keep their default.

    Raises
    ------
    InputError
        A name that there is not (the nearest one is said), or a value that is not allowed.
    """

    def __init__(self, **values):
        for name, value in values.items():
            if name not in self.options():
                raise InputError(f"{type(self).__name__} has no option {unknown(name, self)}")
            setattr(self, name, value)

    @classmethod
    def options(cls) -> dict[str, Option]:
        """Return the options by name, in the order of declaration."""
        return options_of(cls)

    def values(self) -> dict:
        """Return every option's value by name."""
        return {name: getattr(self, name) for name in self.options()}

    def __repr__(self):
        said = ", ".join(f"{k}={v!r}" for k, v in self.values().items())
        return f"{type(self).__name__}({said})"


def options_of(cls: type) -> dict[str, Option]:
    """Return the options that a class declares or inherits, bases first."""
    found = {}
    for base in reversed(cls.__mro__):
        found.update({k: v for k, v in vars(base).items() if isinstance(v, Option)})
    return found


def unknown(name: str, holder) -> str:
    """Return an unknown name with the nearest one that there is."""
    near = difflib.get_close_matches(name, holder.options(), n=1)
    hint = f"; did you mean {near[0]!r}?" if near else f"; it has {', '.join(holder.options())}"
    return f"{name!r}{hint}"


def only_with(name: str, other: str, value) -> str:
    """Say what an option needs to mean anything; every host calls the two by its own names."""
    return f"{name} says something only with {other} {value}"


def unused(holder, table: type[Table]) -> list[str]:
    """Say which options of a table were given and are not used, a sentence each.

    What a form begins with was not given.
    """
    return [
        f"{only_with(name, *option.needs)}: {_shown(option.__get__(holder))} was not used"
        for name, option in table.options().items()
        if option.needs
        and getattr(holder, option.needs[0]) != option.needs[1]
        and option.__get__(holder) not in (option.default, option.form_start)
    ]


def keywords(holder, table: type[Table]) -> dict:
    """Return the values of `holder` for a table's library function, by its parameters' names.

    `holder` may be any object that has the options: a study, or a filter.
    """
    return {
        option.keyword: option.argument(holder)
        for option in table.options().values()
        if option.keyword and not isinstance(option, Picture)
    }
