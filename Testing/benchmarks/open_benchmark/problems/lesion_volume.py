"""Volumes with a lesion that the segmentation does not know."""

from ..problem import Case, Truth
from .lesion_images import from_phantom, need_elastix

TITLE = "Hidden lesion from images, 3-D"
SOURCE = (
    "Our own phantom in space: speckle, 48 voxels across the block, ball 3:1 in none of the "
    "labels, four pushes (triquadratic bricks), 2 % Rician noise; displacements and their "
    "information by this product's registration, the same for every method."
)
LEVELS = ("noise 2 %",)
QUICK = None


def make(level) -> tuple[Case, Truth]:
    need_elastix()
    from elastoidentify.imaging.phantom import Ball, make_phantom_volume

    phantom = make_phantom_volume(
        voxels=48, elements=12, hidden=True, seed=43, balls=[Ball(radius=0.25, contrast=3.0)]
    )
    return from_phantom(phantom, 6, "small-strain")
