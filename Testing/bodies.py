"""Bodies of known stiffness, pushed exactly, and an independent view of what can be known.

The balance matrix here is written down cell by cell from textbook formulas for simplices, apart
from the library's own assembly, so that its dense singular value decomposition is an oracle for
what the library calls determined.
"""

from dataclasses import dataclass, field

import elastoidentify as ei
import numpy as np
from elastoidentify.fem.elastic_constants import lame_from_young, plane_stress_lambda
from elastoidentify.fem.forward import solve_push
from elastoidentify.fem.mesh import make_mesh
from scipy.spatial import Delaunay


@dataclass
class Body:
    """A mesh with true E, ν per cell, its known cells, and the trials it was pushed in."""

    points: np.ndarray
    cells: object
    known: np.ndarray
    reaction: np.ndarray
    young: np.ndarray
    poisson: np.ndarray
    kinematics: str = "small-strain"
    plane: str = "strain"
    trials: list = field(default_factory=list)

    @property
    def lam(self):
        return lame_from_young(self.young, self.poisson)[0]

    @property
    def mu(self):
        return lame_from_young(self.young, self.poisson)[1]

    @property
    def given(self):
        """E, ν of the known cells and NaN elsewhere, (n_cells, 2)."""
        return np.where(self.known[:, None], np.column_stack([self.young, self.poisson]), np.nan)

    def push(self, displacement, forces=None):
        """Add a trial: the reaction nodes move by `displacement`, (n_reaction, d)."""
        lam = plane_stress_lambda(self.lam, self.mu) if self.plane == "stress" else self.lam
        moved = np.flatnonzero(self.reaction)
        u = solve_push(
            self.points, self.cells, lam, self.mu, moved, displacement,
            kinematics=self.kinematics, forces=forces,
        )  # fmt: skip
        self.trials.append(u)
        return self

    def identify(self, method="global", **options):
        options = {
            "known": self.given, "reaction_nodes": self.reaction, "method": method,
            "kinematics": self.kinematics, "plane": self.plane, **options,
        }  # fmt: skip
        known = options.pop("known")
        return ei.identify(self.points, self.cells, np.array(self.trials), known, **options)

    def errors(self, result):
        """Larger relative error of λ and μ of each cell; NaN where nothing was found."""
        return np.maximum(abs(result.lam / self.lam - 1), abs(result.mu / self.mu - 1))


def body(points, cells, known, reaction, *, seed=0, young=(1e3, 5e3), poisson=(0.3, 0.45), **more):
    """Return a Body with random E, ν; the known cells are uniform, as pads are."""
    rng = np.random.default_rng(seed)
    E, nu = rng.uniform(*young, len(known)), rng.uniform(*poisson, len(known))
    E[known], nu[known] = young[1], np.mean(poisson)
    return Body(points, cells, known, reaction, E, nu, **more)


def push_from_above(one, top, pushes):
    """Push the nodes at height `top` by each of `pushes`; other reaction nodes stand still.

    A push is one displacement (d,) for all of them, or a function of their positions (n, d).
    """
    held = one.points[one.reaction]
    at_top = np.isclose(held[:, -1:], top)
    for push in pushes:
        one.push(np.where(at_top, push(held) if callable(push) else push, 0.0))
    return one


def floor_and_top(points):
    heights = points[:, -1]
    return np.isclose(heights, heights.min()) | np.isclose(heights, heights.max())


def scattered_triangles(n, seed=0, keep=lambda x: np.ones(len(x), bool), lines=()):
    """Return an unstructured mesh of the unit square: Delaunay of jittered hexagonal nodes.

    `lines` are further nodes (m, 2) that the mesh keeps clear of; triangles whose centre is not
    to `keep` are left out, and with them the nodes that nothing uses.
    """
    h, rng = 1 / n, np.random.default_rng(seed)
    side = np.linspace(0, 1, n + 1)
    frame = [np.column_stack(p) for p in ((side, 0 * side), (side, 0 * side + 1))]
    frame += [np.column_stack(p)[1:-1] for p in ((0 * side, side), (0 * side + 1, side))]
    fixed = np.vstack([*frame, *lines])
    y = np.arange(h * 0.87, 1 - h / 2, h * 0.87)
    inner = np.vstack([np.column_stack([side[:-1] + h / 2 * (1 + k % 2), 0 * side[:-1] + v])
                       for k, v in enumerate(y)])  # fmt: skip
    inner = inner[(inner > h / 2).all(axis=1) & (inner < 1 - h / 2).all(axis=1)]
    near = np.linalg.norm(inner[:, None] - fixed, axis=2).min(axis=1)
    inner = inner[near > 0.6 * h] + rng.uniform(-0.12, 0.12, (int((near > 0.6 * h).sum()), 2)) * h
    points = np.vstack([fixed, inner])
    cells = Delaunay(points).simplices
    x = points[cells]
    area = np.linalg.det(x[:, 1:] - x[:, :1])
    cells = np.where(area[:, None] > 0, cells, cells[:, ::-1])[abs(area) > 0.05 * h * h]
    cells = cells[keep(points[cells].mean(axis=1))]
    used, cells = np.unique(cells, return_inverse=True)
    return points[used], cells.reshape(-1, 3)


