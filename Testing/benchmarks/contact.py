"""A hidden lesion under a pad that slides without friction, told and not told.

    python Testing/benchmarks/contact.py [squares across, 12]

Forward data from `Testing/slipping.py`: two bodies of quadratic quadrilaterals three times as fine,
in contact without friction; a lesion of 3:1 which has no label, noise as a share of the root mean
square displacement.
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

import elastoidentify as ei
import slipping


def glued(case):
    """Return the case with one node per place, which moves as the mean of both sides."""
    places = np.round(case.points, 6)
    points, node, count = np.unique(places, axis=0, return_inverse=True, return_counts=True)
    node = node.ravel()
    mean = np.zeros((len(case.displacements), *points.shape))
    for total, one in zip(mean, case.displacements, strict=True):
        np.add.at(total, node, one)
    return replace(case, points=points, cells=node[case.cells], displacements=mean / count[:, None])


def row(case, noise, kinematics, slip):
    """Return what is found: contrast, tissue, factor between found and stated noise."""
    size = noise * np.sqrt((case.displacements**2).mean())
    try:
        result = ei.identify(
            case.points, case.cells, case.noisy(noise), {1: (slipping.E_PAD, slipping.POISSON)},
            labels=case.labels, reaction_nodes=case.reaction, slip=slip, noise=size,
            kinematics=kinematics, method="regularized",
        )  # fmt: skip
    except ei.InputError as refused:
        return f"refused: {refused}"[:60]
    contrast, tissue = case.contrast(result.young)
    verdict = result.report["verdict"]
    return f"{contrast:.2f} | {tissue:.2f} | {verdict['noise_factor']:.2f} | {verdict['level']}"


def main(n=12):
    print("| interface | kinematics | noise | model | lesion (3) | tissue (3) | noise | verdict |")
    print("|---|---|---|---|---|---|---|---|", flush=True)
    for surface in (slipping.flat, slipping.arched):
        for kinematics in ("small-strain", "neo-hookean"):
            case = slipping.slab(n, surface, kinematics)
            for noise in (0.005, 0.02):
                for model, one, slip in (("slip", case, [(1, 2)]), ("stuck", glued(case), ())):
                    found = row(one, noise, kinematics, slip)
                    print(
                        f"| {surface.__name__} | {kinematics} | {noise:.1%} | {model} | {found} |",
                        flush=True,
                    )


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
