"""Identify a real silicone cube from CT: `python Testing/benchmarks/truth_cube.py`.

The Truth Cube (Kerdok et al., Medical Image Analysis 7, 2003) is one silicone with 7 × 7 × 7 beads,
pushed along z. The beads are the nodes of 6 × 6 × 6 hexahedra. A layer of cells at one end is the
known pad, the others are identified: they must come out as stiff as the pad, and all alike. Every
bead on the lattice's outside bears forces of the silicone around it, so only the 125 inner beads
have a balance equation. A computed twin of the cube (quadratic elements, plates whose friction
gives the lateral stretch that was measured) tells what the same chain makes of a cube that is
certainly uniform, with and without the noise of the beads. Each of the 18 layers is the pad once,
so that one layer's deviation can be seen among others.

Reads `uniaxial_positions.csv` (see README.md beside it) from the folder given, by default
`../shared/data/truthcube` beside the repository.
"""

import argparse
import csv
import itertools
import json
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
import scipy.sparse as sp
from elastoidentify import InputError, identify
from elastoidentify.fem.elastic_constants import lame_from_young
from elastoidentify.imaging.registration.sources import displacement_from_points
from elastoidentify.inverse.result import IdentificationResult
from elastoidentify.progress import silent
from scipy.sparse.linalg import spsolve

FOLDER = Path(__file__).resolve().parents[3] / "shared" / "data" / "truthcube"
YOUNG = 15.3  # kPa, according to the data's README
POISSON = 0.49  # the material's 0.499 locks linear cells: see docs/evidence.md
NOISE = np.array([0.10, 0.27, 0.10])  # mm, of a bead's displacement along x, y, z
KINEMATICS = ("small-strain", "st-venant-kirchhoff", "neo-hookean")
BEADS, LAYERS = 7, 6
SLICE, ON_SLICES = 0.625, (0.81, 0.68)  # mm along y; share of the beads on a slice, rest and pushed
TWIN_POISSON = 0.495  # quadratic elements carry it
COMPRESSION, TOP_STRETCH, BOTTOM_STRETCH = 0.205, 0.02, 0.075  # see `layer_means`
PAD = 1  # label of the known layer
TWINS = {"twin, no noise": None, "twin, noise 1": 1, "twin, noise 2": 2}
CORNERS = ((0, 0), (1, 0), (1, 1), (0, 1))


@dataclass(frozen=True)
class TruthCube:
    """The beads as nodes of hexahedra; lengths in mm.

    Attributes
    ----------
    points : (343, 3)
    displacements : (3, 343, 3)
        At 5, 12.5 and 18.25 % compression.
    cells : (216, 8) int
    index : (216, 3) int
        Place of each cell along x, y and the axis of the push, 0 to 5; the last counts from the
        top (largest z) down to the end that moves.
    outside : (343,) bool
        Beads on the outside of the lattice.
    """

    points: np.ndarray
    displacements: np.ndarray
    cells: np.ndarray
    index: np.ndarray
    outside: np.ndarray

    @property
    def deformation_gradients(self) -> np.ndarray:
        """Mean deformation gradient of every cell and trial from its edges, (3, 216, 3, 3)."""
        rest, *pushed = (self._edges(x) for x in (self.points, *(self.points + self.displacements)))
        return np.array([one @ np.linalg.inv(rest) for one in pushed])

    def _edges(self, points: np.ndarray) -> np.ndarray:
        """Mean edge vectors of the cells as columns, (216, 3, 3)."""
        corner = points[self.cells]
        pairs = (((0, 1), (3, 2), (4, 5), (7, 6)), ((0, 3), (1, 2), (4, 7), (5, 6)))
        pairs += (((0, 4), (1, 5), (2, 6), (3, 7)),)
        edges = [np.mean([corner[:, b] - corner[:, a] for a, b in four], axis=0) for four in pairs]
        return np.stack(edges, axis=-1)


