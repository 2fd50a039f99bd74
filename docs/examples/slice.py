"""A slice, from images to the map

A block of speckle under a pad, imaged at rest and in two pushes. The segmentation shows the
inclusion, which is three times as stiff as the tissue. The pad's E and ν are all that is given.
"""

from elastoidentify.imaging.phantom import make_phantom
from elastoidentify.pipeline import run
from elastoidentify.study import Study
from elastoidentify.vtk_io.arrays import write_outcome
from elastoidentify.vtk_io.picture import draw

block = make_phantom(pixels=80, elements=24, kinematics="neo-hookean", noise=0.01)
study = Study(
    segmentation=block.segmentation,
    rest=block.rest,
    pushed=block.pushed,
    edge_length=12 * block.rest.spacing[0],  # twelve pixels
    rigid_labels=block.rigid_labels,  # indenter and floor
    known_materials=[(1, 5000.0, 0.45)],  # the pad: E in Pa, ν
    kinematics="neo-hookean",  # the push is larger than 2 % of strain
)
outcome = run(study)

print(outcome.result.report["verdict"]["sentence"])
true = {label: material.young for label, material in block.materials.items()}
for row in outcome.result.statistics:
    if not row["given"]:
        label = row["label"]
        young, error = row["YoungModulus mean"], row["YoungModulus standard error"]
        print(f"label {label}: E {young:.0f} ± {error:.0f} Pa, truth {true[label]:.0f}")

draw("slice.png", write_outcome(outcome), block.rest)
