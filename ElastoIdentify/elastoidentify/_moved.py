"""Old names of modules that have moved: they still import, with a DeprecationWarning."""

import importlib
import importlib.abc
import importlib.util
import sys
import warnings

MOVED = {
    "background": "workers.job",
    "balance": "fem.assembly",
    "demo": "examples.demo",
    "dissection": "linalg.ldl",
    "elements": "fem.elements",
    "filters.convert": "vtk_io.convert",
    "front_qr": "linalg.front_qr",
    "gauss_newton": "inverse.newton_systems",
    "identification": "inverse.identify",
    "imaging.displacement_sources": "imaging.registration.sources",
    "imaging.elastix_process": "workers.elastix_client",
    "imaging.elastix_worker": "workers.elastix_engine",
    "imaging.information": "imaging.registration.information",
    "imaging.parameter_files": "imaging.registration.parameter_files",
    "imaging.picture": "vtk_io.picture",
    "imaging.push": "imaging.phantom.push",
    "imaging.push_quads": "imaging.phantom.push_quads",
    "imaging.refinement": "imaging.registration.correlation",
    "imaging.table": "report.table",
    "imaging.texture": "imaging.phantom.texture",
    "imaging.vtu": "vtk_io.vtu",
    "kinematics": "fem.constitutive",
    "materials": "fem.elastic_constants",
    "mesh": "fem.mesh",
    "methods": "inverse.methods",
    "noise": "inverse.observations",
    "paper": "examples.paper",
    "problem": "inverse.problem",
    "pushing": "fem.forward",
    "regularized": "inverse.regularized",
    "sequential": "inverse.sequential",
    "system": "inverse.balance_system",
    "terminal": "report.terminal",
    "unknowns": "inverse.parameterization",
}
_PACKAGE = __name__.rpartition(".")[0]


class _Forwarder(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Gives the module at its new place under its old name."""

    def find_spec(self, name, path=None, target=None):
        package, _, module = name.partition(".")
        if package == _PACKAGE and module in MOVED:
            return importlib.util.spec_from_loader(name, self)
        return None

    def create_module(self, spec):
        new = f"{_PACKAGE}.{MOVED[spec.name.partition('.')[2]]}"
        warnings.warn(f"{spec.name} is now {new}", DeprecationWarning, stacklevel=2)
        self._spec = (module := importlib.import_module(new)).__spec__
        return module

    def exec_module(self, module):
        module.__spec__ = self._spec  # the import has put the old name's there


def install() -> None:
    """Let the old names be found, after everything that is really there."""
    if not any(type(finder).__name__ == _Forwarder.__name__ for finder in sys.meta_path):
        sys.meta_path.append(_Forwarder())
