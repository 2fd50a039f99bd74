"""What goes from one process to another, whose numpy may be of another version."""

import pickle

import numpy as np


class _Pickler(pickle.Pickler):
    """Writes arrays so that any version of numpy reads them: their own way names its modules."""

    def reducer_override(self, thing):
        """Return how arrays and their elements are written, NotImplemented for all else."""
        if isinstance(thing, np.generic) and thing.dtype.kind in "biufc":
            return _element, (thing.dtype.str, thing.tobytes())
        if isinstance(thing, np.ndarray) and thing.dtype.kind in "biufc":
            return _array, (thing.dtype.str, thing.shape, thing.tobytes())
        return NotImplemented


def _element(dtype: str, data: bytes):
    return np.frombuffer(data, dtype)[0]


def _array(dtype: str, shape: tuple[int, ...], data: bytes) -> np.ndarray:
    return np.frombuffer(bytearray(data), dtype).reshape(shape)  # a bytearray can be written to


def dump(thing, file) -> None:
    """Pickle for another process, whose numpy may be another."""
    _Pickler(file).dump(thing)
