"""Maps written as DICOM, read back by other programs, voxel by voxel at its place in the world."""

import importlib.util
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest


def tool(name):
    """Return a program of this environment or of the system; skips where it is missing.

    What the environment has of dcmqi starts a Python that starts the program; here it is called
    without.
    """
    dcmqi = importlib.util.find_spec("dcmqi")
    folders = [Path(dcmqi.origin).parent / "bin"] if dcmqi else []
    places = [folder / name for folder in (*folders, Path(sys.executable).parent)]
    found = next((str(place) for place in places if place.is_file()), shutil.which(name))
    if found is None:
        pytest.skip(f"needs {name}: pip install dcmqi, or apt-get install dicom3tools calculix-ccx")
    return found


def run(*words):
    done = subprocess.run([str(word) for word in words], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout + done.stderr


def errors(file):
    """Return what dciodvfy finds wrong with a file."""
    done = subprocess.run([tool("dciodvfy"), file], capture_output=True, text=True, timeout=60)
    lines = (done.stdout + done.stderr).splitlines()
    return [line for line in lines if line.startswith("Error")]


def frames_of(file):
    """Yield (index → world (4, 4), pixels, dataset of the frame) by pydicom alone."""
    import pydicom

    data = pydicom.dcmread(file)
    shared = data.SharedFunctionalGroupsSequence[0]
    turn = np.reshape(shared.PlaneOrientationSequence[0].ImageOrientationPatient, (2, 3))
    down, across = shared.PixelMeasuresSequence[0].PixelSpacing
    pixels = data.pixel_array.reshape(-1, data.Rows, data.Columns)
    for one, frame in zip(pixels, data.PerFrameFunctionalGroupsSequence, strict=True):
        if "SegmentIdentificationSequence" in shared:  # of a single segment
            frame.SegmentIdentificationSequence = shared.SegmentIdentificationSequence
        place = np.eye(4)
        place[:3, 0], place[:3, 1] = turn[0] * across, turn[1] * down
        place[:3, 2] = np.cross(*turn)
        place[:3, 3] = frame.PlanePositionSequence[0].ImagePositionPatient
        yield place, one, frame


def on_grid(pieces, image):
    """Put pieces (index → world, values (k, j, i)) on an image's grid, NaN where none is.

    Every voxel must lie within 1e-3 mm of one of the grid.
    """
    array = np.full(image.array.shape, np.nan)
    for place, values in pieces:
        k, j, i = np.indices(values.shape)
        world = np.stack([i, j, k, np.ones_like(i)], -1).reshape(-1, 4) @ place.T
        index = np.linalg.solve(image.axes, (world[:, :3] - image.origin).T).T
        off = (index - np.rint(index)) @ image.axes.T
        assert np.abs(off).max() < 1e-3
        i, j, k = np.rint(index).astype(int).T
        assert np.isnan(array[k, j, i]).all()
        array[k, j, i] = values.ravel()
    return array


def map_by_pydicom(file, image):
    return on_grid([(place, one[None]) for place, one, _ in frames_of(file)], image)


def labels_by_pydicom(file, image):
    """Return {segment number: mask}."""
    numbers = {}
    for place, one, frame in frames_of(file):
        number = frame.SegmentIdentificationSequence[0].ReferencedSegmentNumber
        numbers.setdefault(number, []).append((place, one[None]))
    return {number: on_grid(pieces, image) == 1 for number, pieces in numbers.items()}


def volume_by_dcmqi(file, folder):
    """Return the NRRD file that dcmqi makes of a parametric map."""
    folder.mkdir(exist_ok=True)
    run(
        tool("paramap2itkimage"), "--inputDICOM", file, "--outputDirectory", folder,
        "--outputType", "nrrd",
    )  # fmt: skip
    return folder / "pmap.nrrd"


def segments_by_dcmqi(file, folder):
    """Return the NRRD files that dcmqi makes of a segmentation, by segment number."""
    folder.mkdir(exist_ok=True)
    run(
        tool("segimage2itkimage"), "--inputDICOM", file, "--outputDirectory", folder,
        "--outputType", "nrrd", "--prefix", "segment",
    )  # fmt: skip
    return {int(f.stem.rpartition("-")[2]): f for f in folder.glob("segment-*.nrrd")}
