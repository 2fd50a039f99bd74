"""elastix parameter files: the shipped ones, reading, and the check of the names."""

import difflib
import re
from collections.abc import Sequence
from functools import cache
from pathlib import Path

import numpy as np

from ...errors import InputError

ParameterMap = dict[str, list[str]]
FOLDER = Path(__file__).with_name("parameters")
_NOT_MAPS = {"known_names"}
_LINE = re.compile(r"\(\s*([^\s()\"]+)\s*((?:\"[^\"]*\"|[^()\"])*)\)\s*(?://.*)?$")
_COMPONENT = re.compile(
    r"^(Metric|Registration|FixedImagePyramid|MovingImagePyramid|Interpolator|ImageSampler|"
    r"Optimizer|Transform|ResampleInterpolator|Resampler)\d+(?=.)"
)


def shipped_maps() -> list[str]:
    """Names of the parameter files that come with the package."""
    return sorted(path.stem for path in FOLDER.glob("*.txt") if path.stem not in _NOT_MAPS)


@cache
def known_names() -> frozenset[str]:
    """Names of all parameters that elastix 5.3 reads."""
    return frozenset((FOLDER / "known_names.txt").read_text().split())


def read_parameter_map(path: str | Path) -> ParameterMap:
    """Read one elastix parameter file: ``(Name "value" 1 2.5)`` per line, ``//`` comments.

    Raises
    ------
    InputError
        The file cannot be read, or a line is not a parameter.
    """
    try:
        text = Path(path).read_text()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"cannot read the elastix parameter file {path}: {error}") from None
    found: ParameterMap = {}
    for number, line in enumerate(text.splitlines(), 1):
        line = line.strip()
        if not line or line.startswith("//"):
            continue
        match = _LINE.match(line)
        if match is None:
            raise InputError(
                f"{path}, line {number}: {line[:60]!r} is no elastix parameter, which looks like "
                '(MaximumNumberOfIterations 500) or (Metric "AdvancedMeanSquares")'
            )
        name, values = match.groups()
        found[name] = [a or b for a, b in re.findall(r'"([^"]*)"|(\S+)', values)]
    if "Transform" not in found:
        raise InputError(f"{path} names no (Transform ...): it is not an elastix parameter file")
    return found


def check_names(parameter_map: ParameterMap, where: str) -> list[str]:
    """Look for names that elastix would silently ignore.

    Returns
    -------
    list of str
        A sentence for each unknown name.

    Raises
    ------
    InputError
        An unknown name that is close to a known one: misspelt.
    """
    notes = []
    for name in parameter_map:
        bare = _COMPONENT.sub("", name)
        if {name, bare, "Metric" + bare} & known_names():
            continue
        close = difflib.get_close_matches(bare, known_names(), 1, 0.85)
        if close:
            raise InputError(
                f"{where}: elastix has no parameter {name!r} and would ignore it; "
                f"did you mean {close[0]!r}?"
            )
        notes.append(f"{where}: elastix 5.3 has no parameter {name!r} and ignores it.")
    return notes


def load_parameters(
    parameters: str | Path | Sequence[str | Path] | None, dimension: int
) -> tuple[list[ParameterMap], list[str]]:
    """Return the parameter maps of a registration and notes about them.

    Parameters
    ----------
    parameters : str, Path, sequence of those, or None
        A file, the name of a shipped map ("affine", "bspline"), or several of them to be applied
        one after the other. None: "bspline", with four resolutions in three dimensions.
    dimension : 2 or 3
    """
    if parameters is None:
        default = read_parameter_map(FOLDER / "bspline.txt")
        if dimension == 3:
            default["NumberOfResolutions"] = ["4"]
        return [default], []
    several = [parameters] if isinstance(parameters, str | Path) else list(parameters)
    if not several:
        raise InputError("the list of elastix parameter files is empty: leave it out, or name one")
    maps, notes = [], []
    for entry in several:
        path = FOLDER / f"{entry}.txt" if str(entry) in shipped_maps() else Path(entry)
        one_map = read_parameter_map(path)
        notes += check_names(one_map, str(entry))
        maps.append(one_map)
    return maps, notes


def control_point_spacing(maps: list[ParameterMap]) -> float:
    """Spacing in pixels of the control points of the last B-spline map; 16 if there is none."""
    for one_map in reversed(maps):
        for name in ("FinalGridSpacingInPhysicalUnits", "FinalGridSpacingInVoxels"):
            if name in one_map:
                return float(np.mean([float(value) for value in one_map[name]]))
    return 16.0
