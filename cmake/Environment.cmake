# elastoidentify_python(<folder> <variable>): the interpreter of a virtual environment.
function(elastoidentify_python folder variable)
  if(WIN32)
    set(${variable} "${folder}/Scripts/python.exe" PARENT_SCOPE)
  else()
    set(${variable} "${folder}/bin/python" PARENT_SCOPE)
  endif()
endfunction()

# elastoidentify_environment(<name> FOLDER f PYTHON p [OPTIONAL] [VENV_OPTIONS ...] INSTALL ...
#                            [WITHOUT_DEPENDENCIES ...] [AFTER name])
#
# A virtual environment that is made once, and again when pyproject.toml or the interpreter
# changes. Sets elastoidentify_<name>_stamp and adds it to elastoidentify_test_stamps. An OPTIONAL
# environment that cannot be made is no error: its folder then holds missing.txt, two lines that
# say why and which command would help, and Testing/run_suite.py lists its tests as skipped.
function(elastoidentify_environment name)
  cmake_parse_arguments(
    PARSE_ARGV 1 arg "OPTIONAL" "FOLDER;PYTHON;AFTER" "VENV_OPTIONS;INSTALL;WITHOUT_DEPENDENCIES"
  )
  execute_process(
    COMMAND "${arg_PYTHON}" -c "import ensurepip, venv"
    RESULT_VARIABLE no_venv
    OUTPUT_QUIET ERROR_QUIET
  )
  if(no_venv)
    message(FATAL_ERROR
      "${arg_PYTHON} cannot make virtual environments. On Debian or Ubuntu: "
      "sudo apt-get install python3-venv"
    )
  endif()

  # A file that changes exactly when the environment has to be made anew.
  set(recipe "${CMAKE_BINARY_DIR}/environments/${name}.recipe")
  file(CONFIGURE OUTPUT "${recipe}" @ONLY CONTENT
    "${arg_PYTHON}\n${arg_VENV_OPTIONS}\n${arg_INSTALL}\n${arg_WITHOUT_DEPENDENCIES}\n"
  )
  set(stamp "${CMAKE_BINARY_DIR}/environments/${name}.stamp")
  set(previous)
  if(arg_AFTER)
    set(previous "${elastoidentify_${arg_AFTER}_stamp}")
  endif()
  add_custom_command(
    OUTPUT "${stamp}"
    COMMAND
      "${CMAKE_COMMAND}" "-DNAME=${name}" "-DFOLDER=${arg_FOLDER}" "-DPYTHON=${arg_PYTHON}"
      "-DOPTIONAL=${arg_OPTIONAL}" "-DVENV_OPTIONS=${arg_VENV_OPTIONS}"
      "-DINSTALL=${arg_INSTALL}" "-DWITHOUT_DEPENDENCIES=${arg_WITHOUT_DEPENDENCIES}"
      "-DSTAMP=${stamp}" -P "${PROJECT_SOURCE_DIR}/cmake/MakeEnvironment.cmake"
    DEPENDS
      "${PROJECT_SOURCE_DIR}/pyproject.toml" "${PROJECT_SOURCE_DIR}/cmake/MakeEnvironment.cmake"
      "${recipe}" ${previous}
    COMMENT "Python environment for: ${name} (some minutes the first time)"
    USES_TERMINAL
    VERBATIM
  )
  set(elastoidentify_${name}_stamp "${stamp}" PARENT_SCOPE)
  set(elastoidentify_test_stamps ${elastoidentify_test_stamps} "${stamp}" PARENT_SCOPE)
endfunction()

# elastoidentify_missing(<name> FOLDER f REASON r COMMAND c): this machine cannot have it.
function(elastoidentify_missing name)
  cmake_parse_arguments(PARSE_ARGV 1 arg "" "FOLDER;REASON;COMMAND" "")
  file(REMOVE_RECURSE "${arg_FOLDER}")
  file(REMOVE "${CMAKE_BINARY_DIR}/environments/${name}.stamp")
  file(WRITE "${arg_FOLDER}/missing.txt" "${arg_REASON}\n${arg_COMMAND}\n")
  message(STATUS "The ${name} tests will be skipped: ${arg_REASON}. To enable: ${arg_COMMAND}")
endfunction()
