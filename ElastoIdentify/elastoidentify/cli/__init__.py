"""``elastoidentify``: from images to a stiffness map at a terminal.

Exit code 0: done; 2: bad input or usage, said in one line; 1: anything else. Outputs are written
whole or not at all. What a subcommand needs is imported when it runs.
"""

import os
import sys
from collections.abc import Sequence

from ..errors import Cancelled, InputError
from ..installation import hint
from .parser import make_parser

EXTRAS = {
    "vtkmodules": "vtk",
    "SimpleITK": "registration",
    "itk": "registration",
    "matplotlib": "all",
    "highdicom": "dicom",
    "meshio": "fem",
    "skfem": "all",
}

__all__ = ["main"]


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command line (``sys.argv`` by default) and return its exit code."""
    argv = list(sys.argv[1:] if argv is None else argv)
    _print_anything()
    try:
        if argv[:1] == ["paraview"]:  # its arguments are ParaView's
            from ..paraview.launch import main as launch

            return launch(argv[1:])
        arguments = make_parser().parse_args(argv)
        arguments.command(arguments)
    except SystemExit as stop:  # of argparse: usage or --help
        return stop.code if isinstance(stop.code, int) else 2
    except InputError as error:
        return _say(str(error), 2)
    except ModuleNotFoundError as error:
        extra = EXTRAS.get((error.name or "").split(".")[0])
        if extra is None:
            raise
        return _say(f"{error.name} is missing: {hint(extra)}", 2)
    except (KeyboardInterrupt, Cancelled):
        return _say("cancelled, nothing was written", 1)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except Exception as error:
        if os.environ.get("ELASTOIDENTIFY_TRACEBACK"):
            raise
        return _say(
            f"unexpected {type(error).__name__}: {error} (ELASTOIDENTIFY_TRACEBACK=1 shows where)",
            1,
        )
    return 0


def _print_anything() -> None:
    """Let a terminal without Greek letters show question marks, not stop the work."""
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="replace")


def _say(message: str, code: int) -> int:
    """Print one line on standard error and return the exit code."""
    print("elastoidentify:", " ".join(message.split()), file=sys.stderr)
    return code
