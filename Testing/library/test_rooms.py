"""One direction of dependence: which rooms may import which, and who may import VTK."""

import ast
from pathlib import Path

import pytest

PACKAGE = Path(__file__).resolve().parents[2] / "ElastoIdentify" / "elastoidentify"

FLOORS = [
    ["errors", "progress", "installation", "results"],
    ["options"],
    ["study"],
    ["fem", "linalg"],
    ["inverse"],
    ["workers"],
    ["imaging"],
    ["exploration", "provenance"],
    ["pipeline"],
    ["planning"],
    ["report"],
    ["vtk_io"],
    ["filters"],
    ["examples", "export"],
    ["paraview", "cohort"],
    ["cli"],
]
"""From the ground up: a room may import what is below it, and itself."""

FLOOR = {room: number for number, rooms in enumerate(FLOORS) for room in rooms}
OUTSIDE = {"__init__", "__main__", "_moved"}
WITH_VTK = {"vtk_io", "filters", "paraview"}
STANDALONE = PACKAGE / "workers" / "elastix_engine.py"  # runs in a process of its own
LEAN = {"options", "study", "errors", "progress", "installation"}  # for --help: no numpy


def modules():
    return sorted(path for path in PACKAGE.rglob("*.py") if room_of(path) not in OUTSIDE)


def room_of(path: Path) -> str:
    return path.relative_to(PACKAGE).parts[0].removesuffix(".py")


def imports(path: Path):
    """Yield (module, name) of all imports, relative ones made absolute; in functions too."""
    here = ("elastoidentify", *path.relative_to(PACKAGE).with_suffix("").parts)
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from ((alias.name, "") for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = here[: len(here) - node.level] if node.level else ()
            module = ".".join([*base, *([node.module] if node.module else [])])
            yield from ((module, alias.name) for alias in node.names)


def rooms_imported(path: Path):
    for module, name in imports(path):
        parts = [*module.split("."), name]
        if parts[0] == "elastoidentify" and parts[1] in FLOOR:
            yield parts[1]


@pytest.mark.parametrize("path", modules(), ids=lambda path: str(path.relative_to(PACKAGE)))
def test_a_room_imports_only_what_is_below_it(path):
    room = room_of(path)
    above = {other for other in rooms_imported(path) if FLOOR[other] > FLOOR[room]}
    beside = {
        other for other in rooms_imported(path) if FLOOR[other] == FLOOR[room] and other != room
    }
    assert not above and not beside


@pytest.mark.parametrize("path", modules(), ids=lambda path: str(path.relative_to(PACKAGE)))
def test_vtk_is_imported_in_the_vtk_rooms_only(path):
    roots = {module.split(".")[0] for module, _ in imports(path)}
    assert room_of(path) in WITH_VTK or not roots & {"vtk", "vtkmodules"}


@pytest.mark.parametrize("room", ["fem", "linalg", "inverse"])
def test_the_numerics_need_numpy_and_scipy_only(room):
    import sys

    roots = {
        module.split(".")[0]
        for path in (PACKAGE / room).rglob("*.py")
        for module, _ in imports(path)
    }
    allowed = {"numpy", "scipy", "elastoidentify"} | set(sys.stdlib_module_names)
    assert roots - {"pypardiso"} <= allowed


@pytest.mark.parametrize("room", sorted(LEAN))
def test_the_table_of_options_needs_the_standard_library_only(room):
    import sys

    roots = {module.split(".")[0] for module, _ in imports(PACKAGE / f"{room}.py")}
    assert roots <= {"elastoidentify"} | set(sys.stdlib_module_names)
