"""Benchmark of the identification methods; prints Markdown tables.

    python Testing/benchmarks/identification.py [noise published bias volume coverage speed million]

Without arguments all sections but the last. Times are processor time as multiples of one forward
solve of the same mesh (scikit-fem assembly and scipy's sparse LU) measured in the same run; set
OMP_NUM_THREADS=1 for figures that other work on the machine disturbs least.
"""

import resource
import sys
import time
import warnings
from functools import partial
from pathlib import Path

import elastoidentify as ei
import numpy as np
import scipy.sparse.linalg as spl
import skfem
from elastoidentify.fem.elastic_constants import lame_from_young
from elastoidentify.fem.forward import solve_push, square_mesh
from skfem.models.elasticity import lame_parameters, linear_elasticity

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
import forward

# the tables that this makes are those of plain cells; volumes.py has the others
identify = partial(ei.identify, element="linear")

OPENQSEI = (0.125, 0.162, 0.197, 0.247, 0.253, 0.269, 0.267)
PROX_TV = (0.099, 0.086, 0.178, 0.204, 0.215, 0.226, 0.241)
LEVELS = (0.3, 1.7, 3.5, 5.3, 7.1, 9.0, 10.9)


def row(*cells):
    print("| " + " | ".join(str(cell) for cell in cells) + " |", flush=True)


def header(title, *cells):
    print(f"\n### {title}\n")
    row(*cells)
    row(*["---"] * len(cells))


def forward_solve(points, cells, fixed):
    """Processor time of one forward solve: assembly, factorisation, solution."""
    start = time.process_time()
    mesh = skfem.MeshTri(points.T.copy(), cells.T.copy())
    basis = skfem.Basis(mesh, skfem.ElementVector(skfem.ElementTriP1()))
    K = linear_elasticity(*lame_parameters(1.0, 0.43)).assemble(basis)
    free = np.flatnonzero(~np.repeat(fixed, 2))
    spl.splu(K[free][:, free].tocsc()).solve(np.ones(len(free)))
    return time.process_time() - start


def timed(points, cells, u, known, **settings):
    start = time.process_time()
    result = identify(points, cells, u, known, **settings)
    return result, time.process_time() - start


def fixed_nu(case):
    return {
        "reaction_nodes": case.reaction, "unknowns": "young", "poisson_ratio": case.poisson
    }  # fmt: skip


def noise_section():
    """Methods × noise × mesh size: median and mean relative error of E over the unknown cells."""
    header(
        "Methods, noise and mesh size (inclusion 3:1, ν = 0.43 fixed, two trials)",
        "squares", "noise", "method", "determined", "median error", "mean error",
        "flat guess: median", "mean", "inclusion (3)", "forward solves",
    )  # fmt: skip
    for n in (8, 16, 24):
        case = forward.squares(n)
        unit = min(forward_solve(case.points, case.cells, case.reaction) for _ in range(3))
        unknown = ~case.known
        flat = np.abs(1 / case.young - 1)[unknown]
        for level in (0.0, 1e-5, 1e-3, 5e-3, 2e-2):
            u = case.noisy(level * np.abs(case.displacements).max(), seed=1)
            for method in ("sequential", "global", "regularized"):
                result, cost = timed(
                    case.points, case.cells, u, case.materials, method=method, **fixed_nu(case)
                )
                error = np.abs(result.young / case.young - 1)[unknown]
                some = np.isfinite(error).any()
                row(
                    f"{n}×{n}", f"{level:g}", method, f"{np.isfinite(error).mean():.0%}",
                    f"{np.nanmedian(error):.3f}" if some else "–",
                    f"{np.nanmean(error):.3f}" if some else "–",
                    f"{np.median(flat):.3f}", f"{flat.mean():.3f}",
                    f"{np.nanmedian(result.young[case.young > 1]):.2f}" if some else "–",
                    f"{cost / unit:.1f}",
                )  # fmt: skip