def read_truth_cube(folder: str | Path = FOLDER) -> TruthCube:
    """Read the beads of the uniaxial compression."""
    with open(Path(folder) / "uniaxial_positions.csv", newline="", encoding="utf-8") as file:
        lines = list(csv.reader(file))
    start = next(n for n, line in enumerate(lines) if line[0] == "i") + 1
    numbers = np.array([[float(v) for v in line[:15]] for line in lines[start:] if line[0]])
    numbers = numbers[np.lexsort(numbers[:, 2::-1].T)]  # by i, then j, then k
    expected = np.array(list(itertools.product(range(1, BEADS + 1), repeat=3)))
    if not np.array_equal(numbers[:, :3], expected):
        raise InputError("the table does not hold every bead of the 7 × 7 × 7 lattice once")
    states = numbers[:, 3:].reshape(-1, 4, 3).transpose(1, 0, 2)
    rest = states[0]
    tables = [np.c_[rest, state - rest] for state in states[1:]]
    displacements = [displacement_from_points(table, rest).displacement for table in tables]

    bead = np.arange(BEADS**3).reshape(3 * (BEADS,))
    index = np.array(list(itertools.product(range(LAYERS), repeat=3)))
    i, j, k = index.T
    # k counts against z: the lower four corners of a cell have the larger k
    corners = [bead[i + a, j + b, k + down] for down in (1, 0) for a, b in CORNERS]
    place = expected - 1
    outside = ((place == 0) | (place == LAYERS)).any(axis=1)
    return TruthCube(rest, np.array(displacements), np.stack(corners, 1), index, outside)


def twin(cube: TruthCube, seed: int | None = 0, rounded: bool = False) -> TruthCube:
    """Return a computed cube with one trial.

    Parameters
    ----------
    seed : int or None
        Of the beads' noise; None for none.
    rounded : bool
        The error along y is that of CT slices instead: most beads are put on the nearest slice. A
        plane of beads then errs together, which third differences do not see.
    """
    rest, moved = _twin()
    if seed is None:
        return replace(cube, points=rest, displacements=moved[None])
    random = np.random.default_rng(seed)
    noise = NOISE * random.standard_normal(moved.shape)
    if rounded:
        tilt = random.uniform(-0.005, 0.005, 2)  # of the cube in the scanner
        y = rest[:, 1] + 0.12 * random.standard_normal(len(rest)) + rest[:, [0, 2]] @ tilt
        states = [y + shift + random.uniform(0, SLICE) for shift in (0, moved[:, 1])]
        errors = [
            np.where(random.random(len(rest)) < share, SLICE * np.rint(one / SLICE) - one, 0.0)
            for one, share in zip(states, ON_SLICES, strict=True)
        ]
        noise[:, 1] = errors[1] - errors[0]
        rest = rest + np.outer(states[0] + errors[0] - rest[:, 1], [0, 1, 0])
    return replace(cube, points=rest, displacements=(moved + noise)[None])


@cache
def _twin() -> tuple[np.ndarray, np.ndarray]:
    """Solve a cube of 80 mm with beads 10 mm apart: their positions and displacements, (343, 3).

    A quarter of it, neo-Hookean, on quadratic hexahedra of 10 mm. The plates stretch by a given
    share, which stands for their friction, and the lower one is moved up.
    """
    import skfem

    side, lam, mu = 80.0, *lame_from_young(YOUNG, TWIN_POISSON)
    steps = np.linspace(0, side / 2, 5), np.linspace(0, side / 2, 5), np.linspace(0, side, 9)
    basis = skfem.Basis(skfem.MeshHex.init_tensor(*steps), skfem.ElementHex2(), intorder=4)
    points, dofs = basis.doflocs.T, basis.element_dofs.T
    shapes = np.array([basis.basis[a][0].grad for a in range(27)])  # (27, 3, elements, quadrature)
    shapes = np.broadcast_to(shapes, (27, 3, *basis.dx.shape))

    bottom, top = (np.isclose(points[:, 2], z) for z in (0, side))
    held = np.isclose(points, 0) & [True, True, False]
    held[bottom | top] = True
    target = np.zeros_like(points)
    for plate, stretch in ((bottom, BOTTOM_STRETCH), (top, TOP_STRETCH)):
        target[plate, :2] = stretch * points[plate, :2]
    target[bottom, 2] = COMPRESSION * side

    u, free = np.zeros_like(points), np.flatnonzero(~held)
    for share in (0.5, 1.0):
        step = np.where(held, share * target - u, 0.0)
        while np.abs(step).max() > 1e-4:
            stiffness, forces = _neo_hookean(shapes, basis.dx, dofs, u, lam, mu)
            step = np.where(held, share * target - u, 0.0)
            load = -forces - stiffness @ step.ravel()
            step.flat[free] = spsolve(stiffness[free][:, free].tocsc(), load[free])
            u = u + step

    bead = np.array(list(itertools.product(range(BEADS), repeat=3)))
    rest = 10.0 * (bead - [3, 3, 0]) * [1, 1, -1] + [0, 0, 70]
    distance = np.linalg.norm(points[None] - np.abs(rest)[:, None], axis=2)
    return rest, u[distance.argmin(axis=1)] * np.where(rest < 0, -1, 1)


