# Stand-in for the SlicerConfig.cmake that a build of Slicer writes: Slicer's own macros, from a
# checkout, with no Slicer behind them. Enough for an extension of scripted modules.
#
#   cmake -DSlicer_DIR=<this folder> -DSLICER_SOURCE=<checkout of Slicer> -S . -B <build folder>
#
# CTK and vtkAddon are expected beside the checkout of Slicer.
get_filename_component(_beside "${SLICER_SOURCE}" DIRECTORY)

set(Slicer_CMAKE_DIR "${SLICER_SOURCE}/CMake")
set(Slicer_EXTENSIONS_CMAKE_DIR "${SLICER_SOURCE}/Extensions/CMake")
set(CTK_CMAKE_DIR "${_beside}/CTK/CMake")
list(PREPEND CMAKE_MODULE_PATH
  "${Slicer_CMAKE_DIR}" "${Slicer_EXTENSIONS_CMAKE_DIR}" "${CTK_CMAKE_DIR}" "${_beside}/vtkAddon/CMake"
)
set(Slicer_USE_FILE "${Slicer_CMAKE_DIR}/UseSlicer.cmake.in")
set(Slicer_EXTENSION_GENERATE_CONFIG "${Slicer_CMAKE_DIR}/SlicerExtensionGenerateConfig.cmake")
set(Slicer_EXTENSION_CPACK "${Slicer_CMAKE_DIR}/SlicerExtensionCPack.cmake")
file(GLOB_RECURSE _template "${SLICER_SOURCE}/Base/qSlicerModuleGenericTest.py.in")
get_filename_component(Slicer_PYTHON_MODULE_TEST_TEMPLATES_DIR "${_template}" DIRECTORY)

# Values of the kind that a build of Slicer for Linux sets.
set(Slicer_REVISION 34627)
set(Slicer_WC_ROOT "https://github.com/Slicer/Slicer")
set(Slicer_OS linux)
set(Slicer_ARCHITECTURE amd64)
set(Slicer_ORGANIZATION_NAME NA-MIC)
set(Slicer_BUILD_SHARED ON)
set(Slicer_INSTALL_ROOT "./")
set(Slicer_SHARE_DIR share/Slicer-5.12)
set(Slicer_QTSCRIPTEDMODULES_LIB_DIR lib/Slicer-5.12/qt-scripted-modules)
set(Slicer_QTLOADABLEMODULES_LIB_DIR lib/Slicer-5.12/qt-loadable-modules)
set(Slicer_CLIMODULES_LIB_DIR lib/Slicer-5.12/cli-modules)
set(Slicer_LAUNCHER_EXECUTABLE "${CMAKE_COMMAND};-E;echo;Slicer")
set(Slicer_ExternalData_DATA_MANAGEMENT_TARGET SlicerData)
set(Slicer_LICENSE_FILE "${CMAKE_SOURCE_DIR}/LICENSE.txt")
set(Slicer_README_FILE "${CMAKE_SOURCE_DIR}/README.md")
set(Slicer_CMAKE_CXX_STANDARD 17)
set(Slicer_USE_PYTHONQT ON)
set(Slicer_USE_CTKAPPLAUNCHER OFF)

# Packages that the macros want, though scripted modules use nothing of the first, and the second
# only makes a launcher for the build folder.
set(_nothing "${CMAKE_BINARY_DIR}/nothing")
set(SlicerExecutionModel_DIR "${_nothing}")
set(SlicerExecutionModel_USE_FILE "${_nothing}/Use.cmake")
set(CTKAppLauncher_DIR "${_nothing}")
file(WRITE "${_nothing}/Use.cmake" "")
file(WRITE "${_nothing}/SlicerExecutionModelConfig.cmake" "")
file(WRITE "${_nothing}/CTKAppLauncherConfig.cmake"
  "function(ctkAppLauncherConfigureForExecutable)\nendfunction()\n"
)

# PythonQt is not looked for, and Python is the one that runs the tests.
set(CMAKE_DISABLE_FIND_PACKAGE_PythonQt ON)
set(PYTHONINTERP_FOUND ON)
set(PYTHONLIBS_FOUND ON)
set(PYTHON_LIBRARIES "${PYTHON_EXECUTABLE}")
include(ctkFunctionExtractOptimizedLibrary)
set(Slicer_FOUND TRUE)
