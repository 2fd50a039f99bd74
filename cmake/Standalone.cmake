# Without Slicer: Python environments in the build folder, the demo, and the tests.
#
#   target demo              runs the main job, from images to the map
#   target test-environments everything the tests need that this machine can have
find_package(Python3 3.10 REQUIRED COMPONENTS Interpreter)
include(cmake/Environment.cmake)

set(environments "${CMAKE_BINARY_DIR}/environments")

# One environment for the demo and for the tests that need no host: the tests only add packages.
elastoidentify_environment(
  demo
  FOLDER "${environments}/main"
  PYTHON "${Python3_EXECUTABLE}"
  INSTALL --editable "${PROJECT_SOURCE_DIR}[demo]"
)
elastoidentify_environment(
  main
  FOLDER "${environments}/main"
  PYTHON "${Python3_EXECUTABLE}"
  INSTALL --editable "${PROJECT_SOURCE_DIR}[test]"
  AFTER demo
)
# Of its own: Snakemake's packages set others of the tests back.
elastoidentify_environment(
  cohort
  OPTIONAL
  FOLDER "${environments}/cohort"
  PYTHON "${Python3_EXECUTABLE}"
  INSTALL --editable "${PROJECT_SOURCE_DIR}[cohort]" snakemake-executor-plugin-slurm
          pytest pytest-timeout
)
include(cmake/HostParaView.cmake)
include(cmake/HostSlicer.cmake)

add_custom_target(test-environments DEPENDS ${elastoidentify_test_stamps})

set(demo_folder "${CMAKE_BINARY_DIR}/demo")
file(MAKE_DIRECTORY "${demo_folder}")
elastoidentify_python("${environments}/main" main_python)
add_custom_target(
  demo
  COMMAND "${main_python}" -m elastoidentify demo --out "${demo_folder}"
  DEPENDS "${elastoidentify_demo_stamp}"
  WORKING_DIRECTORY "${demo_folder}"
  USES_TERMINAL
)

enable_testing()
add_subdirectory(Testing)
