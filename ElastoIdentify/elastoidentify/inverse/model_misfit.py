"""Where the model does not fit: the part of the local misfit that noise does not explain.

Were the law, Poisson's ratio, the plane and the contact right, the measured displacements would
miss the balance of forces by what their noise makes of it, K e. Where something is assumed wrongly
the law lacks a stress s. Both together are a model of variance components: with the covariance of
the forces

    Ω = σ² K C Kᵀ  +  Σ_c τ_c² G_cᵀ G_c,

where G_c w is the strain of displacements w in cell c, measured by the stress energy that it costs
(Gᵀ G is the stiffness), so that s_c has the variance τ_c² in that measure; every trial has its own.
τ_c² and, where it was not stated, σ² are those that make the data most probable, by the updates

    τ_c² ← τ_c² · |G_c q|² / E|G_c q|²,      q = Ω⁻¹ (K v + R dx),

(Zhou, Hu, Qiao, Cho, Zhou, J. Comput. Graph. Stat. 28, 2019; the expectation is a mean over
samples), which let strong errors explain what they spread over the body. With it the moduli are
fitted anew, to first order. q is the displacement-like adjoint of the force balance, and G_c q the
error in the constitutive law of a cell (Ladevèze, Nedjar, Reynier, AIAA J. 32, 1994; Feissel and
Allix, Comput. Methods Appl. Mech. Engrg. 196, 2007).

Cells that are too large err by themselves, which no assumption is to blame for. What cells half as
large would add to the displacements (:mod:`.mesh_bias`) is taken off v, where that is known.

What is shown is τ_c² / (τ_c² + t_c), with t_c what the noise alone lets see of τ_c²: a share
between 0 (noise explains all of the cell's misfit) and 1 (nothing of it).
"""

import numpy as np
import scipy.sparse as sp
from scipy.sparse import csgraph
from scipy.spatial import cKDTree

from ..fem.mesh import Mesh
from .equilibrium import Equilibrium
from .misfit import beside, difference
from .problem import ModelMisfit

FLAGGED = 0.1  # share from which a cell counts: chance takes some 4 % of sound cells there
STEPS, SAMPLES = 6, 16
MOST = 1e3  # times that a variance may grow in a step
START = 0.1  # of what the noise lets see
# radius, in cell sizes, by dimension: the evidence of some 28 cells is taken together
REACH = {2: 3.0, 3: 1.9}


def model_misfit(fit, system, stated: float | None) -> ModelMisfit:
    """Tell where the law of a regularized fit lacks a stress.

    Parameters
    ----------
    fit : object
        With ``forward``, ``state``, ``misfit``, ``prior``, ``x``, ``parameters``, ``scale``,
        ``gap`` (the cells' own error, or None), ``tell``.
    system : DirectSystem
        The fit's own, factorised at its state, prior and scale, or a new one; it takes other
        matrices here.
    stated : float, optional
        The noise scale where it was stated; then it is a lower bound: errors of a registration are
        alike over many nodes, which the information knows and their scatter does not show.
    """
    forward, state = fit.forward, fit.state
    mesh, dim = forward.problem.mesh, forward.mesh.dim
    G = stress_measure(forward, *fit.parameters.moduli(fit.x))
    near = _neighbourhoods(mesh, forward.problem.unknowns.known)
    free = G[:, : forward.n_free]
    scale = stated or fit.scale

    def energies(q):
        return sum((free @ one).reshape(mesh.n_cells, dim**2, -1) ** 2 for one in q).sum(axis=1)

    seen = energies(_multipliers(fit, system, free, None, scale))[:, 1:].mean(axis=1)
    components = dim * (dim + 1) / 2 * state.eta.shape[1]
    unseen = seen <= 1e-12 * seen.max()
    alone = components / np.where(unseen, 1.0, seen)  # t, the τ² that noise alone looks like
    variance = START * alone
    for _ in range(STEPS):
        q = _multipliers(fit, system, free, variance, scale)
        power = energies(q)
        expected = near @ power[:, 1:].mean(axis=1)
        ratio = (near @ power[:, 0]) / np.where(expected > 0, expected, 1.0)
        variance = variance * np.minimum(ratio, MOST)
        noise = sum(np.einsum("im,im->m", one, S @ one) for one, S in zip(q, system.S, strict=True))
        if noise[0] > 0 and noise[1:].mean() > 0:  # else both are rounding
            scale = scale * np.sqrt(noise[0] / noise[1:].mean())
        scale = max(scale, stated or 0.0)
    variance[unseen] = 0.0
    law = ((G @ state.eta).reshape(mesh.n_cells, dim**2, -1) ** 2).sum(axis=(1, 2))
    law = near @ law
    strained = law > 1e-12 * law.max()
    lacking = np.sqrt(components * variance / np.where(strained, law, np.inf))
    return ModelMisfit(variance / (variance + alone), lacking, float(scale))


