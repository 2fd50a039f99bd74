"""How ParaView shows the results unless the user says otherwise.

Stiffness gets a perceptually uniform map, its uncertainty another one, and cells without a value a
colour that neither map has. These are ParaView's settings "per array name", of a lower priority
than the user's own.
"""

import json

from ..results import CHECKS, ERRORS, VALUES, Status

NOT_DETERMINED = [1.0, 0.55, 0.85]  # pink: in no perceptual map, and plain on any background
STATUS_COLOURS = {
    Status.NOT_DETERMINED: NOT_DETERMINED,
    Status.KNOWN: [0.55, 0.55, 0.55],
    Status.IDENTIFIED: [0.13, 0.57, 0.55],
    Status.OUT_OF_RANGE: [0.85, 0.10, 0.10],
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

REACTIONS = [("free", [0.80, 0.80, 0.80]), ("may be pushed", [0.80, 0.40, 0.10])]
MAPS = {
    "Viridis (matplotlib)": VALUES,
    "Inferno (matplotlib)": ERRORS,
    "Plasma (matplotlib)": CHECKS,
}
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
            "InterpretValuesAsCategories": 1,
            "AnnotationsInitialized": 1,
            "Annotations": [part for n, (words, _) in values.items() for part in (str(n), words)],
            "IndexedColors": [part for _, colour in values.values() for part in colour],
        }
    }
