"""A value of every option that is not its default, for tests that follow options through a host."""

from elastoidentify.options import Choice, Flag, Number, Picture
from elastoidentify.study import STEPS

SPECIAL = {
    "rigid_labels": (4, 5),
    "reaction_boxes": ((-5.0, 60.0, 0.0, 20.0), (0.0, 1.0, 2.0, 3.0, 4.0, 5.0)),
    "sliding_labels": (5,),
    "sliding_boxes": ((-5.0, 60.0, 0.0, 20.0),),
    "out_of_plane": (0.004, -0.002),
    "out_of_plane_std": 0.02,
    "slip": ((1, 2), (1, 7)),
    "known_materials": ((1, 5000.0, 0.43), (7, 10.0, 0.3)),
    "parameter_file": "affine",
    "unit": "kPa",
    "cache": "kept",
    "length_unit": "cm",
    "slice_axis": "j",
}


def sample(option):
    """Return an allowed value that is not the default."""
    if option.name in SPECIAL:
        return SPECIAL[option.name]
    if isinstance(option, Flag):
        return not option.default
    if isinstance(option, Choice):
        return next(word for word in option.choices if word != option.default)
    if isinstance(option, Number):
        for value in (4, 3, 0.25, 1):
            try:
                if option.checked(value) not in (option.default, option.own_choice):
                    return option.checked(value)
            except ValueError:
                continue
    raise AssertionError(f"give Testing/option_samples.py a value of {option.name}")


def scalar_options():
    """Return (table, option) of every option but images, through all steps."""
    return [
        (table, option)
        for table in STEPS.values()
        for option in table.options().values()
        if not isinstance(option, Picture)
    ]


def needing():
    """Return the options that say something only with another one."""
    return [option for _, option in scalar_options() if option.needs]


def pictures():
    """Return (table, option) of every option that is an image."""
    return [
        (table, option)
        for table in STEPS.values()
        for option in table.options().values()
        if isinstance(option, Picture)
    ]


def option_id(value):
    """Name a test's parameter by the option."""
    return getattr(value, "name", getattr(value, "__name__", None))
