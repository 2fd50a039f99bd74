"""The true push of a phantom: quadratic quadrilaterals on a fine grid, and the map it makes."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from scipy import ndimage
from scipy.sparse.linalg import splu

from ...errors import InputError
from ...installation import needs
from ...progress import Progress, silent

# Air beside the block carries the displacement on outward, so that pushed images can be rendered
# there. A membrane a million times softer than the tissue does it without folding or pushing back.
AIR_STIFFNESS = 1e-6
PADDING = 3  # samples around the grid that the spline of its edges needs

Moduli = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True)
class Deformation:
    """Displacement on a regular grid of the plane or of space, interpolated by cubic splines.

    Parameters
    ----------
    start, step : (d,) arrays
        Position of the first grid point and distance of grid points, (x, y) or (x, y, z).
    coefficients : (2, ny, nx) or (3, nz, ny, nx) array
        Spline coefficients of the displacement's components, with PADDING samples around.
    """

    start: np.ndarray
    step: np.ndarray
    coefficients: np.ndarray

    @property
    def dim(self) -> int:
        """2 in the plane, 3 in space."""
        return len(self.start)

    @classmethod
    def of_grid(cls, start, step, values) -> "Deformation":
        """Interpolate displacements (d, [nz,] ny, nx) given at the grid points."""
        # carried on beyond the edges, where a spline of its own accord would end level
        beyond = [(PADDING, PADDING)] * np.ndim(values[0])
        carried = (np.pad(v, beyond, "reflect", reflect_type="odd") for v in values)
        coefficients = np.array([ndimage.spline_filter(v, 3, mode="mirror") for v in carried])
        return cls(np.asarray(start, float), np.asarray(step, float), coefficients)

    @property
    def count(self) -> np.ndarray:
        """Grid points along each axis, x first."""
        return np.array(self.coefficients.shape[:0:-1]) - 2 * PADDING

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """Return the displacement (n, d) at points (n, d); constant beyond the grid."""
        samples = np.clip((points - self.start) / self.step, 0, self.count - 1).T[::-1] + PADDING
        return np.stack(
            [
                ndimage.map_coordinates(c, samples, order=3, prefilter=False, mode="nearest")
                for c in self.coefficients
            ],
            1,
        )

    def gradient(self, points: np.ndarray) -> np.ndarray:
        """Return ∂u_a/∂x_b (n, d, d) by central differences of a tenth of a grid step."""
        columns = []
        for axis in range(self.dim):
            shift = np.zeros(self.dim)
            shift[axis] = 0.1 * self.step[axis]
            columns.append((self(points + shift) - self(points - shift)) / (2 * shift[axis]))
        return np.stack(columns, -1)

    def _nearby_gradient(self, points: np.ndarray) -> np.ndarray:
        """Return ∂u_a/∂x_b (n, d, d) at the nearest grid points: good enough for Newton steps."""
        nearest = np.rint((points - self.start) / self.step).astype(int)
        nearest = np.clip(nearest, 0, self.count - 1)
        return self._grid_gradient[tuple(nearest.T[::-1])]

    @cached_property
    def _grid_gradient(self) -> np.ndarray:
        """∂u_a/∂x_b at the grid points, ([nz,] ny, nx, d, d)."""
        shape = tuple(self.count[::-1])
        index = np.stack(np.indices(shape)[::-1], -1).reshape(-1, self.dim)
        return self.gradient(self.start + index * self.step).reshape(*shape, self.dim, self.dim)

    def inverse(self, points: np.ndarray, steps: int = 50) -> np.ndarray:
        """Return the x (n, d) with x + u(x) = `points`, by Newton steps of bounded length.

        Raises
        ------
        InputError
            The deformation folds: somewhere there is no such x.
        """
        limit, tolerance = 4 * self.step.min(), 1e-6 * self.step.min()
        slopes = self.gradient if self.dim == 2 else self._nearby_gradient
        x = points - self(points)
        left = np.arange(len(points))
        for _ in range(steps):
            error = points[left] - x[left] - self(x[left])
            wrong = np.abs(error).max(1) > tolerance
            left, error = left[wrong], error[wrong]
            if not len(left):
                return x
            move = np.linalg.solve(np.eye(self.dim) + slopes(x[left]), error[..., None])[..., 0]
            length = np.abs(move).max(1, keepdims=True)
            x[left] += move * np.minimum(1, limit / np.maximum(length, limit * 1e-9))
        raise InputError(
            f"the push folds the phantom at {len(left)} pixels: push less, or soften the inclusion"
        )


def solve_pushes(
    width: float,
    height: float,
    margin: float,
    moduli: Moduli,
    pushes: np.ndarray,
    *,
    elements: int = 80,
    kinematics: str = "small-strain",
    progress: Progress | None = None,
) -> list[Deformation]:
    """Push a block that stands on a floor, in plane strain.

    Parameters
    ----------
    width, height : float
        The block covers 0…width × 0…height, y downwards; its upper edge follows the indenter, its
        lower edge stays on the floor, its sides are free.
    margin : float
        Width of the air on both sides.
    moduli : callable
        ``young, poisson = moduli(x, y)``, any shape.
    pushes : (t, 2)
        Displacement of the indenter.
    elements : int
        Quadrilaterals across the width.
    kinematics : "small-strain", "neo-hookean"
        The latter is P = μ(F − F⁻ᵀ) + λ ln J F⁻ᵀ (Bonet & Wood, Nonlinear Continuum Mechanics for
        Finite Element Analysis, 2nd ed., eq. 6.28), solved by Newton's method.

    Returns
    -------
    list of Deformation
        One per push.
    """
    try:
        import skfem
    except ImportError:
        raise InputError(f"making a phantom {needs('scikit-fem', 'all')}") from None
    if kinematics not in ("small-strain", "neo-hookean"):
        raise InputError(f"kinematics {kinematics!r}: give small-strain or neo-hookean")
    progress = progress or silent

    size = width / elements
    rows, beside = max(round(height / size), 4), int(np.ceil(margin / size)) + 2
    x = size * np.arange(-beside, elements + beside + 1)
    y = height / rows * np.arange(rows + 1)
    mesh = skfem.MeshQuad.init_tensor(x, y)
    basis = skfem.Basis(mesh, skfem.ElementVector(skfem.ElementQuad2()), intorder=4)
    block = _Block(basis, width, moduli)

    component = np.zeros(basis.N, int)
    for dofs in (basis.nodal_dofs, basis.facet_dofs, basis.interior_dofs):
        component[dofs] = np.arange(dofs.shape[0])[:, None] % 2
    on_indenter, on_floor = (np.isclose(basis.doflocs[1], edge) for edge in (0.0, height))
    free = np.flatnonzero(~(on_indenter | on_floor))
    zero = np.zeros(basis.N)
    progress(0.0, "factorising the phantom's stiffness")
    stiffness = block.stiffness(zero)
    solve = _factorised(stiffness, free)

    column, row = (
        np.rint((basis.doflocs.T - [x[0], 0]) / [size / 2, height / rows / 2]).astype(int).T
    )
    deformations = []
    for trial, push in enumerate(pushes):
        progress(0.4 + 0.6 * trial / len(pushes), f"pushing trial {trial + 1}")
        u = np.where(on_indenter, np.asarray(push)[component], 0.0)
        u[free] = -solve((stiffness @ u)[free])
        if kinematics == "neo-hookean":
            u = _newton(block, u, free)
        grid = np.empty((2, 2 * len(y) - 1, 2 * len(x) - 1))
        grid[component, row, column] = u
        step = (size / 2, height / rows / 2)
        deformations.append(Deformation.of_grid((x[0], 0.0), step, grid))
    return deformations


class _Block:
    """Internal forces and tangent stiffness of a block with air beside it.

    `u` are the degrees of freedom of the vector basis; for ``finite=False`` (small strain) the
    tangent at u = 0 is all there is: both laws share it.
    """

    def __init__(self, basis, width: float, moduli: Moduli):
        x, y = np.asarray(basis.global_coordinates())
        young, poisson = moduli(x, y)
        solid = (x > 0) & (x < width)
        self.basis = basis
        self.lam = np.where(solid, young * poisson / ((1 + poisson) * (1 - 2 * poisson)), 0.0)
        self.mu = np.where(solid, young / (2 * (1 + poisson)), 0.0)
        self.air = np.where(solid, 0.0, AIR_STIFFNESS * young.min())

    def _fields(self, u) -> dict:
        """Return moduli, F⁻¹ and ln J at the quadrature points."""
        gradient = self.basis.interpolate(u).grad
        f = gradient + np.eye(2)[:, :, None, None]
        # in the air the law does not use F
        jacobian = np.where(self.lam + self.mu > 0, f[0, 0] * f[1, 1] - f[0, 1] * f[1, 0], 1.0)
        if not (jacobian > 0).all():
            raise InputError("the push turns the phantom inside out: push less")
        inverse = np.array([[f[1, 1], -f[0, 1]], [-f[1, 0], f[0, 0]]]) / jacobian
        return {
            "gradient": gradient,
            "inverse": inverse,
            "log_j": np.log(jacobian),
            "lam": self.lam,
            "mu": self.mu,
            "air": self.air,
        }

    def forces(self, u):
        """Return the internal force of every degree of freedom: ∫ P(F) : ∇v."""
        import skfem

        @skfem.LinearForm
        def balance(v, w):
            stress = w.mu * (_identity(w.gradient) + w.gradient) + (
                w.lam * w.log_j - w.mu
            ) * np.swapaxes(w.inverse, 0, 1)
            return _contract(stress + w.air * w.gradient, v.grad)

        return balance.assemble(self.basis, **self._fields(u))

    @cached_property
    def _slopes(self) -> np.ndarray:
        """∂_j N of every shape function N, one for both components, (cells, points, 9, 2)."""
        first = self.basis.basis[::2]  # the local degrees of freedom alternate x and y
        return np.stack([one[0].grad[0] for one in first], -1).transpose(1, 2, 3, 0)

    def stiffness(self, u):
        """Return the tangent ∂forces/∂u as a sparse matrix.

        With ∇N and g = F⁻ᵀ∇N the entry of components k of N_a and l of N_b is
        ∫ (μ + air) δ_kl ∇N_a·∇N_b + (μ − λ ln J) g_al g_bk + λ g_ak g_bl.
        """
        at, slope = self._fields(u), self._slopes
        cells, points, n, _ = slope.shape
        g = (slope @ at["inverse"].transpose(2, 3, 0, 1)).reshape(cells, points, 2 * n)
        weight = self.basis.dx[..., None]

        def products(factor, of):
            return (of * (factor[..., None] * weight)).swapaxes(1, 2) @ of

        K = products(self.lam, g).reshape(cells, n, 2, n, 2)
        K += products(self.mu - self.lam * at["log_j"], g).reshape(K.shape).swapaxes(2, 4)
        plain = sum(products(self.mu + self.air, slope[..., j]) for j in range(2))
        for k in range(2):
            K[:, :, k, :, k] += plain
        dofs = self.basis.element_dofs.T
        rows, columns = np.broadcast_arrays(dofs[:, :, None], dofs[:, None, :])
        return sp.csr_matrix((K.ravel(), (rows.ravel(), columns.ravel())), (self.basis.N,) * 2)


def _identity(like):
    """Return the unit tensor in the layout of skfem's gradients (2, 2, cells, points)."""
    return np.broadcast_to(np.eye(2)[:, :, None, None], np.shape(like))


def _contract(a, b):
    """Return a : b of tensors (2, 2, …)."""
    return a[0, 0] * b[0, 0] + a[0, 1] * b[0, 1] + a[1, 0] * b[1, 0] + a[1, 1] * b[1, 1]


def _factorised(stiffness, free) -> Callable[[np.ndarray], np.ndarray]:
    """Return the solver of a symmetric sparse matrix restricted to `free`."""
    matrix = stiffness.tocsc()[free][:, free]
    return splu(matrix, permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True}).solve


def _newton(block: _Block, u: np.ndarray, free: np.ndarray, steps: int = 20) -> np.ndarray:
    """Bring the internal forces at the free degrees of freedom to zero, starting from `u`."""
    scale = np.abs(block.forces(u)).max()
    for _ in range(steps):
        residual = block.forces(u)[free]
        if np.abs(residual).max() < 1e-10 * scale:
            return u
        u = u.copy()
        u[free] -= _factorised(block.stiffness(u), free)(residual)
    raise InputError("the push of the neo-Hookean phantom did not converge: push less")
