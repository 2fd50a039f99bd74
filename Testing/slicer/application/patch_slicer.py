"""Changes Slicer's sources so that they build against Debian's libraries; may be run again.

patch_slicer.py FOLDER
"""

import re
import sys
from pathlib import Path

ROOT = Path(sys.argv[1])


def change(name: str, *pairs: tuple[str, str]) -> None:
    """Replace each pattern in a file; say so if neither it nor its replacement is there."""
    path = ROOT / name
    text = before = path.read_text(encoding="utf-8")
    for pattern, by in pairs:
        if by and by in text:
            continue
        text, count = re.subn(pattern, lambda _, by=by: by, text, flags=re.M | re.S)
        if not count and by:
            sys.exit(f"patch_slicer.py: nothing in {name} is like {pattern[:60]!r}")
    if text != before:
        path.write_text(text, encoding="utf-8")
        print("changed", name)


# Debian's ITK has not these modules.
change("Libs/ITKFactoryRegistration/CMakeLists.txt", (r"^  MGHIO\n", ""), (r"^  IOScanco\n", ""))
change(
    "Libs/vtkITK/CMakeLists.txt",
    (r"^  GrowCut\n", ""),
    (r"^  vtkITKGrowCut\.cxx\n", ""),
    (r"^  vtkITKMorphologicalContourInterpolator\.cxx\n", ""),
)

# ITK looks VTK up once more and so empties the list of VTK's libraries: link every target with
# them. The first line finds what the targets of CTK name and do not look for.
mark = 'set(VTK_GUI_SUPPORT_QT_TARGET_NAME "VTK::GUISupportQt")\n'
change(
    "CMakeLists.txt",
    (
        re.escape(mark),
        mark
        + """
find_package(ITKInternalEigen3 CONFIG REQUIRED)
foreach(_module ${Slicer_VTK_COMPONENTS} CommonCore CommonSystem CommonMath CommonMisc
    CommonTransforms CommonExecutionModel CommonDataModel CommonColor CommonComputationalGeometry
    FiltersCore FiltersGeneral FiltersGeometry FiltersSources ImagingCore ImagingGeneral)
  if(TARGET VTK::${_module})
    link_libraries(VTK::${_module})
  endif()
endforeach()
""",
    ),
)

# Python 3.14 has no _PyInterpreterState_SetConfig; what it is for here is sys.argv.
change(
    "Base/QTCore/qSlicerCoreApplication.cxx",
    (
        r"PyConfig config;.*?// Set 'sys\.executable' so",
        """PyObject* argvList = PyList_New(0);
    for (int i = 0; i < pythonArgc; ++i)
    {
      PyObject* item = PyUnicode_FromWideChar(pythonArgv[i], -1);
      PyList_Append(argvList, item);
      Py_DECREF(item);
    }
    PySys_SetObject("argv", argvList);
    Py_DECREF(argvList);

    // Set 'sys.executable' so""",
    ),
)

# The launcher of the designer belongs to a package, which is not made.
change(
    "CMake/SlicerCPack.cmake",
    (
        r"^if\(Slicer_BUILD_QT_DESIGNER_PLUGINS\)",
        "if(Slicer_BUILD_QT_DESIGNER_PLUGINS AND Slicer_USE_CTKAPPLAUNCHER)",
    ),
)

# Slicer's vtk loads a module of VTK when it is asked for, and the wrappers of Slicer's classes load
# those of their base classes; the latter with a later vtkAddon than sources.txt has.
change(
    "Base/Python/slicer/__init__.py",
    (r"^import vtk  # noqa: F401", "import vtkmodules.all, vtk  # noqa: E401, F401"),
)
