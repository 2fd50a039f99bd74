"""Which assumption the displacements prefer, where one of those given is wrong, and where none is.

    python Testing/benchmarks/exploration.py [draws, 6] [squares across, 12]

Forward data from `Testing/broken.py` and `Testing/slipping.py`: quadratic quadrilaterals of
scikit-fem on a finer mesh, pad and tissue two bodies in contact where they slide; a lesion of 3:1
that has no label; two pushes of 5 %, noise of 1 % of the push, white, or alike over neighbouring
nodes as that of a registration is. Given: Young's modulus sought with ν = 0.45, stuck, plane
strain. "preferred" counts draws by the assumption that is preferred; the last column has noise
(times that under what was given) and evidence, of the first draw and, in brackets, the most
favourable for that assumption of all draws.
"""

import sys
from collections import Counter
from functools import cache
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

import broken
import slipping
from contact import glued
from elastoidentify.exploration import explore, summary

NOISE = 0.015  # mm; 1 % of the push
THIN = 0.45 / 1.45  # ν of plane strain that looks like ν = 0.45 in plane stress
bodies, slabs = cache(broken.body), cache(slipping.slab)
YOUNG = {"unknowns": "young", "poisson_ratio": 0.45}
FREE = {"unknowns": "lambda-mu"}


def square(length=0.0, said=None, **kind):
    """Return a function of draw and squares that gives what :func:`explore` takes."""

    def made(seed, n):
        body = bodies(n=n, **kind)
        # the plane stress of a thin pad is the plane strain of the body that was solved
        pad = (1.45 / (1 + THIN), 0.45) if said == "thin" else (1.0, body.poisson)
        u = body.correlated(NOISE, seed, length) if length else body.noisy(NOISE, seed)
        mesh = {"labels": body.labels, "reaction_nodes": body.reaction}
        return body.points, body.cells, u, {1: pad}, mesh

    return made


def slab(split=False, **kind):
    """Return such a function of two bodies in contact; `split`: with nodes of their own."""

    def made(seed, n):
        case = slabs(n, **kind)
        case = case if split else glued(case)
        share = NOISE / np.sqrt((case.displacements**2).mean())
        mesh = {"labels": case.labels, "reaction_nodes": case.reaction}
        known = {1: (slipping.E_PAD, slipping.POISSON)}
        return case.points, case.cells, case.noisy(share, seed), known, mesh

    return made


SLIP = {"slip": [(1, 2)]}
CASES = {  # what is true; how it is made; what is given; what should be preferred
    "sound": (square(), YOUNG, {"given"}),
    "sound, errors alike over 4 mm": (square(4.0), YOUNG, {"given"}),
    "sound, λ and μ sought": (square(), FREE, {"given"}),
    "ν 0.49": (square(kind="poisson", true_poisson=0.49), YOUNG, {"poisson", "lambda_mu"}),
    "ν 0.47": (square(kind="poisson", true_poisson=0.47), YOUNG, {"poisson", "lambda_mu"}),
    "ν 0.40": (square(kind="poisson", true_poisson=0.40), YOUNG, {"poisson", "lambda_mu"}),
    "stretched by 0.5 %": (square(kind="stretch"), YOUNG, {"stretch"}),
    "thin (plane stress)": (square(poisson=THIN, said="thin"), YOUNG, {"plane_stress"}),
    "slides": (square(kind="slip"), YOUNG, {"slip"}),
    "slides, arched": (slab(surface=slipping.arched), YOUNG, {"slip"}),
    "slides, as given": (slab(split=True), YOUNG | SLIP, {"given"}),
    "stuck, slip given": (slab(split=True, stuck=True), YOUNG | SLIP, {"stuck"}),
}


def draw(made, given, seed, n):
    """Return the summary of one draw."""
    points, cells, u, known, mesh = made(seed, n)
    information = np.broadcast_to(np.eye(2) / NOISE**2, (*u.shape, 2))
    given = given | {"information": information, "refine": 1}
    return summary(explore(points, cells, u, known, **mesh, **given))


def figures(said):
    """Return noise and evidence of each assumption, of the first and of the luckiest draw."""
    out = []
    for several in zip(*(one["rows"][1:] for one in said), strict=True):
        name, first = several[0]["assumption"], several[0]
        tried = [row for row in several if not row["refused"]]
        if not tried or first["refused"]:
            out.append(f"{name} refused")
            continue
        best = max(tried, key=lambda row: row["evidence"])
        both = [f"{row['noise']:.2f}, {row['evidence']:+.0f}" for row in (first, best)]
        out.append("{} {} ({})".format(name, *both))
    return "; ".join(out)


def main(draws=6, n=12, *names):
    print("| truth | right | preferred | noise, evidence |")
    print("|---|---|---|---|", flush=True)
    for name, (made, given, right) in CASES.items():
        if names and not any(one in name for one in names):
            continue
        said = [draw(made, given, seed, int(n)) for seed in range(int(draws))]
        found = Counter(one["preferred"] for one in said)
        good = sum(found[one] for one in right)
        counts = ", ".join(f"{key} {count}" for key, count in found.most_common())
        print(f"| {name} | {good} of {draws} | {counts} | {figures(said)} |", flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
