# An environment on top of the system's Python for the tests inside ParaView.
#
# Debian's pvpython runs the system's Python with the system's numpy, so this environment sees the
# system's packages, keeps its numpy, and never gets a vtk wheel: a second VTK crashes ParaView.
set(paraview_environment "${environments}/paraview")
set(install_paraview "sudo apt-get install paraview python3-paraview")
set(system_python /usr/bin/python3)

find_program(PVPYTHON pvpython)
if(NOT PVPYTHON)
  elastoidentify_missing(
    paraview
    FOLDER "${paraview_environment}"
    REASON "pvpython is not installed"
    COMMAND "${install_paraview}"
  )
  return()
endif()

execute_process(
  COMMAND "${system_python}" -c "import paraview, numpy; print(numpy.__version__)"
  RESULT_VARIABLE failed
  OUTPUT_VARIABLE system_numpy
  OUTPUT_STRIP_TRAILING_WHITESPACE ERROR_QUIET
)
if(failed)
  elastoidentify_missing(
    paraview
    FOLDER "${paraview_environment}"
    REASON "${PVPYTHON} is there, but ${system_python} cannot import paraview and numpy"
    COMMAND "${install_paraview}"
  )
  return()
endif()

elastoidentify_environment(
  paraview OPTIONAL
  FOLDER "${paraview_environment}"
  PYTHON "${system_python}"
  VENV_OPTIONS --system-site-packages
  INSTALL --editable "${PROJECT_SOURCE_DIR}[registration]" numpy==${system_numpy}
          matplotlib scikit-fem pytest pytest-timeout
  WITHOUT_DEPENDENCIES nilearn # only its MR template is used
)
