"""Compare second steps of the registration by the moduli that they lead to.

    python Testing/benchmarks/second_step.py                        # the phantoms to report on
    python Testing/benchmarks/second_step.py --phantoms 0 1 2 3     # those it was tuned on

The phantoms of images_to_moduli.py, registered by elastix; then finite-element image correlation on
the mesh, started from there, with several regularisers. One unknown per label. To compare many
variants quickly the identification is linearised at the truth: one Gauss–Newton step with the
true moduli and their balanced displacements as its start. It agrees with the whole fit to about 0.6
points of the ratio.

Columns: root mean square error of the displacement (pixels); mean and root mean square of the
error of the ratio inclusion : tissue (percent) per contrast; of E of the tissue; noise found in
units of what the information predicts; root mean square of the error of log E of tissue and
inclusion in predicted standard deviations.
"""

import argparse
from collections import defaultdict
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spl
from elastoidentify.fem.assembly import force_matrices, internal_forces, tangent_stiffness
from elastoidentify.fem.constitutive import KINEMATICS
from elastoidentify.fem.elastic_constants import lame_from_young
from elastoidentify.fem.mesh import make_mesh
from elastoidentify.imaging.registration import correlation as refinement
from elastoidentify.imaging.registration.information import (
    displacement_information,
    fit_grey_values,
)
from elastoidentify.imaging.registration.registration import CARRIED, PixelFrame
from elastoidentify.workers.elastix_client import ElastixProcess
from images_to_moduli import INCLUSION, PAD, REPORTED, TISSUE, make_case
from scipy import ndimage

POISSON, UNMEASURED = 0.45, 1e4


@dataclass(frozen=True)
class Measured:
    """Images, mesh and elastix's displacements of a phantom, all in pixels."""

    rest: np.ndarray  # (nj, ni)
    pushed: list
    points: np.ndarray  # (n, 2)
    cells: np.ndarray
    labels: np.ndarray
    reaction_nodes: np.ndarray
    start: np.ndarray  # (t, n, 2) elastix
    exact: np.ndarray  # (t, n, 2)
    young: dict  # label → Pa


def measure(contrast: float, number: int, elastix: ElastixProcess) -> Measured:
    """Make a phantom and register it without a second step."""
    case = make_case(contrast, number, second_step=False, elastix=elastix)
    frame = PixelFrame(case.phantom.rest)
    to_pixels = frame.image.direction[:, frame.kept] / frame.pixel
    return Measured(
        frame.array(case.phantom.rest).astype(float),
        [frame.array(image).astype(float) for image in case.phantom.pushed],
        frame.index(case.points),
        case.cells[0][1],
        case.labels,
        case.reaction_nodes,
        case.displacements["informed"] @ to_pixels,
        case.displacements["exact"] @ to_pixels,
        {label: case.phantom.materials[label].young for label in (PAD, TISSUE, INCLUSION)},
    )


# --- the variants ----------------------------------------------------------------------------


def lumped(system, u, mesh):
    """Each node for itself: the matrix lumped on the nodes, damped by a tenth of the mean."""
    matrix, force = system(u)
    blocks = (matrix @ np.tile(np.eye(2), (len(u), 1))).reshape(-1, 2, 2)
    blocks = blocks + 0.1 * np.trace(blocks, axis1=1, axis2=2).mean() / 2 * np.eye(2)
    step = np.linalg.solve(blocks, force.reshape(-1, 2, 1))[..., 0]
    return u + np.clip(step, -1, 1)


def strain_jump(mesh) -> sp.csr_matrix:
    """Σ over the cells' common sides of (length · |jump of the displacement gradient|)²."""
    pairs, length = mesh.interfaces
    sides = np.arange(len(pairs))
    jump = sp.csr_matrix(
        (np.repeat([1.0, -1.0], len(pairs)), (np.tile(sides, 2), pairs.T.ravel())),
        (len(pairs), mesh.n_cells),
    )
    (block,) = mesh.blocks
    cells = np.repeat(block.ids, block.nodes.shape[1])
    total = 0
    for axis in range(2):
        slope = block.gradients[:, 0, :, axis].ravel()
        gradient = sp.csr_matrix(
            (slope, (cells, block.nodes.ravel())), (mesh.n_cells, mesh.n_nodes)
        )
        rows = sp.diags(length) @ jump @ gradient
        total = total + rows.T @ rows
    return sp.kron(total, sp.identity(2)).tocsr()


