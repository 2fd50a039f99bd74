"""Finished registrations in a folder, by the hash of everything that went into them.

A run that was killed goes on where it was: what elastix has answered once for the same images,
parameters, points and version is read instead of asked for again.
"""

import hashlib
import json
import zipfile
from importlib import metadata
from pathlib import Path

import numpy as np

from ..io import write_whole

Answer = tuple[np.ndarray, np.ndarray | None]


class RegistrationCache:
    """Answers of elastix in a folder.

    Parameters
    ----------
    folder : path
        Made if it is not there. What is not a whole answer is made again and replaced.
    """

    def __init__(self, folder: str | Path):
        self.folder = Path(folder)
        self.folder.mkdir(parents=True, exist_ok=True)

    def read(self, key: str) -> Answer | None:
        """Return the answer of a key, None where there is none."""
        try:
            with np.load(self._path(key), allow_pickle=False) as file:
                return file["mapped"], file.get("warped")
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
            return None

    def write(self, key: str, answer: Answer) -> None:
        """Keep an answer, whole or not at all."""
        mapped, warped = answer
        arrays = {"mapped": mapped} | ({} if warped is None else {"warped": warped})

        def fill(part: Path) -> None:
            with open(part, "wb") as file:
                np.savez(file, **arrays)

        write_whole(self._path(key), fill)

    def _path(self, key: str) -> Path:
        return self.folder / f"registration-{key[:32]}.npz"


def key_of(arrays: dict[str, np.ndarray | None], settings: dict) -> str:
    """Return the SHA-256 of arrays, settings and the version of elastix."""
    try:
        version = metadata.version("itk-elastix")
    except metadata.PackageNotFoundError:
        version = ""  # it is in another interpreter
    digest = hashlib.sha256(json.dumps([version, settings], sort_keys=True).encode())
    for name, array in sorted(arrays.items()):
        shape = None if array is None else [*array.shape, array.dtype.str]
        digest.update(json.dumps([name, shape]).encode())
        if array is not None:
            digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()
