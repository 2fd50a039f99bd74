# An environment with Slicer's own MRML and module logic, as far as a Python package has them.
#
# The Slicer application is in no package registry; slicer-core is its core without the application
# and its widgets. Testing/slicer stands in for the rest.
set(slicer_environment "${environments}/slicer")
if(Python3_VERSION VERSION_GREATER_EQUAL 3.14)
  elastoidentify_missing(
    slicer
    FOLDER "${slicer_environment}"
    REASON "slicer-core has no package for Python ${Python3_VERSION}"
    COMMAND "cmake --preset default -DPython3_EXECUTABLE=/path/to/python3.13"
  )
  return()
endif()

# PySide6 6.12 drops references to None under Python 3.10 and 3.11, which aborts in the end.
elastoidentify_environment(
  slicer OPTIONAL
  FOLDER "${slicer_environment}"
  PYTHON "${Python3_EXECUTABLE}"
  INSTALL --editable "${PROJECT_SOURCE_DIR}[registration,dicom]" slicer-core
          "PySide6-Essentials<6.12" dcmqi matplotlib scikit-fem pytest pytest-timeout
  WITHOUT_DEPENDENCIES nilearn # only its MR template is used
)
