"""How ParaView shows the results unless the user says otherwise.

Stiffness gets a perceptually uniform map, its uncertainty another one, and cells without a value a
colour that neither map has. These are ParaView's settings "per array name", of a lower priority
than the user's own.
"""

import json

NOT_DETERMINED = [1.0, 0.55, 0.85]  # pink: in no perceptual map, and plain on any background
STATUS = {
    "0": ("not determined", NOT_DETERMINED),
    "1": ("known", [0.55, 0.55, 0.55]),
    "2": ("identified", [0.13, 0.57, 0.55]),
    "3": ("out of range", [0.85, 0.10, 0.10]),
}
MAPS = {
    "Viridis (matplotlib)": ("Lambda", "Mu", "YoungModulus", "PoissonRatio"),
    "Inferno (matplotlib)": ("LambdaStd", "MuStd"),
}
_PRIORITY = 0.5  # the user's settings have more, ParaView's defaults less


def set_defaults():
    """Tell ParaView's client which colours to begin with."""
    from paraview.modules.vtkRemotingServerManager import vtkSMSettings

    settings = json.dumps(default_settings())
    vtkSMSettings.GetInstance().AddCollectionFromString(settings, _PRIORITY)


def default_settings() -> dict:
    """Return the settings, as ParaView's settings file would hold them."""
    presets = {array: name for name, arrays in MAPS.items() for array in arrays}
    tables = {array: {"PVLookupTable": {"NanColor": NOT_DETERMINED}} for array in presets}
    tables["Status"] = {
        "PVLookupTable": {
            "InterpretValuesAsCategories": 1,
            "AnnotationsInitialized": 1,
            "Annotations": [part for value, (word, _) in STATUS.items() for part in (value, word)],
            "IndexedColors": [part for _, colour in STATUS.values() for part in colour],
        }
    }
    return {"standard_presets": presets, "array_lookup_tables": tables}
