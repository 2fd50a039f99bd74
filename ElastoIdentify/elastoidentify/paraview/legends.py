"""What ParaView's client does by itself with a map: range of the colours, legend, first colouring.

ParaView spreads the colours from the smallest value to the largest, so that one wild cell makes all
others look alike; it does not know units; and it leaves a map in one colour whose first run has
failed. Its client tells Python of everything that is registered, so these are done here, once, when
a colour map or a legend of our arrays comes into being. What the user sets afterwards stays.
"""

from dataclasses import dataclass, field

import numpy as np

from ..results import MU_IFS, QUANTITIES
from .display import leaves, shown_range

FILTER = "LameIdentification"
NEVER = -1  # ParaView's mode of rescaling
CELLS = 1
OURS = QUANTITIES | MU_IFS


@dataclass
class _Known:
    """What is known of the client's proxies: of filters, of colour maps, of legends."""

    manager: object = None  # kept: VTK's Python forgets observers of what nobody holds
    filters: set[str] = field(default_factory=set)
    ranges: dict[str, tuple[float, float]] = field(default_factory=dict)
    given: dict[str, tuple[float, float]] = field(default_factory=dict)
    titles: dict[str, str] = field(default_factory=dict)
    seen: set[str] = field(default_factory=set)
    failed: set[str] = field(default_factory=set)
    unit: str = "Pa"
    busy: bool = False


_known = _Known()


def install():
    """Begin to listen, once. Not while plugins are loaded: scripts have no thread state yet."""
    import paraview.modules.vtkRemotingViews  # noqa: F401  representations are plain proxies without
    from paraview.modules.vtkRemotingServerManager import vtkSMProxyManager

    if _known.manager is None:
        _known.manager = vtkSMProxyManager.GetProxyManager()
        _known.manager.AddObserver("RegisterEvent", _look)


def _look(manager, event):
    """Take in what is new among filters, colour maps and legends."""
    session = manager.GetActiveSessionProxyManager()
    if session is None or _known.busy:
        return
    _known.busy = True
    try:
        for _, proxy in _proxies(session, "sources"):
            key = proxy.GetGlobalIDAsString()
            if proxy.GetXMLName() == FILTER and key not in _known.filters:
                _known.filters.add(key)
                proxy.AddObserver("UpdateDataEvent", _updated)
        for group, take in (("lookup_tables", _new_colours), ("scalar_bars", _new_legend)):
            for name, proxy in _proxies(session, group):
                key = proxy.GetGlobalIDAsString()
                if key not in _known.seen:
                    _known.seen.add(key)
                    take(session, name, proxy)
    finally:
        _known.busy = False


def _proxies(session, group):
    for number in range(session.GetNumberOfProxies(group)):
        name = session.GetProxyName(group, number)
        yield name, session.GetProxy(group, name)


def _array(name: str) -> str:
    """Return the array of a colour map by the name it is registered under, "" of others' arrays."""
    return next((part for part in name.split(".") if part in OURS), "")


def _updated(source, event):
    """Take in the ranges and the unit of a map that was just made."""
    session = source.GetSessionProxyManager()
    filter, key = source.GetClientSideObject(), source.GetGlobalIDAsString()
    if filter is None:  # it runs on a server
        return
    if filter.GetLastError():
        _known.failed.add(key)
        return
    meshes = leaves(filter.GetOutputDataObject(0))
    ranges = {array: shown_range(meshes, array) for array in QUANTITIES}
    _known.ranges |= {array: pair for array, pair in ranges.items() if np.isfinite(pair).all()}
    if "Mu" in _known.ranges:  # maps under other assumptions are to be compared with it
        _known.ranges |= dict.fromkeys(MU_IFS, _known.ranges["Mu"])
    _known.unit = filter.unit
    for name, colours in _proxies(session, "lookup_tables"):
        if _array(name) in _known.given and _range_of(colours) == _known.given[_array(name)]:
            _stretch(_array(name), colours)
    for _, legend in _proxies(session, "scalar_bars"):
        _name(session, legend)
    if key in _known.failed:
        _known.failed.discard(key)
        _colour(session, source)


# ---- colours


def _new_colours(session, name, colours):
    if _array(name) in _known.ranges:
        colours.GetProperty("AutomaticRescaleRangeMode").SetElement(0, NEVER)
        colours.UpdateVTKObjects()
        _stretch(_array(name), colours)


def _stretch(array, colours):
    points = colours.GetProperty("RGBPoints")
    (was, end), (low, high) = _range_of(colours), _known.ranges[array]
    for n in range(0, points.GetNumberOfElements(), 4):
        share = (points.GetElement(n) - was) / (end - was or 1.0)
        points.SetElement(n, low + share * (high - low))
    colours.UpdateVTKObjects()
    _known.given[array] = _range_of(colours)


def _range_of(colours) -> tuple[float, float]:
    points = colours.GetProperty("RGBPoints")
    return points.GetElement(0), points.GetElement(points.GetNumberOfElements() - 4)


# ---- legends


def _new_legend(session, _, legend):
    legend.AddObserver("PropertyModifiedEvent", _changed_legend)  # ParaView is about to name it
    _name(session, legend)


def _changed_legend(legend, event):
    if not _known.busy:
        _known.busy = True
        try:
            _name(legend.GetSessionProxyManager(), legend)
        finally:
            _known.busy = False


def _name(session, legend):
    """Give a legend its title with the unit, unless the user has named it."""
    colours = legend.GetProperty("LookupTable").GetProxy(0)
    names = [name for name, proxy in _proxies(session, "lookup_tables") if proxy == colours]
    array = _array(names[0]) if names else ""
    if array not in _known.ranges:
        return
    title, key = OURS[array].title(_known.unit), legend.GetGlobalIDAsString()
    if legend.GetProperty("Title").GetElement(0) in ("", array, _known.titles.get(key)):
        legend.GetProperty("Title").SetElement(0, title)
        legend.UpdateVTKObjects()
        _known.titles[key] = title


# ---- the first map after a failure


def _colour(session, source):
    """Colour the representations that were made of the empty output of a failed run."""
    for _, shown in _proxies(session, "representations"):
        inputs, coloured = shown.GetProperty("Input"), shown.GetProperty("ColorArrayName")
        if not (inputs and coloured and inputs.GetNumberOfProxies()):
            continue
        ours = inputs.GetProxy(0) == source and inputs.GetOutputPortForConnection(0) == 0
        if ours and not coloured.GetElement(4):
            _set_colouring(session, shown)


def _set_colouring(session, shown):
    from paraview.modules import vtkRemotingViews as views

    helper = getattr(views, "vtkSMColorMapEditorHelper", None)  # from ParaView 5.13
    if helper is None:
        shown.SetScalarColoring("Mu", CELLS)
    else:
        helper.SetScalarColoring(shown, "Mu", CELLS)
    for _, view in _proxies(session, "views"):
        members = view.GetProperty("Representations")
        if members and any(
            members.GetProxy(i) == shown for i in range(members.GetNumberOfProxies())
        ):
            (helper or type(shown)).SetScalarBarVisibility(shown, view, True)
