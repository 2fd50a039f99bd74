"""``elastoidentify paraview``: start ParaView with the filters of ElastoIdentify in place.

ParaView brings its own Python, numpy and VTK. So nothing of the environment that this runs in is
handed over but the package itself (by a ``sitecustomize`` on PYTHONPATH) and, for registration and
for files, the path of an interpreter that has the packages for them (ELASTOIDENTIFY_PYTHON), which
runs in a process of its own. Further packages for ParaView's Python can be given in
ELASTOIDENTIFY_PARAVIEW_SITE.
"""

import importlib.util
import os
import shlex
import shutil
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from ..errors import InputError
from . import stopping

PROGRAMS = {
    "gui": "paraview",
    "pvpython": "pvpython",
    "pvbatch": "pvbatch",
    "pvserver": "pvserver",
}
USAGE = """usage: elastoidentify paraview
           [gui|sample|pvpython|pvbatch|pvserver|stop|env] [arguments]

  gui       the application (the default); "elastoidentify paraview mesh.vtu" opens a file
  sample    the application with a sample, its stiffness and uncertainty side by side
  pvpython  run a Python script
  pvbatch   run a Python script, also in parallel: mpirun -np 2 elastoidentify paraview pvbatch …
  pvserver  a server for a remote client
  stop      end the runs that are under way in your ParaViews on this machine
  env       print the environment, to put it into ~/.profile for good

ParaView is searched in PARAVIEW_HOME (its folder), then on PATH."""

HERE = Path(__file__).resolve().parent
SITE_VARIABLE = "ELASTOIDENTIFY_PARAVIEW_SITE"
PYTHON_VARIABLE = "ELASTOIDENTIFY_PYTHON"
LENT = ("itk", "SimpleITK")  # packages for which ParaView turns to the launcher's Python


def main(argv: Sequence[str] | None = None) -> int:
    """Become ParaView; returns only with an exit code for usage (0) or for an error (2)."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    if arguments and arguments[0] in ("-h", "--help"):
        print(USAGE)
        return 0
    words = (*PROGRAMS, "sample", "stop", "env")
    what = arguments.pop(0) if arguments and arguments[0] in words else "gui"
    if what == "stop":
        stopping.ask()
        return 0
    if what == "sample":
        what, arguments = "gui", [f"--script={HERE / 'sample.py'}", *arguments]
    try:
        environment = paraview_environment(os.environ)
        if what == "env":
            _print_changes(environment)
            return 0
        program = find_program(PROGRAMS[what], environment)
    except InputError as error:
        print(f"elastoidentify: {error}", file=sys.stderr)
        return 2
    os.execve(program, [program, *arguments], environment)


def find_program(name: str, environment: Mapping[str, str]) -> str:
    """Return the path of a program of ParaView, or raise InputError."""
    home = environment.get("PARAVIEW_HOME")
    folders = [os.path.join(home, "bin"), home] if home else []
    path = os.pathsep.join([*folders, environment.get("PATH", "")])
    program = shutil.which(name, path=path)
    if program is None:
        raise InputError(
            f"{name} is not on PATH: install ParaView (Debian: sudo apt-get install paraview "
            "python3-paraview), or set PARAVIEW_HOME to the folder of a ParaView from paraview.org"
        )
    return program


def paraview_environment(start: Mapping[str, str]) -> dict[str, str]:
    """Return `start` with what ParaView needs to load the plugin.

    Raises
    ------
    InputError
        A folder of packages holds a vtk wheel, which would take the place of ParaView's own VTK.
    """
    extra = _folders(start.get(SITE_VARIABLE))
    before = _folders(start.get("PYTHONPATH"))
    for variable, folders in ((SITE_VARIABLE, extra), ("PYTHONPATH", before)):
        for folder in folders:
            refuse_vtk_wheel(folder, variable)
    environment = dict(start)
    _prepend(environment, "PYTHONPATH", [str(HERE / "shim"), *extra])
    _prepend(environment, "PV_PLUGIN_PATH", [str(HERE / "autoload")])
    if PYTHON_VARIABLE not in environment and any(map(importlib.util.find_spec, LENT)):
        environment[PYTHON_VARIABLE] = sys.executable
    return environment


def refuse_vtk_wheel(folder: str, variable: str):
    """Raise InputError if `folder` has a VTK without ParaView beside it."""
    if os.path.isdir(os.path.join(folder, "vtkmodules")) and not os.path.isdir(
        os.path.join(folder, "paraview")
    ):
        raise InputError(
            f"{folder} in {variable} holds a vtk wheel, which would take the place of ParaView's "
            f"own VTK and crash it: take the folder out of {variable}, or uninstall vtk from it"
        )


def _folders(path: str | None) -> list[str]:
    return [folder for folder in (path or "").split(os.pathsep) if folder]


def _prepend(environment: dict[str, str], variable: str, folders: list[str]):
    """Put folders first on a search path; those that are there already move to the front."""
    rest = [folder for folder in _folders(environment.get(variable)) if folder not in folders]
    environment[variable] = os.pathsep.join([*folders, *rest])


def _print_changes(environment: Mapping[str, str]):
    for name in ("PYTHONPATH", "PV_PLUGIN_PATH", PYTHON_VARIABLE):
        if name in environment:
            print(f"export {name}={shlex.quote(environment[name])}")


if __name__ == "__main__":
    sys.exit(main())