def regularised(penalty, weight, steps=1):
    """Gauss–Newton steps of image correlation with a quadratic penalty of the displacement."""

    def variant(system, u, mesh):
        rough = penalty(mesh)
        for _ in range(steps):
            matrix, force = system(u)
            mean = matrix.diagonal().mean()
            weighted = rough * (weight * mean / rough.diagonal().mean())
            damped = matrix + weighted + refinement.DAMPING * mean * sp.identity(u.size)
            step = spl.spsolve(damped.tocsc(), force - weighted @ u.ravel())
            u = u + np.clip(step.reshape(u.shape), -1, 1)
        return u

    return variant


VARIANTS = {
    "elastix alone": lambda system, u, mesh: u,
    "lumped matrix": lumped,
    "no regulariser": regularised(refinement.equilibrium_gap, 0.0),
    "equilibrium gap 0.1": regularised(refinement.equilibrium_gap, 0.1),
    "equilibrium gap 1 (the default)": regularised(refinement.equilibrium_gap, refinement.GAP),
    "equilibrium gap 1, four steps": regularised(refinement.equilibrium_gap, refinement.GAP, 4),
    "equilibrium gap 10": regularised(refinement.equilibrium_gap, 10.0),
    "strain jump 0.1": regularised(strain_jump, 0.1),
    "strain jump 1": regularised(strain_jump, 1.0),
}


def information(found: Measured, trial: int, u: np.ndarray, resolution) -> np.ndarray:
    """Inverse covariance of displacements as the registration gives it, (n, 2, 2)."""
    voxels, near, weights = refinement.voxels_in_cells(found.points, found.cells, found.rest.shape)
    here = np.stack(np.unravel_index(voxels, found.rest.shape), 1)[:, ::-1]
    there = here + np.einsum("va,vad->vd", weights, u[near])
    warped = found.rest.copy()
    warped.ravel()[voxels] = ndimage.map_coordinates(found.pushed[trial], there.T[::-1], order=3)
    gain, offset = fit_grey_values(found.rest.ravel()[voxels], warped.ravel()[voxels])
    known, share, _ = displacement_information(
        found.rest, gain * warped + offset, found.points, found.cells, u, resolution=resolution
    )
    return known + share[:, None, None] * np.eye(2) / CARRIED**2


# --- one unknown per label, linearised at the truth ---------------------------------------------


class Linearised:
    """Identification of E per label, linearised at the true moduli, with 4 or 16 sub-cells."""

    def __init__(self, found: Measured, sub_cells: int = 4):
        coarse = make_mesh(found.points, found.cells)
        self.mesh, parent, self.between = coarse.refined()
        if sub_cells == 16:
            self.mesh, finer, between = self.mesh.refined()
            parent, self.between = parent[finer], (between @ self.between).tocsr()
        self.labels = found.labels[parent]
        reaction = self.between @ found.reaction_nodes.astype(float) > 1 - 1e-9
        fine = np.arange(self.mesh.n_nodes) >= coarse.n_nodes
        self.equations = 2 * len(found.exact) * np.count_nonzero(~reaction & ~fine)
        self.inflate = np.where(fine & ~reaction, UNMEASURED, 1.0)
        self.free = (np.flatnonzero(~reaction)[:, None] * 2 + np.arange(2)).ravel()
        self.law = KINEMATICS["neo-hookean"]
        young = np.array([found.young[label] for label in self.labels])
        self.lam, self.mu = lame_from_young(young, POISSON)
        weights = sp.diags(self.inflate.repeat(2))
        self.start = [self._balanced(self.between @ u, weights) for u in found.exact]

    def _balanced(self, u, C):
        """Balanced displacement next to u, and what it needs: K and ∂f/∂(log E)."""
        target = u.ravel()
        at = target
        for _ in range(6):
            K = tangent_stiffness(self.mesh, self.law, at.reshape(-1, 2), self.lam, self.mu)
            K = K[self.free]
            r = internal_forces(self.mesh, self.law, at.reshape(-1, 2), self.lam, self.mu)
            r = r.ravel()[self.free] + K @ (target - at)
            at = target - C @ (K.T @ spl.spsolve((K @ C @ K.T).tocsc(), r))
        per_lam, per_mu = force_matrices(self.mesh, self.law, at.reshape(-1, 2))
        chosen = np.stack([self.labels == one for one in (TISSUE, INCLUSION)], 1)
        R = per_lam @ (self.lam[:, None] * chosen) + per_mu @ (self.mu[:, None] * chosen)
        return at, K, R[self.free]

    def __call__(self, displacements, covariances) -> tuple[np.ndarray, np.ndarray, float]:
        """Error of log E of tissue and inclusion, its predicted deviation, and the noise."""
        hessian, slope, misfit = 0, 0, 0
        for u, covariance, (at, K, R) in zip(displacements, covariances, self.start, strict=True):
            spread = (self.between @ covariance.reshape(-1, 4)).reshape(-1, 2, 2)
            spread = spread * self.inflate[:, None, None]
            C = sp.bsr_matrix((spread, np.arange(len(spread)), np.arange(len(spread) + 1)))
            S = (K @ C.tocsr() @ K.T).tocsc()
            r = K @ ((self.between @ u).ravel() - at)
            solved = spl.splu(S).solve(np.column_stack([R, r]))
            hessian = hessian + R.T @ solved[:, :-1]
            slope = slope + R.T @ solved[:, -1]
            misfit += r @ solved[:, -1]
        error = -np.linalg.solve(hessian, slope)
        noise = np.sqrt((misfit + slope @ error) / (self.equations - 2))
        return error, np.sqrt(np.diag(np.linalg.inv(hessian))) * max(noise, 1.0), noise


