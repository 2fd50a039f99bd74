"""How ParaView shows the results unless the user says otherwise.

Stiffness gets a perceptually uniform map, its uncertainty another one, and cells without a value a
colour that neither map has. These are ParaView's settings "per array name", of a lower priority
than the user's own.
"""

import json

from ..results import ERRORS, VALUES, Status

NOT_DETERMINED = [1.0, 0.55, 0.85]  # pink: in no perceptual map, and plain on any background
STATUS_COLOURS = {
    Status.NOT_DETERMINED: NOT_DETERMINED,
    Status.KNOWN: [0.55, 0.55, 0.55],
    Status.IDENTIFIED: [0.13, 0.57, 0.55],
    Status.OUT_OF_RANGE: [0.85, 0.10, 0.10],
}
MAPS = {"Viridis (matplotlib)": VALUES, "Inferno (matplotlib)": ERRORS}
_PRIORITY = 0.5  # the user's settings have more, ParaView's defaults less


def set_defaults():
    """Tell ParaView's client which colours to begin with."""
    from paraview.modules.vtkRemotingServerManager import vtkSMSettings

    settings = json.dumps(default_settings())
    vtkSMSettings.GetInstance().AddCollectionFromString(settings, _PRIORITY)


def default_settings() -> dict:
    """Return the settings, as ParaView's settings file would hold them."""
    presets = {one.array: name for name, quantities in MAPS.items() for one in quantities}
    tables = {array: {"PVLookupTable": {"NanColor": NOT_DETERMINED}} for array in presets}
    tables["Status"] = {
        "PVLookupTable": {
            "InterpretValuesAsCategories": 1,
            "AnnotationsInitialized": 1,
            "Annotations": [part for one in STATUS_COLOURS for part in (str(int(one)), one.words)],
            "IndexedColors": [part for colour in STATUS_COLOURS.values() for part in colour],
        }
    }
    return {"standard_presets": presets, "array_lookup_tables": tables}
