"""Displacements from a registration elsewhere

Whoever has registered already, with elastix or in 3D Slicer, brings the transforms: files of ITK
(`.h5`, `.tfm`), rest image fixed. Here they are written by SimpleITK from the true push, with an
error of 0.02 mm at every grid point, and read at the nodes of the mesh.
"""

import numpy as np
import SimpleITK as sitk
from elastoidentify import identify
from elastoidentify.imaging.meshing import mesh_segmentation
from elastoidentify.imaging.phantom import make_phantom
from elastoidentify.imaging.registration.sources import displacement_from_transform
from matplotlib import pyplot as plt

block = make_phantom(pixels=80, elements=24, kinematics="neo-hookean")
image, rng = block.rest, np.random.default_rng(0)

# what a registration leaves behind: a displacement field with a vector per pixel
nodes = np.stack(np.meshgrid(*(np.arange(0, n) for n in image.size[:2])), axis=-1)
places = image.origin + (nodes * image.spacing[:2]) @ image.direction[:, :2].T
for trial, field in enumerate(block.displacements(places.reshape(-1, 3)), 1):
    vectors = field.reshape(places.shape)[..., :2] + rng.normal(0, 0.02, (*places.shape[:2], 2))
    grid = sitk.GetImageFromArray(vectors, isVector=True)
    grid.SetSpacing(image.spacing[:2].tolist())
    grid.SetOrigin(image.origin[:2].tolist())
    transform = sitk.DisplacementFieldTransform(grid)
    sitk.WriteTransform(transform, f"push_{trial}.h5")

mesh = mesh_segmentation(block.segmentation, 12 * image.spacing[0], rigid_labels=block.rigid_labels)
measured = [
    displacement_from_transform(f"push_{trial}.h5", mesh.points, noise=0.02) for trial in (1, 2)
]
result = identify(
    mesh.points,
    mesh.cells,
    np.array([one.displacement for one in measured]),
    {1: (5000.0, 0.45)},
    labels=mesh.labels,
    reaction_nodes=mesh.reaction_nodes.astype(bool),
    noise=0.02,
    method="regularized",
    kinematics="neo-hookean",
)

for row in result.statistics[1:]:
    true = block.materials[row["label"]].young / 2.9
    value, error = row["Mu mean"], row["Mu standard error"]
    print(f"label {row['label']}: μ {value:.0f} ± {error:.0f} Pa, truth {true:.0f}")

shown = plt.tripcolor(*mesh.points[:, :2].T, mesh.cells, facecolors=result.mu / 1000)
plt.colorbar(shown, label="μ (kPa)")
plt.gca().invert_yaxis()
plt.axis("equal")
plt.savefig("transforms.png")