def judge(found: Measured, sub_cells: int = 4) -> dict[str, tuple]:
    """Displacement error, error of log E, predicted deviations and noise of every variant."""
    linear = Linearised(found, sub_cells)
    mesh = refinement.simplex_mesh(found.points, found.cells)
    alone = np.broadcast_to(np.eye(2), (len(found.points), 2, 2))
    rows = {"exact, no weights": (0.0, *linear(found.exact, [alone] * len(found.exact)))}
    for name, variant in {"exact": None, **VARIANTS}.items():
        displacements, covariances = [], []
        for trial, start in enumerate(found.start):
            pair = found.rest, found.pushed[trial], found.points, found.cells

            def system(u, pair=pair):
                return refinement.correlation_system(*pair, u, np.ones(2))

            u = found.exact[trial] if variant is None else variant(system, start, mesh)
            resolution = 16.0 if name == "elastix alone" else None
            displacements.append(u)
            covariances.append(np.linalg.inv(information(found, trial, u, resolution)))
        off = np.sqrt(((np.array(displacements) - found.exact) ** 2).sum(-1).mean())
        rows[name] = (off, *linear(displacements, covariances))
    return rows


def show(results: dict[str, list], contrasts) -> None:
    """Print the table."""
    heads = " | ".join(f"ratio {contrast:g}:1" for contrast in contrasts)
    print(f"| second step | displacement | {heads} | tissue | noise | error / predicted |")
    print("|---" * (5 + len(contrasts)) + "|")
    for name, rows in results.items():
        error = np.array([row[2] for row in rows])
        ratio = 100 * np.expm1(error[:, 1] - error[:, 0])
        which = np.array([row[0] for row in rows])
        columns = [_mean_and_rms(ratio[which == contrast]) for contrast in contrasts]
        columns.append(_mean_and_rms(100 * np.expm1(error[:, 0])))
        z = np.sqrt(np.mean([(row[2] / row[3]) ** 2 for row in rows], axis=0))
        print(
            f"| {name} | {np.mean([row[1] for row in rows]):.3f} | {' | '.join(columns)} "
            f"| {np.mean([row[4] for row in rows]):.2f} | {z[0]:.1f}, {z[1]:.1f} |"
        )


def _mean_and_rms(values) -> str:
    return f"{values.mean():+.1f} ({np.sqrt((values**2).mean()):.1f})"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--phantoms", nargs="+", type=int, default=list(REPORTED))
    parser.add_argument("--contrasts", nargs="+", type=float, default=[2, 3, 8])
    parser.add_argument(
        "--refine", type=int, choices=(4, 16), default=4, help="sub-cells of the identification"
    )
    options = parser.parse_args()
    results = defaultdict(list)
    with ElastixProcess() as elastix:
        for number in options.phantoms:
            for contrast in options.contrasts:
                found = measure(contrast, number, elastix)
                for name, row in judge(found, options.refine).items():
                    results[name].append((contrast, *row))
    show(results, options.contrasts)


if __name__ == "__main__":
    main()
