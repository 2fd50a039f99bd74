"""What Slicer packages and imports: every file listed, nothing unbundled at file scope."""

import ast
import json
import re
import struct
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
MODULE = ROOT / "ElastoIdentify"

# Slicer brings these; what else a module wants, it has to import where it is used.
BUNDLED = {"numpy", "scipy", "SimpleITK", "vtk", "vtkmodules", "slicer", "qt", "ctk"}
OWN = {"elastoidentify", "ElastoIdentifyLib"}


def listed_files():
    text = (MODULE / "CMakeLists.txt").read_text()
    lists = re.findall(r"set\(MODULE_PYTHON_(?:SCRIPTS|RESOURCES)\n(.*?)\n\)", text, re.S)
    names = [name for one in lists for name in one.split()]
    return [name.replace("${MODULE_NAME}", "ElastoIdentify") for name in names]


def files_on_disk():
    return sorted(
        str(path.relative_to(MODULE))
        for path in MODULE.rglob("*")
        if path.is_file()
        and path.name != "CMakeLists.txt"
        and "__pycache__" not in path.parts
        and not any(part.endswith(".egg-info") for part in path.parts)
    )


def file_scope_imports(path):
    """Names of the packages that importing a file imports, functions' bodies left out."""
    found = set()

    def walk(nodes):
        for node in nodes:
            if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda)):
                continue
            if isinstance(node, ast.Import):
                found.update(alias.name.partition(".")[0] for alias in node.names)
            elif isinstance(node, ast.ImportFrom) and node.level == 0:
                found.add(node.module.partition(".")[0])
            walk(ast.iter_child_nodes(node))

    walk([ast.parse(path.read_text())])
    return found


def imported_in_slicer():
    """All but what is for ParaView, and the program that runs in a process of its own."""
    return [
        name
        for name in listed_files()
        if name.endswith(".py")
        and not name.startswith("elastoidentify/paraview/")
        and name != "elastoidentify/workers/elastix_engine.py"
    ]


def test_cmake_lists_every_file_once():
    assert sorted(listed_files()) == files_on_disk()


@pytest.mark.parametrize("name", imported_in_slicer())
def test_files_import_only_what_slicer_bundles(name):
    unbundled = file_scope_imports(MODULE / name) - BUNDLED - OWN - set(sys.stdlib_module_names)
    assert not unbundled


@pytest.mark.parametrize("name", [n for n in listed_files() if n.endswith(".py")])
def test_syntax_is_that_of_python_3_10(name):
    ast.parse((MODULE / name).read_text(), feature_version=(3, 10))


def test_requirements_have_no_exact_pins():
    lines = (MODULE / "Resources" / "requirements.txt").read_text().splitlines()
    wanted = [line for line in lines if line and not line.startswith("#")]
    assert wanted
    assert not any("==" in line for line in wanted)


def png_size(path):
    header = path.read_bytes()[:24]
    assert header[:8] == b"\x89PNG\r\n\x1a\n"
    return struct.unpack(">II", header[16:24])


def test_the_extension_has_what_the_index_asks_for():
    entry = json.loads((ROOT / "Resources" / "ElastoIdentify.json").read_text())
    assert entry["$schema"].endswith("/slicer-extension-catalog-entry-schema-v1.0.2.json#")
    fields = {"$schema", "build_dependencies", "build_subdirectory", "category"}
    assert entry.keys() == fields | {"scm_revision", "scm_url", "tier"}  # others are refused
    assert entry["category"] in ("Quantification", "Simulation")
    assert (ROOT / "LICENSE.txt").is_file()
    assert entry["scm_url"].endswith("/SlicerElastoIdentify.git")
    assert entry["build_dependencies"] == []
    assert png_size(ROOT / "Resources" / "ElastoIdentify.png") == (128, 128)
    extension = (ROOT / "cmake" / "SlicerExtension.cmake").read_text()
    for name in ("HOMEPAGE", "CONTRIBUTORS", "DESCRIPTION", "ICONURL", "SCREENSHOTURLS", "DEPENDS"):
        assert f"set(EXTENSION_{name}" in extension
    for picture in re.findall(r"/main/(\S+\.png)", extension):
        assert (ROOT / picture).is_file(), picture


def test_the_colour_map_file_is_the_one_the_module_makes():
    slicer = pytest.importorskip("slicer")
    from ElastoIdentifyLib.outputs import stiffness_colors

    lines = (ROOT / "Resources" / "ElastoIdentifyStiffness.ctbl").read_text().splitlines()
    rows = [line.split() for line in lines if not line.startswith("#")]
    table = stiffness_colors().GetLookupTable()
    assert slicer.mrmlScene.GetNumberOfNodesByClass("vtkMRMLColorTableNode") > 0
    for number, row in enumerate(rows):
        colour = [round(255 * c) for c in table.GetTableValue(number)]
        assert max(abs(a - int(b)) for a, b in zip(colour, row[2:], strict=True)) <= 1
