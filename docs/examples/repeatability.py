"""Measured twice: how large a change is real?

Ten blocks, each measured twice, with an error of 0.05 mm at every node that is redrawn. The
repeatability coefficient (RC) says which change of one subject is more than the measurement's own
scatter, with 95 % confidence. `elastoidentify repeatability` prints the same of maps and tables.
"""

import numpy as np
from elastoidentify.export.repeatability import draw_bland_altman, repeatability_by_label
from elastoidentify.imaging.phantom import Inclusion, make_phantom
from elastoidentify.pipeline import make_mesh, run
from elastoidentify.study import Study

subjects = []
for number in range(10):
    rng = np.random.default_rng(number)
    lesion = Inclusion(radius=rng.uniform(0.14, 0.2), contrast=rng.uniform(1.5, 5.0))
    block = make_phantom(inclusions=[lesion], pixels=80, elements=24)
    study = Study(
        segmentation=block.segmentation,
        edge_length=10 * block.rest.spacing[0],
        rigid_labels=block.rigid_labels,
        known_materials=[(1, 5000.0, 0.45)],
        method="regularized",
        grouping="label",
        noise=0.05,  # mm
    )
    mesh = make_mesh(study)
    exact = block.displacements(mesh.points)
    tables = []
    for _ in range(2):
        measured = exact + rng.normal(0, 0.05, exact.shape) * [1, 1, 0]
        tables.append(run(study, mesh=mesh, displacements=measured).result.statistics)
    subjects.append(tables)

found, repeats, _ = repeatability_by_label(subjects, "Mu mean")
for one in found:
    print(f"label {one.label}: wCV {one.within_cv:.1f} %, RC {one.rc_percent:.1f} %")

draw_bland_altman("repeatability.png", found, repeats)
