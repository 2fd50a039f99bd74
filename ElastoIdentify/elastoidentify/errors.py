"""The two ways in which work stops early."""


class InputError(ValueError):
    """The input cannot be used.

    The message is one line that says what is wrong, where, and how to mend it. Hosts show it as it
    is: the command line prints it and exits with 2, a VTK filter shows it as one error line; 3D
    Slicer puts it into the user's language.
    """


class Cancelled(Exception):
    """The user cancelled. Raised by a progress callback, and passed through by everything else."""
