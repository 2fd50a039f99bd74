"""Poisson's ratio with a width against λ and μ both free, when something that was given is wrong.

    python Testing/benchmarks/poisson.py

Squares of two triangles, a disc of 3 : 1 that the labels do not show, two pushes of 5 %, 2 % of
noise. Truth: quadratic quadrilaterals of a finer mesh, with a ν of its own for pad, tissue and
disc, and a stretch out of the plane. The flat guess has contrast 1.
"""

import warnings

import elastoidentify as ei
import numpy as np
import skfem
from elastoidentify.fem.forward import square_mesh
from skfem.helpers import ddot, sym_grad, trace

SIDE, STRIP, CENTRE, RADIUS, CONTRAST, MU, NOISE = 30.0, 7.5, (15.0, 12.0), 6.0, 3.0, 1 / 2.9, 0.02
PUSHES = ((0.0, -1.5), (-1.06, -1.06))
CASES = {  # true ν of pad, tissue, disc; ν that is said of the pad; stretch out of the plane
    "ν 0.45": ((0.45, 0.45, 0.45), 0.45, 0.0),
    "disc 0.49 in 0.45": ((0.45, 0.45, 0.49), 0.45, 0.0),
    "pad said 0.40, all 0.45": ((0.45, 0.45, 0.45), 0.40, 0.0),
    "pad said 0.45, all 0.49": ((0.49, 0.49, 0.49), 0.45, 0.0),
    "0.5 % out of the plane": ((0.45, 0.45, 0.45), 0.45, 0.005),
}
WAYS = {
    "λ, μ": {"unknowns": "lambda-mu"},
    "0.45 ± 0.05": {"unknowns": "young", "poisson_ratio": 0.45, "poisson_std": 0.05},
    "0.49 ± 0.05": {"unknowns": "young", "poisson_ratio": 0.49, "poisson_std": 0.05},
    "0.45": {"unknowns": "young", "poisson_ratio": 0.45},
}


def truth(points: np.ndarray, ratios, stretch: float) -> np.ndarray:
    """Return the displacements (2, n, 2) of both pushes."""
    line = np.linspace(0, SIDE, 49)
    mesh = skfem.MeshQuad.init_tensor(line, line)
    basis = skfem.Basis(mesh, skfem.ElementVector(skfem.ElementQuad2()), intorder=5)

    def lame(w):
        inside = sum((x - c) ** 2 for x, c in zip(w.x, CENTRE, strict=True)) < RADIUS**2
        nu = np.where(w.x[1] > SIDE - STRIP, ratios[0], np.where(inside, ratios[2], ratios[1]))
        mu = MU * np.where(inside, CONTRAST, 1.0)
        return 2 * mu * nu / (1 - 2 * nu), mu

    @skfem.BilinearForm
    def stiffness(u, v, w):
        lam, mu = lame(w)
        strains = sym_grad(u), sym_grad(v)
        return lam * trace(strains[0]) * trace(strains[1]) + 2 * mu * ddot(*strains)

    @skfem.LinearForm
    def across(v, w):
        return -stretch * lame(w)[0] * trace(sym_grad(v))

    K, f = stiffness.assemble(basis), across.assemble(basis)
    top = basis.get_dofs(lambda x: np.isclose(x[1], SIDE))
    floor = basis.get_dofs(lambda x: np.isclose(x[1], 0))
    held = np.union1d(top.all(), floor.all())
    probe = basis.probes(np.clip(points.T, 1e-9, SIDE - 1e-9))
    found = []
    for push in PUSHES:
        u = np.zeros(basis.N)
        for axis, size in enumerate(push):
            u[top.all([f"u^{axis + 1}"])] = size
        u = skfem.solve(*skfem.condense(K, f, x=u, D=held))
        found.append((probe @ u).reshape(2, -1).T)
    return np.array(found)


def main() -> None:
    """Print the table."""
    points, cells = square_mesh(16, 16, SIDE, SIDE)
    centre = points[cells].mean(axis=1)
    from_centre = np.linalg.norm(centre - CENTRE, axis=1)
    known = centre[:, 1] > SIDE - STRIP
    inside, far = from_centre < RADIUS, (from_centre > 9) & ~known
    held = np.isclose(points[:, 1] % SIDE, 0)
    print("| truth | unknowns | contrast (3) | ν | cells left open | noise found / put in |")
    print("|---|---|---|---|---|---|")
    for name, (ratios, said, stretch) in CASES.items():
        exact = truth(points, ratios, stretch)
        std = NOISE * np.abs(exact).max()
        given = np.where(known[:, None], [2 * MU * (1 + said), said], np.nan)
        for way, options in WAYS.items():
            for seed in (1, 2):
                u = exact + std * np.random.default_rng(seed).standard_normal(exact.shape)
                result = ei.identify(
                    points, cells, u, given, reaction_nodes=held, method="regularized", refine=1,
                    **options,
                )  # fmt: skip
                mu, open_ = result.mu, np.isnan(result.mu[~known]).sum()
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")  # medians of nothing but NaN
                    contrast = np.nanmedian(mu[inside]) / np.nanmedian(mu[far])
                    nu = np.nanmedian(result.poisson[far])
                print(
                    f"| {name} | {way} | {contrast:.2f} | {nu:.3f} "
                    f"| {open_} of {(~known).sum()} "
                    f"| {result.report['noise_scale'] / std:.2f} |",
                    flush=True,
                )


if __name__ == "__main__":
    main()