def _neo_hookean(shapes, dx, dofs, u, lam, mu):
    """Return tangent stiffness (3n, 3n) and internal forces (3n,) of P = μ(F − F⁻ᵀ) + λ ln J F⁻ᵀ.

    `shapes` (a, 3, e, q): gradients of the shape functions; `dofs` (e, a): nodes of the elements.
    """
    F = np.einsum("eai,ajeq->eqij", u[dofs], shapes) + np.eye(3)
    inverse = np.linalg.inv(F)
    log = np.log(np.linalg.det(F))[..., None, None]
    stress = mu * (F - inverse.swapaxes(2, 3)) + lam * log * inverse.swapaxes(2, 3)
    local = np.einsum("ajeq,eqij,eq->eai", shapes, stress, dx)
    forces = np.zeros_like(u)
    np.add.at(forces, dofs, local)
    pulled = np.einsum("ajeq,eqji->eqai", shapes, inverse)  # gradients in the pushed state
    weight = (mu - lam * log) * dx[..., None, None]
    size = 3 * dofs.shape[1]
    blocks = np.einsum("eqak,eqbi,eq->eaibk", pulled, pulled, weight[..., 0, 0], optimize=True)
    blocks += lam * np.einsum("eqai,eqbk,eq->eaibk", pulled, pulled, dx, optimize=True)
    same = mu * np.einsum("ajeq,bjeq,eq->eab", shapes, shapes, dx, optimize=True)
    blocks += np.einsum("eab,ik->eaibk", same, np.eye(3))
    place = (3 * dofs[:, :, None] + np.arange(3)).reshape(len(dofs), size)
    rows, columns = np.repeat(place, size, axis=1), np.tile(place, size)
    entries = (blocks.ravel(), (rows.ravel(), columns.ravel()))
    return sp.csr_matrix(entries, (u.size, u.size)), forces.ravel()


def layer_means(cube: TruthCube) -> np.ndarray:
    """Return stretch − 1 along x and y and mean rise (mm) of each layer of beads, (t, 7, 3)."""
    rest = cube.points.reshape(*3 * (BEADS,), 3)
    moved = cube.displacements.reshape(-1, *3 * (BEADS,), 3)
    x = rest[..., 0].mean(axis=(1, 2))[:, None, None]
    y = rest[..., 1].mean(axis=(0, 2))[:, None]
    x, y = x - x.mean(), y - y.mean()
    along_x = (moved[..., 0] * x).mean(axis=(1, 2)) / (x**2).mean()
    along_y = (moved[..., 1] * y).mean(axis=(1, 2)) / (y**2).mean()
    return np.stack([along_x, along_y, moved[..., 2].mean(axis=(1, 2))], axis=-1)


def bead_noise(cube: TruthCube) -> np.ndarray:
    """Noise of the displacement (mm) along x, y, z from third differences over the lattice."""
    lattice = cube.displacements.reshape(-1, *3 * (BEADS,), 3)
    third = [np.diff(lattice, 3, axis=axis).reshape(-1, 3) for axis in (1, 2, 3)]
    third = np.concatenate(third) / np.sqrt(1 + 9 + 9 + 1)
    return 1.4826 * np.median(np.abs(third - np.median(third, axis=0)), axis=0)


def volume_ratios(cube: TruthCube) -> np.ndarray:
    """Volume of the lattice over that at rest, per trial."""
    rest = np.linalg.det(cube._edges(cube.points))
    return (np.linalg.det(cube.deformation_gradients) * rest).sum(1) / rest.sum()


def layers(cube: TruthCube, known: int) -> np.ndarray:
    """Label the known layer 1 and the other five 2 … 6."""
    return np.where(cube.index[:, 2] == known, PAD, _ranks(cube.index[:, 2] + 2, known + 2))


