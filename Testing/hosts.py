"""What the tests need of the machine: find it, or say what is missing and how to get it."""

import os
import shutil

import pytest

APT_PARAVIEW = "sudo apt-get install paraview python3-paraview xvfb imagemagick libqt5svg5"


def host_missing(reason: str, command: str):
    """Skip the test, or fail it where ELASTOIDENTIFY_REQUIRE_HOSTS=1 asks for every host.

    Parameters
    ----------
    reason : str
        What this machine lacks.
    command : str
        What the user can type to get it.
    """
    message = f"{reason}. To enable: {command}"
    if os.environ.get("ELASTOIDENTIFY_REQUIRE_HOSTS") == "1":
        pytest.fail(message, pytrace=False)
    pytest.skip(message)


def program(name: str, command: str = APT_PARAVIEW) -> str:
    """Return the path of a program; where it is missing, the test is skipped or fails."""
    path = shutil.which(name)
    if path is None:
        host_missing(f"{name} is not installed", command)
    return path


def has_elastix() -> bool:
    """Tell whether an interpreter with itk-elastix is found."""
    from elastoidentify.errors import InputError
    from elastoidentify.workers.elastix_client import find_interpreter

    try:
        find_interpreter()
    except InputError:
        return False
    return True
