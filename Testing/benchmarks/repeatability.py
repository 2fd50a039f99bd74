"""Test and retest: the same block imaged twice, its images noisy anew and segmented anew.

    python Testing/benchmarks/repeatability.py --pairs 36 --out repeatability.json

Every pair is a block of its own: another texture, inclusion and contrast. Both measurements have
redrawn Rician noise of 2 %, and a segmentation of their own, whose pad border, inclusion centre and
inclusion radius are off by up to 1 mm each. The push is solved on quadratic quadrilaterals, on a
grid that no identification uses. ``--cause`` tells where the scatter comes from, in seconds per
pair: the nodes have their true displacement, and only the segmentation is another, or only white
noise of 0.05 pixels is. Printed are the figures per label of
:mod:`elastoidentify.export.repeatability`, and how far the means are from the truth.
"""

import argparse
import json
import time
from pathlib import Path

import numpy as np
from elastoidentify.export.repeatability import repeatability_by_label, repeatability_text
from elastoidentify.imaging.phantom import Inclusion, make_phantom
from elastoidentify.imaging.phantom.planar import rician
from elastoidentify.imaging.registration import register
from elastoidentify.pipeline import make_mesh, run
from elastoidentify.study import Study
from elastoidentify.workers.elastix_client import ElastixProcess

NOISE, JITTER = 0.02, 1.0  # of the signal, mm
NAMES = {1: "pad", 2: "tissue", 3: "inclusion"}


def body(seed: int, pixels: int):
    """Return a phantom without noise, of its own contrast, inclusion and texture."""
    rng = np.random.default_rng([11, seed])
    inclusion = Inclusion(
        rng.uniform(0.4, 0.6), rng.uniform(0.5, 0.65), rng.uniform(0.14, 0.2), rng.uniform(1.5, 5)
    )
    return make_phantom(
        inclusions=[inclusion], noise=0.0, seed=seed, pixels=pixels, elements=48,
        kinematics="neo-hookean", tissue_young=rng.uniform(2000, 6000),
    )  # fmt: skip


def segmented(phantom, rng):
    """Return a segmentation by another hand: borders off by up to JITTER in mm."""
    frame, image = phantom.frame, phantom.segmentation
    x, y = np.meshgrid(*frame.pixel_centres())
    disc = phantom.parameters["inclusions"][0]
    off = rng.uniform(-JITTER, JITTER, 4)
    distance = np.hypot(x - disc["x"] * frame.width - off[0], y - disc["y"] * frame.height - off[1])
    labels = image.array.reshape(x.shape).copy()
    block = np.isin(labels, list(NAMES))
    labels[block] = 2
    labels[block & (distance < disc["radius"] * frame.width + off[2])] = 3
    labels[block & (y < phantom.parameters["pad"] * frame.height + off[3])] = 1
    return image.with_array(labels.reshape(image.array.shape))


def measured(phantom, seed, edge, elastix=None):
    """Return the table of labels of one measurement.

    One elastix process does all registrations: its start takes longer than they do. The way back
    is left out: it tells of trust, and takes half of the time.
    """
    rng = np.random.default_rng([12, *seed])
    level = NOISE * np.percentile(phantom.rest.array, 99)

    def noisy(image):
        return image.with_array(rician(image.array, level, rng).astype(np.float32))

    study = study_of(
        phantom,
        edge,
        segmentation=segmented(phantom, rng),
        rest=noisy(phantom.rest),
        pushed=[noisy(image) for image in phantom.pushed],
    )
    mesh = make_mesh(study)
    found = register(
        study.rest, study.pushed, mesh.points, mesh.cells, backward=False, elastix=elastix
    )
    return run(study, mesh=mesh, registration=found, names=NAMES).result.statistics


def study_of(phantom, edge: float, **more) -> Study:
    """Return the study of a phantom, whichever way it is measured; edges in pixels."""
    pad = phantom.materials[1]
    return Study(
        edge_length=edge * float(phantom.rest.spacing[0]),
        rigid_labels=phantom.rigid_labels,
        known_materials=[(1, pad.young, pad.poisson)],
        unknowns="young",
        poisson_ratio=pad.poisson,
        method="regularized",
        kinematics="neo-hookean",
        **more,
    )


def measured_without_images(phantom, seed, edge, cause: str):
    """Return the table of labels where nothing but one cause of scatter acts."""
    rng = np.random.default_rng([12, *seed])
    pixel, by_hand = float(phantom.rest.spacing[0]), cause == "segmentation"
    segmentation = segmented(phantom, rng) if by_hand else phantom.segmentation
    study = study_of(phantom, edge, segmentation=segmentation, noise=0.05 * pixel)
    mesh = make_mesh(study)
    exact = phantom.displacements(mesh.points)
    noise = rng.normal(0, 0.005 if by_hand else 0.05 * pixel, exact.shape) * [1, 1, 0]
    return run(study, mesh=mesh, displacements=exact + noise, names=NAMES).result.statistics


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--pairs", type=int, default=36)
    parser.add_argument("--pixels", type=int, default=80)
    parser.add_argument("--edge", type=float, default=10, help="of the cells, in pixels")
    parser.add_argument("--out", type=Path)
    parser.add_argument("--cause", choices=("segmentation", "displacements"))
    arguments = parser.parse_args()
    with ElastixProcess() as elastix:
        subjects, errors = measure_all(arguments, elastix)
    report(subjects, errors)


def measure_all(arguments, elastix):
    """Return the tables of labels, pair by pair, and the relative errors of E by label."""
    start, subjects, errors = time.monotonic(), [], {2: [], 3: []}
    for number in range(arguments.pairs):
        phantom = body(number, arguments.pixels)
        subjects.append(
            [
                measured_without_images(phantom, (number, repeat), arguments.edge, arguments.cause)
                if arguments.cause
                else measured(phantom, (number, repeat), arguments.edge, elastix)
                for repeat in (0, 1)
            ]
        )
        for rows in subjects[-1]:
            for row in rows:
                if row["label"] in errors:
                    young = phantom.materials[row["label"]].young
                    errors[row["label"]].append(row["YoungModulus core"] / young - 1)
        print(f"pair {number + 1}: {time.monotonic() - start:.0f} s", flush=True)
        if arguments.out:
            arguments.out.write_text(json.dumps(subjects, indent=1), encoding="utf-8")
    return subjects, errors


def report(subjects, errors):
    """Print the figures."""
    for column in ("Mu core", "Mu mean", "Mu ratio"):
        found, _, notes = repeatability_by_label(subjects, column)
        print(repeatability_text(found), *notes, sep="\n")
    for label, off in errors.items():
        print(
            f"{NAMES[label]}: mean error of its core's E {100 * np.nanmean(off):+.1f} %, "
            f"root mean square {100 * np.sqrt(np.nanmean(np.square(off))):.1f} %"
        )


if __name__ == "__main__":
    main()
