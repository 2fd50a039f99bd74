"""Exact pushes: structured meshes and forward solutions, the paper's example among them.

The forward problem uses the same balance as identification does, so its displacements are exact
data for it. Claims about noise and images need data from a finer mesh and another element type:
those come from :mod:`elastoidentify.imaging.phantom`.
"""

from collections.abc import Sequence

import numpy as np
import scipy.sparse.linalg as spl

from ..errors import InputError
from ..progress import Progress, silent
from .assembly import internal_forces, tangent_stiffness
from .constitutive import KINEMATICS
from .mesh import make_mesh

PATTERNS = ("paper", "alternating", "crossed")


def square_mesh(
    nx: int, ny: int, width: float = 0.2, height: float = 0.2, pattern: str = "paper"
) -> tuple[np.ndarray, np.ndarray]:
    """Return points (n, 2) and counter-clockwise triangles (m, 3) of a rectangle.

    Nodes are numbered left to right from the bottom row, triangles likewise, square by square.

    Parameters
    ----------
    pattern : str
        "paper": each square cut from its upper left to its lower right corner, the lower left
        triangle first; "alternating": the diagonal alternates like a chessboard; "crossed": both
        diagonals and a node in the centre (centres are numbered after the corners).
    """
    if pattern not in PATTERNS:
        raise InputError(f"mesh pattern {pattern!r}: choose one of {', '.join(PATTERNS)}")
    X, Y = np.meshgrid(np.linspace(0, width, nx + 1), np.linspace(0, height, ny + 1))
    points = np.column_stack([X.ravel(), Y.ravel()])
    row, col = (index.ravel() for index in np.mgrid[:ny, :nx])
    a = row * (nx + 1) + col
    b, c, d = a + 1, a + nx + 1, a + nx + 2
    falling = np.stack([np.stack([a, b, c], 1), np.stack([b, d, c], 1)], 1)
    if pattern == "paper":
        return points, falling.reshape(-1, 3)
    if pattern == "alternating":
        rising = np.stack([np.stack([a, b, d], 1), np.stack([a, d, c], 1)], 1)
        even = ((row + col) % 2 == 0)[:, None, None]
        return points, np.where(even, falling, rising).reshape(-1, 3)
    centre = len(points) + np.arange(len(a))
    points = np.vstack([points, points[np.stack([a, b, c, d])].mean(axis=0)])
    sides = [np.stack([p, q, centre], 1) for p, q in ((a, b), (b, d), (d, c), (c, a))]
    return points, np.stack(sides, 1).reshape(-1, 3)


def box_mesh(
    shape: tuple[int, ...], size: Sequence[float], kind: str = "hexahedron"
) -> tuple[np.ndarray, np.ndarray]:
    """Return points and cells of a rectangle of quads or a box of hexahedra or tetrahedra.

    Parameters
    ----------
    shape : (nx, ny) or (nx, ny, nz)
        Number of boxes along each axis.
    size : same length
        Edge lengths of the whole.
    kind : "quad", "hexahedron" or "tetra" (six tetrahedra per box, Kuhn's, which conform)
    """
    axes = [np.linspace(0, s, n + 1) for n, s in zip(shape, size, strict=True)]
    grids = np.meshgrid(*axes[::-1], indexing="ij")
    points = np.column_stack([g.ravel() for g in grids[::-1]])
    step = np.cumprod([1, *[n + 1 for n in shape[:-1]]])
    index = np.meshgrid(*[np.arange(n) for n in shape[::-1]], indexing="ij")[::-1]
    corner = sum(i.ravel() * s for i, s in zip(index, step, strict=True))
    if kind == "quad":
        offsets = [0, step[0], step[0] + step[1], step[1]]
        return points, corner[:, None] + np.array(offsets)
    low = [0, step[0], step[0] + step[1], step[1]]
    hexahedra = corner[:, None] + np.array(low + [o + step[2] for o in low])
    if kind == "hexahedron":
        return points, hexahedra
    if kind != "tetra":
        raise InputError(f"box of {kind!r}: choose quad, hexahedron or tetra")
    kuhn = [(0, 1, 2, 6), (0, 5, 1, 6), (0, 2, 3, 6), (0, 3, 7, 6), (0, 4, 5, 6), (0, 7, 4, 6)]
    return points, hexahedra[:, kuhn].reshape(-1, 4)


