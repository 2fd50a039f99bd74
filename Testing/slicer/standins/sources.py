"""Slicer's own Python sources instead of stand-ins, where a copy of them is at hand.

With the environment variable ELASTOIDENTIFY_SLICER_SOURCE set to a checkout of Slicer, the base
classes of scripted modules, the parameter node and its connection to widgets, translation,
packaging, testing and `slicer.util` are Slicer's, and every test of this folder runs on them. What
is written in C++ stays as it is: MRML comes from slicer-core, widgets from `widgets`.
"""

import importlib
import os
import sys
import types
from pathlib import Path

import slicer

VARIABLE = "ELASTOIDENTIFY_SLICER_SOURCE"
HINT = (
    "git clone --depth 1 https://github.com/Slicer/Slicer (and commontk/CTK and Slicer/vtkAddon "
    f"beside it), then set {VARIABLE} to the folder Slicer"
)
PACKAGES = (
    "util",
    "i18n",
    "packaging",
    "testing",
    "parameterNodeWrapper",
    "ScriptedLoadableModule",
)


def folder() -> Path | None:
    """Return the checkout of Slicer, or None where none is given."""
    given = os.environ.get(VARIABLE)
    return Path(given).resolve() if given else None


class AnyWidgets(types.ModuleType):
    """A module that has a widget class of every name, for `type(widget) in (ctk.ctkCheckBox, …)`.

    No widget of the panel is one of these: they only are there to be compared with.
    """

    def __getattr__(self, name):
        if not name.startswith(("ctk", "qMRML", "qSlicer")):
            raise AttributeError(name)
        setattr(self, name, type(name, (), {}))
        return getattr(self, name)


def install(module_file: str) -> None:
    """Put Slicer's sources in place of `modules.install`; to be called after `widgets.install`."""
    import ctk

    known = AnyWidgets("ctk")
    known.__dict__.update({k: v for k, v in vars(ctk).items() if not k.startswith("__")})
    sys.modules["ctk"] = known
    for name in ("qMRMLRangeWidget", "qMRMLSliderWidget", "qMRMLSpinBox", "qSlicerWidget"):
        setattr(slicer, name, type(name, (), {}))

    own_load = slicer.util.loadUI
    slicer.__path__.insert(0, str(folder() / "Base" / "Python" / "slicer"))
    for name in PACKAGES:
        sys.modules.pop(f"slicer.{name}", None)
    for name in PACKAGES:
        try:
            setattr(slicer, name, importlib.import_module(f"slicer.{name}"))
        except ModuleNotFoundError as missing:
            if missing.name != "slicer.packaging":  # came with 5.12
                raise
    slicer.util.loadUI = own_load
    slicer.util.modulePath = lambda name: module_file