def published_section(draws=3):
    """RMS of 2(E−Ê)/(E+Ê), one setting for all levels."""
    header(
        "Published comparison problem (5:1, ν = 0.495 fixed, one trial)",
        "noise, % (L2)", "ours, mesh follows the edge", "ours, mesh cuts the edge",
        "ours, as posed: nodal moduli, plain cells that made the data", "flat guess",
        "OpenQSEI", "prox-TV", "asked for",
    )  # fmt: skip
    cases = [(forward.published(follows_edge=follows), None) for follows in (True, False)]
    cases.append((forward.published_nodal(), 1))

    def score(case, young):
        ratio = 2 * (case.young - young) / (case.young + young)
        return np.sqrt(np.mean(ratio[~case.known] ** 2))

    for level, open_qsei, prox in zip(LEVELS, OPENQSEI, PROX_TV, strict=True):
        scores = []
        for case, refine in cases:
            std = level / 100 * np.sqrt((case.displacements**2).mean())
            found = [
                score(case, identify(
                    case.points, case.cells, case.noisy(std, seed), case.materials,
                    method="regularized", refine=refine, **fixed_nu(case),
                ).young)
                for seed in range(draws)
            ]  # fmt: skip
            scores.append(f"{np.mean(found):.3f} ({min(found):.3f}–{max(found):.3f})")
        asked = open_qsei * (0.5 if level <= 5.3 else 2 / 3)
        row(level, *scores, f"{score(cases[0][0], 1.0):.3f}", open_qsei, prox, f"{asked:.3f}")


def bias_section():
    """What the mesh does to the map when displacements are exact: E of the inclusion, for 3."""
    header(
        "Mesh bias: inclusion found (3), background (1); exact displacements, 16×16 squares",
        "ν", "refine 1", "refine 4", "refine 16",
    )  # fmt: skip
    for poisson in (0.3, 0.43, 0.47, 0.495):
        case = forward.squares(16, poisson=poisson, radius=0.2)
        std = 1e-3 * np.abs(case.displacements).max()  # the least that keeps the fit honest
        cells = []
        for refine in (1, 4, 16):
            result = identify(
                case.points, case.cells, case.noisy(std, 0), case.materials, refine=refine,
                method="regularized", **fixed_nu(case),
            )  # fmt: skip
            inner = np.median(result.young[case.from_edge < -1])
            outer = np.median(result.young[(case.from_edge > 1) & ~case.known])
            cells.append(f"{inner:.2f}, {outer:.3f}")
        row(poisson, *cells)


def volume_section(sizes=(5, 7)):
    """What coarse hexahedra do to the map of a ball of 3:1, beside one refinement of the fit."""
    header(
        "Coarse volumes: ball found (3), background (1); 1 % noise, four trials, ν = 0.43",
        "hexahedra", "unknowns", "sub-cells", "ball", "background", "mean error", "flat guess",
    )  # fmt: skip
    for n in sizes:
        case = forward.boxes(n, radius=9.0)
        u = case.noisy(0.01 * np.abs(case.displacements).max(), seed=1)
        unknown, ball = ~case.known, case.young > 1
        labels = np.where(case.known, 3, np.where(ball, 2, 1))
        for grouping in ("label", "cell"):
            for refine in (1, 4):
                found = identify(
                    case.points, case.cells, u, case.materials, labels=labels, refine=refine,
                    grouping=grouping, method="regularized", **fixed_nu(case),
                ).young  # fmt: skip
                row(
                    f"{n}×{n}×{n}", grouping, {1: 1, 4: 8}[refine], f"{np.median(found[ball]):.2f}",
                    f"{np.median(found[unknown & (case.from_edge > 2)]):.3f}",
                    f"{np.abs(found / case.young - 1)[unknown].mean():.3f}",
                    f"{np.abs(1 / case.young - 1)[unknown].mean():.3f}",
                )  # fmt: skip


def coverage_section(draws=100):
    """Share of cells, away from the inclusion's edge, whose truth is within 2 std."""
    header(
        f"Honesty of the standard deviations: truth within 2 std, {draws} draws",
        "method", "noise", "within 2 std", "within 1 std", "typical std / value",
    )  # fmt: skip
    case = forward.squares(12)
    away = (np.abs(case.from_edge) > 2.5) & ~case.known
    for level in (0.005, 0.02):
        std = level * np.abs(case.displacements).max()
        _cover_row(case, "regularized", level, draws, away, std, case.displacements, case.mu)
    # global: data that its own equations can satisfy, at noise where it works
    lam, mu = lame_from_young(case.young, case.poisson)
    y = case.points[:, 1]
    moved = np.flatnonzero(case.reaction)
    exact = np.array([
        solve_push(case.points, case.cells, lam, mu, moved, np.where(y[moved, None] > 0, push, 0.0))
        for push in ((0, -1.5), (-1.06, -1.06))
    ])  # fmt: skip
    for level in (1e-6, 1e-5):
        std = level * np.abs(exact).max()
        _cover_row(case, "global", level, draws, ~case.known, std, exact, mu)


