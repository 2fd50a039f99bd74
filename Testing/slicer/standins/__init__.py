"""Stand-ins for what the Slicer application has and the package slicer-core has not.

slicer-core is Slicer's own MRML, module logic, displayable managers and `slicer.util`. Missing are
the application object, the scene it owns, the Python base classes of scripted modules, and every
Qt widget. `application` makes the first two, `modules` the third, `widgets` the last, on PySide6
with PythonQt's manners. They are as strict as they can cheaply be: what a module uses and a
stand-in does not have raises.

With a checkout of Slicer, `sources` puts its Python code in the place of `modules`, and `headers`
reads from its C++ code what the widgets offer; `SlicerConfig.cmake` lends its CMake macros.
`views` and `pictures` draw with Slicer's displayable managers.
"""
