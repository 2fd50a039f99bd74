"""Registrations that are stored, so that hosts are compared with the pipeline without elastix.

elastix is slow, and what it answers is judged by the two truth tests, Testing/library/test_demo.py
and Testing/imaging/test_volume.py. A host is only asked whether it hands the images on, and the
answer back, as the pipeline does. So a stand-in for elastix answers once, with the displacements
that the phantom's images were made by and an error of the size of a registration's. The answers go
to the folder of the option `cache`, from where every host takes them: all but elastix itself runs.
"""

from contextlib import contextmanager
from pathlib import Path

import numpy as np
from elastoidentify import pipeline
from elastoidentify.imaging.registration.registration import PixelFrame
from scipy import ndimage

ERROR, WAVE = 0.05, 23.0  # pixels: size and wave length of the stand-in's error


class TrueDisplacements:
    """Stands for elastix on the images of a phantom.

    Parameters
    ----------
    phantom : Phantom
        Of its pushed images, and the images at rest, the displacements are known everywhere.
    """

    def __init__(self, phantom):
        self.phantom, self.frame = phantom, PixelFrame(phantom.rest)
        self.rest = self.frame.array(phantom.rest)
        self.pushed = [self.frame.array(image) for image in phantom.pushed]

    def register(self, fixed, moving, spacing, maps, points, *, mask=None, warp=True, progress):
        """Answer as ElastixProcess does: T(points), and the moving image on the fixed grid."""
        progress(0.5, "the stored answer")
        if not np.array_equal(fixed, self.rest):
            return self._back(self._trial(fixed), points), None
        trial = self._trial(moving)
        mapped = points + self._shift(trial, points) + self._error(trial, points)
        grid = np.stack(np.indices(fixed.shape)[::-1], -1).reshape(-1, fixed.ndim) * spacing
        there = (grid + self._shift(trial, grid)) / spacing
        warped = ndimage.map_coordinates(moving, there.T[::-1], order=1, mode="nearest")
        return mapped, warped.reshape(fixed.shape) if warp else None

    def _trial(self, image) -> int:
        return next(k for k, one in enumerate(self.pushed) if np.array_equal(one, image))

    def _shift(self, trial, points):
        """The true displacement, in pixels, at points (n, d) in pixels."""
        index = np.zeros((len(points), 3))
        index[:, self.frame.kept] = points / self.frame.spacing
        world = self.phantom.displacements(self.phantom.rest.index_to_world(index))[trial]
        return world @ self.phantom.rest.direction[:, self.frame.kept] / self.frame.pixel

    def _back(self, trial, points):
        """Where points of the pushed image were at rest: x with x + u(x) = points."""
        found = points
        for _ in range(20):  # the strains are small, so this contracts
            found = points - self._shift(trial, found)
        return found

    @staticmethod
    def _error(trial, points):
        turned = np.roll(points, 1, axis=1) + 7 * trial
        return ERROR * np.sin(2 * np.pi * turned / WAVE)


def store(study, phantom, folder: Path):
    """Store the registrations of a study on a phantom's images; return mesh and Registration.

    Parameters
    ----------
    study : Study
        As the host makes it; it gets the folder. Its images may lie in another world than the
        phantom's, on the same grid.
    phantom : Phantom
    folder : Path
        For the option `cache` of the host.
    """
    study.cache = str(folder)
    mesh = pipeline.make_mesh(study)
    workers, study.workers = study.workers, 1  # a second one would be elastix itself
    measured = pipeline.measure(
        study,
        mesh.points,
        mesh.cells,
        reaction_nodes=mesh.reaction_nodes,
        elastix=TrueDisplacements(phantom),
    )
    study.workers = workers
    return mesh, measured


def stored_outcome(study, phantom, folder: Path):
    """Store the registrations of a study, see :func:`store`; return the pipeline's outcome."""
    mesh, measured = store(study, phantom, folder)
    return pipeline.run(study, mesh=mesh, registration=measured)


@contextmanager
def only_read(folder: Path):
    """Demand that the host finds what is stored: a registration of its own would be added."""
    before = sorted(folder.iterdir())
    assert before
    yield
    assert sorted(folder.iterdir()) == before