def _cover_row(case, method, level, draws, where, std, exact, mu):
    scores, spread = [], []
    for seed in range(draws):
        noise = np.random.default_rng(seed).standard_normal(exact.shape)
        result = identify(
            case.points, case.cells, exact + std * noise, case.materials, method=method,
            **fixed_nu(case),
        )  # fmt: skip
        error = (np.abs(result.mu - mu) / result.mu_std)[where]
        scores.append(error[np.isfinite(error)])
        spread.append(np.nanmedian((result.mu_std / mu)[where]))
    scores = np.concatenate(scores)
    within = [f"{np.mean(scores < k):.1%}" for k in (2, 1)]
    row(method, f"{level:g}", *within, f"{np.median(spread):.3f}")


def speed_section(sizes=((316, "sequential"), (100, "global"), (100, "regularized"))):
    """Processor time as a multiple of one forward solve of the same mesh; peak memory."""
    header(
        "Speed",
        "method", "triangles", "unknowns", "forward solves", "determined", "worst error",
        "peak memory of the run so far, GiB",
    )  # fmt: skip
    for n, method in sizes:
        points, cells = square_mesh(n, n, forward.SIDE, forward.SIDE)
        centre = points[cells].mean(axis=1)
        known = np.where((centre[:, 1] > 22.5)[:, None], [1.0, 0.43], np.nan)
        unknown = np.isnan(known[:, 0])
        rng = np.random.default_rng(0)
        young = np.where(unknown, rng.uniform(0.5, 2.0, len(cells)), 1.0)
        y = points[:, 1]
        ends = (y == 0) | (y == forward.SIDE)
        unit = min(forward_solve(points, cells, ends) for _ in range(2))
        noise = 0.0
        settings = {"method": method, "reaction_nodes": ends}
        if method == "regularized":
            young = np.where(np.hypot(*(centre - [15, 12]).T) < 4.5, 3.0, 1.0)
            settings |= {"unknowns": "young", "poisson_ratio": 0.43}
            noise = 0.005
        lam, mu = lame_from_young(young, 0.43)
        moved = np.flatnonzero(ends)
        u = np.array([
            solve_push(points, cells, lam, mu, moved, np.where(y[moved, None] > 0, push, 0.0))
            for push in ((0, -1.5), (-1.06, -1.06))
        ])  # fmt: skip
        u = u + noise * np.abs(u).max() * rng.standard_normal(u.shape)
        result, cost = timed(points, cells, u, known, **settings)
        error = np.abs(result.mu / mu - 1)[unknown]
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
        typical = np.nanmedian(error) if method == "regularized" else np.nanmax(error)
        row(
            method, len(cells), unknown.sum() * (1 if method == "regularized" else 2),
            f"{cost / unit:.1f}", f"{np.isfinite(error).mean():.0%}",
            f"{typical:.1e}" + (" (median)" if method == "regularized" else ""), f"{peak:.1f}",
        )  # fmt: skip


def million_section():
    """How the walk grows with the mesh, to a million triangles."""
    speed_section([(n, "sequential") for n in (100, 224, 500, 708)])


SECTIONS = {
    "noise": noise_section,
    "published": published_section,
    "bias": bias_section,
    "volume": volume_section,
    "coverage": coverage_section,
    "speed": speed_section,
    "million": million_section,
}

if __name__ == "__main__":
    warnings.simplefilter("ignore", RuntimeWarning)  # medians of cells that are all NaN
    chosen = sys.argv[1:] or [name for name in SECTIONS if name != "million"]
    unknown_names = sorted(set(chosen) - set(SECTIONS))
    if unknown_names:
        sys.exit(f"unknown section {', '.join(unknown_names)}: choose from {', '.join(SECTIONS)}")
    for name in chosen:
        SECTIONS[name]()