def solve_push(
    points: np.ndarray,
    cells,
    lam: np.ndarray,
    mu: np.ndarray,
    moved: np.ndarray,
    displacement: np.ndarray,
    *,
    kinematics: str = "small-strain",
    forces: np.ndarray | None = None,
    max_steps: int = 64,
    progress: Progress | None = None,
) -> np.ndarray:
    """Solve for the displacement of all nodes when some are moved.

    Parameters
    ----------
    points : (n_nodes, d)
    cells : (n_cells, k) int or list of (kind, array)
    lam, mu : (n_cells,)
        Lamé constants (in plane stress: λ*).
    moved : (n_moved,) int, or (n_nodes, d) bool
        Nodes whose displacement is prescribed in every component, or a mask of components.
    displacement : (n_moved, d), or (n_nodes, d)
        The prescribed displacement; of the mask form only marked entries are read.
    kinematics : str
        Finite-strain laws are solved by Newton's method in load steps that shrink when it fails.
    forces : (n_nodes, d), optional
        Outside forces on the nodes that are free.
    max_steps : int
        The smallest load step is 1/max_steps of the push.

    Returns
    -------
    u : (n_nodes, d)

    Raises
    ------
    InputError
        When Newton's method does not converge, or a cell of the solution is inverted.
    """
    mesh, law = make_mesh(np.asarray(points, float), cells), KINEMATICS[kinematics]
    moved = np.asarray(moved)
    if moved.dtype == bool:
        fixed, target = moved, np.where(moved, displacement, 0.0)
    else:
        fixed = np.zeros((mesh.n_nodes, mesh.dim), bool)
        target = np.zeros((mesh.n_nodes, mesh.dim))
        fixed[moved], target[moved] = True, displacement
    loads = np.zeros((mesh.n_nodes, mesh.dim)) if forces is None else np.asarray(forces, float)
    progress = progress or silent
    u, done, step = np.zeros((mesh.n_nodes, mesh.dim)), 0.0, 1.0
    while done < 1:
        step = min(step, 1 - done)
        trial = _newton(mesh, law, lam, mu, u, fixed, (done + step) * target, (done + step) * loads)
        if trial is None:
            step /= 2
            if step < 1 / max_steps:
                raise InputError(
                    f"the {kinematics} forward problem does not converge beyond {done:.0%} of the "
                    "push: a cell inverts (its volume shrinks to nothing); push less"
                )
            continue
        u, done = trial, done + step
        progress(done, f"forward problem, {done:.0%} of the push")
    return u


def _newton(mesh, law, lam, mu, u, fixed, target, loads, iterations=25):
    """Newton's method from u to the prescribed displacement; None where it fails."""
    free = np.flatnonzero(~fixed.ravel())
    u = u.ravel().copy()
    change = np.zeros_like(u)
    change[fixed.ravel()] = (target.ravel() - u)[fixed.ravel()]
    scale = None
    for _ in range(iterations):
        at = u.reshape(-1, mesh.dim)
        K = tangent_stiffness(mesh, law, at, lam, mu)
        residual = internal_forces(mesh, law, at, lam, mu).ravel() - loads.ravel()
        rhs = -(residual + K @ change)[free]
        change[free] = spl.spsolve(K[free][:, free].tocsc(), rhs)
        u = u + change
        at = u.reshape(-1, mesh.dim)
        if law.linear:
            return at
        if not np.isfinite(u).all() or mesh.n_inverted(at):
            return None
        size = np.abs(change).max()
        scale = max(np.abs(target).max(), np.abs(u).max(), 1e-300)
        change[:] = 0
        if size < 1e-13 * scale:
            return at
    return at if size < 1e-10 * scale else None
