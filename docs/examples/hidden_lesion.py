"""A lesion that nobody has drawn

The same block, but the segmentation knows only pad and tissue. Every cell has its own λ and μ;
the lesion is where the map says so. A smaller, stiffer lesion moves nearly as a larger, softer
one: read where it is and that it is stiff, and its value with care.
"""

import numpy as np
from elastoidentify.imaging.phantom import Inclusion, make_phantom
from elastoidentify.pipeline import run
from elastoidentify.study import Study
from elastoidentify.vtk_io.arrays import write_outcome
from elastoidentify.vtk_io.picture import draw

lesion = Inclusion(x=0.42, y=0.6, radius=0.18, contrast=4.0)
block = make_phantom(
    inclusions=[lesion], pixels=80, elements=24, kinematics="neo-hookean", noise=0.01
)
labels = block.segmentation.array
hidden = block.segmentation.with_array(np.where(labels == 3, 2, labels))

outcome = run(
    Study(
        segmentation=hidden,
        rest=block.rest,
        pushed=block.pushed,
        edge_length=8 * block.rest.spacing[0],
        rigid_labels=block.rigid_labels,
        known_materials=[(1, 5000.0, 0.45)],
        kinematics="neo-hookean",
    )
)

centres = outcome.mesh.points[outcome.mesh.cells].mean(axis=1)
x, y = block.frame.to_body(centres).T / [[block.frame.width], [block.frame.height]]
inside = np.hypot(x - lesion.x, y - lesion.y) < lesion.radius
around = (outcome.mesh.labels == 2) & ~inside
mu = outcome.result.mu
print(f"μ in the lesion: median {np.median(mu[inside]):.0f} Pa, truth {12000 / 2.9:.0f}")
print(f"μ around it: median {np.median(mu[around]):.0f} Pa, truth {3000 / 2.9:.0f}")
stiff = mu > 2 * np.median(mu[around])
found = (stiff & inside).sum() / inside.sum()
print(f"{100 * found:.0f} % of the lesion's cells are more than twice as stiff as the tissue")

draw("hidden_lesion.png", write_outcome(outcome), block.rest)