def circle(radius, n, centre=(0.5, 0.5)):
    angle = 2 * np.pi * np.arange(n) / n
    return np.add(centre, radius * np.column_stack([np.cos(angle), np.sin(angle)]))


# ------------------------------------------------------------------------------ the dense oracle


def simplex_gradients(corners):
    """∇N (k, d) and volume of one simplex (k, d), from the inverse of its vertex matrix."""
    k, d = corners.shape
    vertex = np.column_stack([np.ones(k), corners])
    return np.linalg.inv(vertex)[1:].T, np.linalg.det(vertex) / (2 if d == 2 else 6)


def textbook_stress(kinematics, F):
    """P per unit λ and per unit μ, written from the laws' definitions."""
    eye = np.eye(len(F))
    if kinematics == "small-strain":
        strain = (F + F.T) / 2 - eye
        return np.trace(strain) * eye, 2 * strain
    if kinematics == "st-venant-kirchhoff":
        green = (F.T @ F - eye) / 2
        return F @ (np.trace(green) * eye), F @ (2 * green)
    inverse = np.linalg.inv(F)
    return np.log(np.linalg.det(F)) * inverse.T, F - inverse.T


def dense_balance(one):
    """The matrix of Σ f = … over the free nodes that touch an unknown cell, unit columns."""
    d = one.points.shape[1]
    unknown = np.flatnonzero(~one.known)
    A = np.zeros((len(one.trials), len(one.points), d, 2 * len(unknown)))
    for column, cell in enumerate(unknown):
        nodes = one.cells[cell]
        gradients, volume = simplex_gradients(one.points[nodes])
        for trial, u in enumerate(one.trials):
            F = np.eye(d) + u[nodes].T @ gradients
            for part, P in enumerate(textbook_stress(one.kinematics, F)):
                A[trial, nodes, :, 2 * column + part] = volume * gradients @ P.T
    A = A[:, ~one.reaction].reshape(-1, 2 * len(unknown))
    norm = np.linalg.norm(A, axis=0)
    return A / np.where(norm > 0, norm, 1)


def determined_cells(one):
    """Which cells the null space of the dense balance matrix leaves alone. (n_cells,) bool"""
    return determined_constants(one).all(axis=1)


def determined_constants(one, gap=(1e-12, 1e-9), part=(1e-9, 1e-5)):
    """Which λ and which μ the null space of the dense balance matrix leaves alone. (n_cells, 2)

    The singular values must leave a `gap` between those that are zero and the rest, and so must
    the part that columns have in the null space: where they do not, the question has no answer
    and the test is at fault.
    """
    _, s, Vt = np.linalg.svd(dense_balance(one))
    s = np.pad(s, (0, len(Vt) - len(s)))
    assert not ((s > gap[0]) & (s < gap[1])).any(), "no clear rank: choose another body"
    null = np.linalg.norm(Vt[s <= gap[0]], axis=0)
    assert not ((null > part[0]) & (null < part[1])).any(), "no clear null space: another body"
    answer = np.repeat(one.known[:, None], 2, axis=1)
    answer[~one.known] = null.reshape(-1, 2) <= part[0]
    return answer


def steps_from_known(one):
    """Number of cells, node to node, between each cell and the known ones; large if cut off."""
    incidence = make_mesh(one.points, one.cells).node_cells
    steps, reached = np.full(len(one.known), 10**6), one.known.copy()
    steps[reached] = 0
    for distance in range(1, len(one.known)):
        touched = (incidence.T @ (incidence @ reached.astype(float))) > 0
        if (touched == reached).all():
            break
        steps[touched & ~reached] = distance
        reached = touched
    return steps
