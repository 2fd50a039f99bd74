"""A region inside a larger body, as ultrasound sees it

The image shows a part of the tissue only: body goes on at both sides and below. No force balance
is asked at the image's border (the default), so what pushes there need not be known. The pad, a
layer of gel of known stiffness, is seen from side to side.
"""

import numpy as np
from elastoidentify.imaging.image import Image
from elastoidentify.imaging.phantom import Inclusion, make_phantom
from elastoidentify.pipeline import run
from elastoidentify.study import Study
from elastoidentify.vtk_io.arrays import write_outcome
from elastoidentify.vtk_io.picture import draw

lesion = Inclusion(x=0.5, y=0.5, radius=0.13, contrast=3.0)
body = make_phantom(
    inclusions=[lesion], pixels=112, elements=32, kinematics="neo-hookean", noise=0.01
)


def seen(image: Image) -> Image:
    """Return what the probe sees: the middle of the body, without its sides and its floor."""
    first = np.add(body.frame.margin, (20, 4))  # column, row
    array = image.array[:, first[1] : first[1] + 90, first[0] : first[0] + 72]
    corner = image.origin + image.direction[:, :2] @ (first * image.spacing[:2])
    return Image(array, corner, image.spacing, image.direction)


outcome = run(
    Study(
        segmentation=seen(body.segmentation),
        rest=seen(body.rest),
        pushed=[seen(image) for image in body.pushed],
        edge_length=12 * body.rest.spacing[0],
        known_materials=[(1, 5000.0, 0.45)],
        kinematics="neo-hookean",
    )
)

print(outcome.result.report["verdict"]["sentence"])
mu = {row["label"]: row for row in outcome.result.statistics}
for label in (2, 3):
    true = body.materials[label].young / 2.9
    value, error = mu[label]["Mu mean"], mu[label]["Mu standard error"]
    print(f"label {label}: μ {value:.0f} ± {error:.0f} Pa, truth {true:.0f}")
open_cells = np.isnan(outcome.result.mu).sum()
print(f"{open_cells} of {len(outcome.result.mu)} cells are left open")

draw("region.png", write_outcome(outcome), seen(body.rest))
