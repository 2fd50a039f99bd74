"""How ParaView shows the results unless the user says otherwise.

Stiffness gets a perceptually uniform map, its uncertainty another one, and cells without a value a
colour that neither map has. These are ParaView's settings "per array name", of a lower priority
than the user's own.
"""

import json
import textwrap

import numpy as np

from ..report.sentences import report_lines
from ..report.table import ROUND_OFF
from ..report.terminal import figure
from ..results import CHECKS, ERRORS, MU_IFS, VALUES, Status
from ..vtk_io.arrays import read_report
from ..vtk_io.convert import get_array, has_array

NOT_DETERMINED = [1.0, 0.55, 0.85]  # pink: in no perceptual map, and plain on any background
STATUS_COLOURS = {
    Status.NOT_DETERMINED: NOT_DETERMINED,
    Status.KNOWN: [0.55, 0.55, 0.55],
    Status.IDENTIFIED: [0.13, 0.57, 0.55],
    Status.OUT_OF_RANGE: [0.85, 0.10, 0.10],
    Status.SHEAR_ONLY: [0.56, 0.84, 0.27],
}
LABELS = [
    [0.80, 0.80, 0.80],
    [0.27, 0.47, 0.67],
    [0.80, 0.73, 0.27],
    [0.93, 0.40, 0.47],
    [0.13, 0.53, 0.20],
    [0.67, 0.20, 0.47],
    [0.40, 0.80, 0.93],
    [0.87, 0.53, 0.20],
    [0.20, 0.13, 0.53],
]
"""Colours of labels from 0, told apart with any kind of colour vision; further ones are added."""

REACTIONS = [
    ("free", [0.80, 0.80, 0.80]),
    ("may be pushed", [0.80, 0.40, 0.10]),
    ("along the normal only", [0.10, 0.45, 0.70]),
]
MAPS = {"Viridis": (*VALUES, *MU_IFS.values()), "Inferno": ERRORS, "Plasma": CHECKS}
"""Name of a colour map, in ParaView before 6 followed by "(matplotlib)" → quantities."""

COLUMNS = 48  # of a report in the panel, which does not break lines
SHARE = 1.0
"""Percent of the values left out at either end where they would take half of the colours."""

_PRIORITY = 0.5  # the user's settings have more, ParaView's defaults less


def set_defaults():
    """Tell ParaView's client which colours to begin with."""
    from paraview.modules.vtkRemotingServerManager import vtkSMProxyManager, vtkSMSettings

    suffix = " (matplotlib)" if vtkSMProxyManager.GetVersionMajor() < 6 else ""
    settings = json.dumps(default_settings(suffix))
    vtkSMSettings.GetInstance().AddCollectionFromString(settings, _PRIORITY)


def default_settings(suffix: str = "") -> dict:
    """Return the settings, as ParaView's settings file would hold them.

    `suffix`: of the names of colour maps.
    """
    presets = {one.array: name + suffix for name, many in MAPS.items() for one in many}
    tables = {array: {"PVLookupTable": {"NanColor": NOT_DETERMINED}} for array in presets}
    tables["Status"] = _categories(
        {int(one): (one.words, colour) for one, colour in STATUS_COLOURS.items()}
    )
    tables["Label"] = _categories({n: (str(n), colour) for n, colour in enumerate(LABELS)})
    tables["ReactionNodes"] = _categories({n: one for n, one in enumerate(REACTIONS)})
    return {"standard_presets": presets, "array_lookup_tables": tables}


def _categories(values: dict) -> dict:
    """Return the colour table of value → (words, colour)."""
    return {
        "PVLookupTable": {
            "IndexedLookup": 1,  # "Interpret Values As Categories" in the window
            "ShowIndexedColorActiveValues": 1,
            "AnnotationsInitialized": 1,
            "Annotations": [part for n, (words, _) in values.items() for part in (str(n), words)],
            "IndexedColors": [part for _, colour in values.values() for part in colour],
        }
    }


# ---- in words


def report(mesh) -> str:
    """Return what a person should know of a map, a line each; "" where the mesh has none."""
    found, made = read_report(mesh, "identification"), read_report(mesh, "provenance")
    if not found:
        return ""
    informed = has_array(mesh.GetPointData(), "DisplacementInformation_1")
    lines = report_lines(found, informed, made.get("length_unit") or "mm")
    lines += [_of_label(row, made.get("unit") or "") for row in found.get("labels", [])]
    lines += [f"warning: {line}" for line in found.get("warnings", [])]
    return "\n".join(part for line in lines for part in textwrap.wrap(line, COLUMNS))


def _of_label(row: dict, unit: str) -> str:
    name = f"label {row['label']} {row.get('name') or ''}".strip()
    if row["given"]:
        return f"{name}: known"
    if row.get("Mu mean") is None:
        return f"{name}: not determined"
    return (
        f"{name}: μ {figure(row['Mu mean'])} ± {_error(row)} {unit}, "
        f"found in {100 * row['determined']:.0f} %"
    )


def _error(row: dict) -> str:
    error = row["Mu standard error"]
    return "0" if error <= ROUND_OFF * abs(row["Mu mean"]) else figure(error)


# ---- from where to where the colours go


def shown_range(meshes, array: str) -> tuple[float, float]:
    """Return the range of a cell array of several meshes, or that without the wildest percent.

    (NaN, NaN) where there is no value.
    """
    cells = [mesh.GetCellData() for mesh in meshes]
    values = [get_array(one, array) for one in cells if has_array(one, array)]
    values = np.concatenate([np.empty(0), *values])
    values = values[np.isfinite(values)]
    if not values.size:
        return np.nan, np.nan
    low, high = float(values.min()), float(values.max())
    inner = (
        float(np.percentile(values, SHARE, method="higher")),
        float(np.percentile(values, 100 - SHARE, method="lower")),
    )
    return inner if 0 < inner[1] - inner[0] < (high - low) / 2 else (low, high)


def leaves(data) -> list:
    """Return the meshes of a data object, which may have blocks."""
    if data is None or not data.IsA("vtkCompositeDataSet"):
        return [data] if data is not None else []
    iterator, found = data.NewIterator(), []
    iterator.InitTraversal()
    while not iterator.IsDoneWithTraversal():
        found.append(iterator.GetCurrentDataObject())
        iterator.GoToNextItem()
    return found