def stress_measure(forward: Equilibrium, lam: np.ndarray, mu: np.ndarray) -> sp.csr_matrix:
    """Return G, (n_cells·d², n_eta): |G_c w|² = V (λ tr(ε)² + 2μ ε:ε), ε the mean strain of w in c.

    For the mesh's cells, whose sub-cells are the forward problem's.
    """
    mesh, fine, d = forward.problem.mesh, forward.mesh, forward.mesh.dim
    rows, cols, values = [], [], []
    component = np.arange(d * d).reshape(d, d)
    for block in fine.blocks:
        cell = forward.parent[block.ids]
        slope = np.einsum("nq,nqaj->naj", block.weights, block.gradients)
        n, k, _ = slope.shape
        shape = (n, k, d, d)  # H_ij = Σ_a u_ai ∂_j N_a
        rows.append(np.broadcast_to(cell[:, None, None, None] * d * d + component, shape).ravel())
        cols.append(np.broadcast_to(block.dofs.reshape(n, k, d)[..., None], shape).ravel())
        values.append(np.broadcast_to(slope[:, :, None, :], shape).ravel())
    place = (np.concatenate(rows), np.concatenate(cols))
    total = sp.csr_matrix((np.concatenate(values), place), (mesh.n_cells * d * d, fine.n_dofs))
    eye = np.eye(d)
    sphere = np.einsum("ij,kl->ijkl", eye, eye).reshape(d * d, d * d) / d
    both = np.einsum("ik,jl->ijkl", eye, eye) + np.einsum("il,jk->ijkl", eye, eye)
    deviator = both.reshape(d * d, d * d) / 2 - sphere
    size = 1 / np.sqrt(mesh.volumes)  # the sum over the cell is V times the mean
    shear, bulk = np.sqrt(2 * mu) * size, np.sqrt(np.maximum(d * lam + 2 * mu, 0.0)) * size
    blocks = shear[:, None, None] * deviator + bulk[:, None, None] * sphere
    at = np.arange(mesh.n_cells + 1)
    root = sp.bsr_matrix((blocks, at[:-1], at)).tocsr()
    return (root @ total @ forward.Z).tocsr()


def _multipliers(fit, system, free, variance, scale):
    """q (n_free, 1 + samples) of each trial: of the data, and of samples of the model itself."""
    rng = np.random.default_rng(0)  # the same numbers in every step: else τ² would not settle
    trials, n = fit.state.eta.shape[1], free.shape[0]
    extra, forces = None, None
    if variance is not None:
        spread = np.repeat(variance, n // len(variance))
        extra = (free.T @ sp.diags(spread) @ free).tocsc()
        drawn = [
            np.sqrt(spread)[:, None] * rng.standard_normal((n, SAMPLES)) for _ in range(trials)
        ]
        forces = [np.hstack([np.zeros((free.shape[1], 1)), free.T @ one]) for one in drawn]
    root = fit.prior.root()
    sampled = root @ rng.standard_normal((root.shape[1], SAMPLES))
    prior = np.hstack([-fit.prior.gradient(fit.x)[:, None], sampled])
    numbers = beside(_unbiased(fit), fit.misfit.noise(rng, SAMPLES, scale))
    fit.tell()
    own = system is fit.system and extra is None and scale == fit.scale
    if not own:  # else the fit's factors are there
        system.factorise(fit.prior.hessian(), fit.state, fit.misfit, scale, extra)
    return system.multipliers(prior, numbers, forces)


def _unbiased(fit):
    """Return measured − computed per term and trial, without the cells' own error."""
    found = fit.misfit.residuals()
    return found if fit.gap is None else difference(found, fit.misfit.of_first_term(fit.gap))


def _neighbourhoods(mesh: Mesh, known: np.ndarray) -> sp.csr_matrix:
    """Weighted means over the cells around each one; known and unknown cells apart."""
    reach = REACH[mesh.dim] * np.median(mesh.volumes) ** (1 / mesh.dim)
    tree = cKDTree(mesh.centres)
    gap = tree.sparse_distance_matrix(tree, reach, output_type="coo_matrix")
    row, col = (np.concatenate([part, np.arange(mesh.n_cells)]) for part in (gap.row, gap.col))
    weight = (1 - (np.concatenate([gap.data, np.zeros(mesh.n_cells)]) / reach) ** 2) ** 2
    once = np.append(gap.row != gap.col, np.ones(mesh.n_cells, bool))  # each cell itself
    own = (known[row] == known[col]) & once
    total = sp.csr_matrix((weight[own], (row[own], col[own])), (mesh.n_cells,) * 2)
    return sp.diags(1 / np.asarray(total.sum(axis=1)).ravel()) @ total


def summary(mesh: Mesh, centres: np.ndarray, known: np.ndarray, misfit: ModelMisfit) -> dict:
    """Say how much of the tissue the model does not fit, and where most of that is.

    Parameters
    ----------
    centres : (n_cells, 2 or 3)
        Of the cells, in the coordinates that users know.
    known : (n_cells,) bool

    Returns
    -------
    dict
        ``share`` of the unknown cells' size that is flagged, ``known_share`` likewise of the known
        ones, ``centre`` of the largest connected part (None: nowhere), ``stress``: median of what
        the law lacks there, relative to its stress; ``noise_scale``.
    """
    flagged = misfit.share > FLAGGED
    parts = {}
    for name, cells in (("share", ~known), ("known_share", known)):
        parts[name] = float(mesh.volumes[cells & flagged].sum() / mesh.volumes[cells].sum())
    out = parts | {"centre": None, "stress": None, "noise_scale": misfit.scale}
    if flagged.any():
        pairs = mesh.interfaces[0]
        pairs = pairs[flagged[pairs].all(axis=1)]
        graph = sp.csr_matrix((np.ones(len(pairs)), pairs.T), (mesh.n_cells,) * 2)
        piece = np.where(flagged, csgraph.connected_components(graph, directed=False)[1], -1)
        sizes = np.bincount(piece[flagged], mesh.volumes[flagged])
        here = piece == sizes.argmax()
        out["centre"] = np.average(centres[here], axis=0, weights=mesh.volumes[here]).tolist()
        out["stress"] = float(np.median(misfit.stress[here]))
    return out