def columns(cube: TruthCube, known: int) -> np.ndarray:
    """Label the known layer 1 and nine columns of 2 × 2 × 5 cells below or above it 2 … 10."""
    column = 3 * (cube.index[:, 0] // 2) + cube.index[:, 1] // 2
    return np.where(cube.index[:, 2] == known, PAD, column + 2)


def rest_of_the_cube(cube: TruthCube, known: int, axis: int = 2) -> np.ndarray:
    """Label the known layer, counted along an axis, 1 and all other cells 2."""
    return np.where(cube.index[:, axis] == known, PAD, 2)


def _ranks(values, left_out):
    return values - (values > left_out)


def identify_cube(
    cube: TruthCube,
    labels: np.ndarray,
    *,
    kinematics: str = "neo-hookean",
    poisson: float = POISSON,
    grouping: str = "label",
    trials=(0, 1, 2),
    refine: int = 1,
    element: str = "locking-free",
    progress=silent,
) -> IdentificationResult:
    """Identify E (kPa) of all cells but those labelled 1, the noise of the beads as weight."""
    trials = list(trials)
    shape = (len(trials), len(cube.points), 3, 3)
    return identify(
        cube.points,
        [("hexahedron", cube.cells)],
        cube.displacements[trials],
        {PAD: (YOUNG, poisson)},
        labels=labels,
        reaction_nodes=cube.outside,
        method="regularized",
        element=element,
        kinematics=kinematics,
        unknowns="young",
        poisson_ratio=poisson,
        grouping=grouping,
        information=np.broadcast_to(np.diag(NOISE**-2.0), shape),
        refine=refine,
        progress=progress,
    )


def log_moduli(
    result: IdentificationResult, labels: np.ndarray, per_cell: bool = False
) -> tuple[np.ndarray, np.ndarray]:
    """Return log(E / E of the pad) and its predicted std, per label but the pad's, or per cell."""
    first = np.flatnonzero(labels != PAD)
    if not per_cell:
        first = np.unique(labels, return_index=True)[1][1:]
    return np.log(result.young[first] / YOUNG), result.mu_std[first] / result.mu[first]


def facts(cube: TruthCube) -> dict:
    """Return what the beads show without any identification."""
    mean = cube.deformation_gradients.mean(axis=1)
    axial = np.log(mean[:, 2, 2])
    lateral = np.log(mean[:, 0, 0] * mean[:, 1, 1]) / 2
    return {
        "noise_mm": bead_noise(cube).tolist(),
        "volume_ratios": volume_ratios(cube).tolist(),
        "axial_strain": (mean[:, 2, 2] - 1).tolist(),
        "poisson": (-lateral / axial).tolist(),
    }


def pad_over_rest(cube: TruthCube, known: int, axis: int = 2, **options) -> tuple[float, ...]:
    """Return log(E pad / E rest), its predicted standard deviation, and the report's noise."""
    labels = rest_of_the_cube(cube, known, axis)
    result = identify_cube(cube, labels, **options)
    (log,), (std,) = log_moduli(result, labels)
    return -log, std, result.report["noise_scale"]


def every_layer(cube: TruthCube, **options) -> np.ndarray:
    """Return :func:`pad_over_rest` with each layer as the pad, x, y, then z: (18, 3)."""
    places = itertools.product(range(3), range(LAYERS))
    return np.array([pad_over_rest(cube, layer, axis, **options) for axis, layer in places])


RATIO_HEAD = """
| body | kinematics | ν | pad | trials | refine | E pad / E rest | off by | noise |
|---|---|---|---|---|---|---|---|---|"""
LAYER_HEAD = """
E pad / E rest, last trial, each layer the pad once (z: top to bottom)
| ν | axis | body | 1 | 2 | 3 | 4 | 5 | 6 |
|---|---|---|---|---|---|---|---|---|"""
FLAT_HEAD = """
| body | kinematics | ν | trials | groups | spread of log E | predicted | E / E of the pad |
|---|---|---|---|---|---|---|---|"""


def print_ratio(body: str, cube: TruthCube, known: int, **options) -> None:
    """Print a table line: E of the pad over E of the rest, with its uncertainty."""
    log, std, noise = pad_over_rest(cube, known, **options)
    print(
        f"| {_words(body, options, _END[known])} | {options.get('refine', 1)} "
        f"| {np.exp(log):.2f} ×÷ {np.exp(std):.2f} | {abs(log) / std:.1f} std | {noise:.2f} |",
        flush=True,
    )


def print_layers(body: str, cube: TruthCube, clean: TruthCube, poisson: float, *trials) -> None:
    """Print the ratio of every layer beside that of the clean twin, and what is left."""
    twin_log = every_layer(clean, trials=(0,), poisson=poisson)[:, 0]
    log, std, _ = every_layer(cube, trials=trials, poisson=poisson).T
    for axis in range(3) if body == "silicone" else ():
        here = slice(LAYERS * axis, LAYERS * (axis + 1))
        for name, values in (("silicone", np.exp(log)), ("twin", np.exp(twin_log))):
            print(f"| {poisson:g} | {'xyz'[axis]} | {name} | " + _row(values[here]))
        print(f"| {poisson:g} | {'xyz'[axis]} | off by | " + _row(((log - twin_log) / std)[here]))
    left = log - twin_log
    print(
        f"{body}, ν {poisson:g}: log of the ratio scatters by {log.std():.3f}, less the twin by "
        f"{left.std():.3f}, predicted {np.sqrt((std**2).mean()):.3f}; off by "
        f"{np.sqrt(((left / std) ** 2).mean()):.2f} std (root mean square)",
        flush=True,
    )


def _row(values) -> str:
    return " | ".join(f"{value:.2f}" for value in values) + " |"


def print_flatness(body: str, cube: TruthCube, grouping: str, **options) -> None:
    """Print a table line: spread of log E over groups or cells beside the predicted one."""
    labels = {"layers": layers, "columns": columns, "cells": rest_of_the_cube}[grouping](cube, 0)
    per_cell = grouping == "cells"
    result = identify_cube(cube, labels, grouping="cell" if per_cell else "label", **options)
    log, std = log_moduli(result, labels, per_cell)
    values = "" if per_cell else " ".join(f"{np.exp(v):.2f}" for v in log)
    print(
        f"| {_words(body, options)} | {len(log)} {grouping} | {log.std():.3f} "
        f"| {np.sqrt((std**2).mean()):.3f} | {values} |",
        flush=True,
    )


_END = {0: "top", 5: "bottom"}


def _words(body, options, *more) -> str:
    trials = "+".join(str(t + 1) for t in options["trials"])
    return " | ".join([body, options["kinematics"], f"{options['poisson']:g}", *more, trials])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", nargs="?", default=FOLDER, type=Path)
    parser.add_argument("--refined", action="store_true", help="also on eight sub-cells per cell")
    options = parser.parse_args()
    cube = read_truth_cube(options.folder)
    print(json.dumps(facts(cube), indent=1))
    print(RATIO_HEAD)
    for known in _END:
        for kinematics, trials in itertools.product(KINEMATICS, ((2,), (0, 1, 2))):
            settings = {"kinematics": kinematics, "poisson": POISSON, "trials": trials}
            print_ratio("silicone", cube, known, **settings)
        settings = {"kinematics": "neo-hookean", "trials": (2,)}
        for poisson in (0.45, 0.48, 0.499):
            print_ratio("silicone", cube, known, **settings, poisson=poisson)
        if options.refined:
            print_ratio("silicone", cube, known, **settings, poisson=0.48, refine=4)
        settings["trials"] = (0,)
        for (name, seed), poisson in itertools.product(TWINS.items(), (0.45, 0.49)):
            print_ratio(name, twin(cube, seed), known, **settings, poisson=poisson)
    print(LAYER_HEAD)
    for poisson in (0.45, 0.48):
        print_layers("silicone", cube, twin(cube, None), poisson, 2)
    for seed, rounded in itertools.product((1, 2, 3), (False, True)):
        body = f"twin, {'rounded to slices' if rounded else 'noise'} {seed}"
        print_layers(body, twin(cube, seed, rounded), twin(cube, None), 0.45, 0)
    print(FLAT_HEAD)
    for kinematics, grouping in itertools.product(KINEMATICS, ("layers", "columns", "cells")):
        settings = {"kinematics": kinematics, "poisson": POISSON, "trials": (2,)}
        print_flatness("silicone", cube, grouping, **settings)
    for grouping in ("layers", "columns", "cells"):
        settings = {"kinematics": "neo-hookean", "poisson": POISSON, "trials": (0,)}
        print_flatness("twin, noise 1", twin(cube, 1), grouping, **settings)


if __name__ == "__main__":
    main()
