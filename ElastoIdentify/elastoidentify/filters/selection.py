"""A list of names with check boxes: what a filter offers, and what of it the user wants."""

import weakref

from vtkmodules.vtkCommonCore import vtkDataArraySelection


class Selection:
    """A vtkDataArraySelection that a filter fills with names and a host shows as a list.

    Offering names is no change of the filter, choosing among them is one.

    Parameters
    ----------
    filter : vtkAlgorithm
        Is told to run again when the choice changes.
    """

    def __init__(self, filter):
        self.vtk = vtkDataArraySelection()
        self._offered, self._offering = set(), False
        selection, reference = weakref.ref(self), weakref.ref(filter)

        def changed(*_):
            if reference() is not None and not selection()._offering:
                reference().Modified()

        self.vtk.AddObserver("ModifiedEvent", changed)

    def names(self) -> list[str]:
        """Return all names of the list."""
        return [self.vtk.GetArrayName(i) for i in range(self.vtk.GetNumberOfArrays())]

    def chosen(self) -> list[str]:
        """Return the names that are switched on."""
        return [name for name in self.names() if self.vtk.ArrayIsEnabled(name)]

    def choose(self, names):
        """Switch these names on, and all others off that may be offered later; none: no choice."""
        self.vtk.RemoveAllArrays()
        self._offered.clear()
        for name in names:
            self.vtk.AddArray(name, True)

    def offer(self, names, on: bool = False):
        """Add names to the list.

        They are switched on if `on`, unless the user has chosen others: by name before they were
        offered, or by switching off some of those offered.
        """
        by_name = set(self.chosen()) - self._offered
        some_off = any(not self.vtk.ArrayIsEnabled(name) for name in names if name in self._offered)
        on = on and not by_name and not some_off
        self._offering = True
        try:
            for name in names:
                if not self.vtk.ArrayExists(name):
                    self.vtk.AddArray(name, on)
                    self._offered.add(name)
        finally:
            self._offering = False
