"""What made a result: version, options as used, materials as given, inputs by their SHA-256."""

import hashlib
import platform
from datetime import datetime, timezone
from importlib import metadata
from pathlib import Path

import numpy as np

from .options import Picture

LIBRARIES = ("numpy", "scipy", "SimpleITK", "itk-elastix", "vtk", "pypardiso")


def provenance(study, inputs=None, duration: float | None = None) -> dict:
    """Return where a result comes from, ready for JSON.

    Parameters
    ----------
    study : Study, or a filter with the options of some steps
    inputs : {name: {"name", "sha256"}}, optional
        What was read, see :func:`fingerprint`; of images in memory the fingerprint of their voxels
        is taken.
    duration : float, optional
        Of the work, s.

    Returns
    -------
    dict
        ``elastoidentify`` (version), ``libraries``, ``python``, ``machine``, ``finished`` (UTC),
        ``duration_s``, ``options`` (every one, as used), ``known_materials`` (as given), ``unit``,
        ``length_unit``, ``inputs``.
    """
    from . import __version__

    options, inputs = study.options(), dict(inputs or {})
    images = {name for name, option in options.items() if isinstance(option, Picture)}
    values = {name: getattr(study, name) for name in options if name not in images}
    for name in (
        images - inputs.keys()
    ):  # voxels are only gone through where no file stands for them
        if getattr(study, name) not in (None, ()):
            inputs[name] = _of_images(getattr(study, name))
    return {
        "elastoidentify": __version__,
        "libraries": library_versions(),
        "python": platform.python_version(),
        "machine": platform.machine(),
        "finished": datetime.now(timezone.utc).isoformat(timespec="seconds"),
        "duration_s": None if duration is None else round(duration, 3),
        "options": values,
        "unit": values.get("unit"),
        "length_unit": values.get("length_unit"),
        "inputs": {name: inputs[name] for name in sorted(inputs)},
    }


def library_versions() -> dict[str, str]:
    """Return the version of every library that is installed and takes part."""
    found = {}
    for name in LIBRARIES:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return found


def _of_images(value):
    if isinstance(value, (tuple, list)):
        return [_of_images(one) for one in value]
    return {"name": "", "sha256": image_hash(value)}


def image_hash(image) -> str:
    """Return the SHA-256 of an image's voxels and geometry."""
    digest = hashlib.sha256(repr((image.array.shape, image.array.dtype.str)).encode())
    for part in (image.array, image.origin, image.spacing, image.direction):
        digest.update(np.ascontiguousarray(part).tobytes())
    return digest.hexdigest()


def fingerprint(path: str | Path) -> dict[str, str]:
    """Return name and SHA-256 of a file, or of all files of a folder, sorted by name."""
    path = Path(path)
    files = sorted(one for one in path.rglob("*") if one.is_file()) if path.is_dir() else [path]
    digest = hashlib.sha256()
    for one in files:
        if path.is_dir():
            digest.update(str(one.relative_to(path)).encode())
        with open(one, "rb") as file:
            while block := file.read(1 << 20):
                digest.update(block)
    return {"name": path.name, "sha256": digest.hexdigest()}
