"""The mesh of the numerics: nodes and cells of one dimension."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp

from ..errors import InputError
from .elements import CELL_TYPES, CellType, shape_gradients


@dataclass(frozen=True)
class Block:
    """Cells of one type: their numbers in the mesh, nodes and shape function gradients."""

    cell: CellType
    ids: np.ndarray  # (n,) cell numbers
    nodes: np.ndarray  # (n, k)
    gradients: np.ndarray  # (n, q, k, d)
    weights: np.ndarray  # (n, q)

    @cached_property
    def dofs(self) -> np.ndarray:
        """Degrees of freedom of each cell, node by node. Shape (n, k·d)."""
        d = self.cell.dim
        return (self.nodes[:, :, None] * d + np.arange(d)).reshape(len(self.nodes), -1)

    def gradient(self, u: np.ndarray) -> np.ndarray:
        """Return H = Σ_a u_a ⊗ ∇N_a at the Gauss points, (n, q, d, d), for u (n_nodes, d)."""
        # a cell's common translation would cost digits of its strain
        relative = u[self.nodes] - u[self.nodes[:, :1]]
        return np.einsum("nai,nqaj->nqij", relative, self.gradients)


class Mesh:
    """Nodes and cells in their own dimension d (2 or 3).

    Parameters
    ----------
    points : (n_nodes, d)
    blocks : sequence of (kind, (n, k) int, (n,) int)
        Kind of cell, connectivity in VTK's node order, cell numbers.

    Raises
    ------
    InputError
        Where a cell is inverted or has no volume, or refers to nodes that do not exist.
    """

    def __init__(self, points: np.ndarray, blocks: Sequence[tuple[str, np.ndarray, np.ndarray]]):
        self.points = np.ascontiguousarray(points, float)
        self.n_nodes, self.dim = self.points.shape
        self.blocks = [self._block(*block) for block in blocks]
        self.n_cells = sum(len(block.ids) for block in self.blocks)
        self.n_dofs = self.n_nodes * self.dim

    def _block(self, kind, nodes, ids):
        cell = CELL_TYPES[kind]
        gradients, weights = shape_gradients(cell, self.points[nodes])
        size = np.abs(weights).sum(axis=1)
        bad = np.flatnonzero(~(weights > 1e-12 * np.median(size)).all(axis=1))
        if len(bad):
            raise InputError(
                f"{len(bad)} of {len(nodes)} {kind} cells are inverted or have no volume, the "
                f"first is cell {ids[bad[0]]}: repair the mesh (each cell's nodes must turn the "
                "same way, as VTK orders them)"
            )
        return Block(cell, np.asarray(ids), np.asarray(nodes), gradients, weights)

    @cached_property
    def node_cells(self) -> sp.csr_matrix:
        """Incidence: 1 where a node belongs to a cell. Shape (n_nodes, n_cells)."""
        rows = np.concatenate([block.nodes.ravel() for block in self.blocks])
        cols = np.concatenate([np.repeat(b.ids, b.cell.n_nodes) for b in self.blocks])
        shape = (self.n_nodes, self.n_cells)
        return sp.csr_matrix((np.ones(len(rows)), (rows, cols)), shape)

    @cached_property
    def matrix_pattern(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Where the entries of cell matrices go in their sum: once for many assemblies.

        Returns
        -------
        slot : (Σ n·(k·d)²,) int
            Entry of the sum that each entry of the blocks' matrices (n, k·d, k·d) is added to.
        indices, indptr : int arrays
            The sum's pattern, compressed by rows.
        """
        keys = []
        for block in self.blocks:
            dofs = block.dofs.astype(np.int64)
            keys.append((dofs[:, :, None] * self.n_dofs + dofs[:, None, :]).ravel())
        unique, slot = np.unique(np.concatenate(keys), return_inverse=True)
        rows, indices = np.divmod(unique, self.n_dofs)
        indptr = np.concatenate([[0], np.cumsum(np.bincount(rows, minlength=self.n_dofs))])
        return slot.ravel(), indices.astype(np.int32), indptr.astype(np.int32)

    @cached_property
    def volumes(self) -> np.ndarray:
        """Area or volume of each cell. Shape (n_cells,)."""
        volumes = np.empty(self.n_cells)
        for block in self.blocks:
            volumes[block.ids] = block.weights.sum(axis=1)
        return volumes

    @cached_property
    def centres(self) -> np.ndarray:
        """Mean of each cell's nodes. Shape (n_cells, d)."""
        centres = np.empty((self.n_cells, self.dim))
        for block in self.blocks:
            centres[block.ids] = self.points[block.nodes].mean(axis=1)
        return centres

    @cached_property
    def interfaces(self) -> tuple[np.ndarray, np.ndarray]:
        """Pairs of neighbouring cells and the size of the side that they share.

        Returns
        -------
        pairs : (m, 2) int
        sizes : (m,)
            Length (2-D) or area (3-D) of the common side.
        """
        owners, corners = self._sides()
        key = np.sort(corners, axis=1)
        order = np.lexsort(key.T[::-1])
        same = (key[order][1:] == key[order][:-1]).all(axis=1)
        first, second = order[:-1][same], order[1:][same]
        pairs = np.column_stack([owners[first], owners[second]])
        return pairs, self._side_sizes(corners[first])

    def _sides(self):
        """All sides of all cells: owner (m,) and corner nodes (m, 2…4), −1 where a side has 3."""
        owners, corners = [], []
        width = 2 if self.dim == 2 else 4
        for block in self.blocks:
            for face in block.cell.faces:
                nodes = np.full((len(block.ids), width), -1)
                nodes[:, : len(face)] = block.nodes[:, face]
                owners.append(block.ids)
                corners.append(nodes)
        return np.concatenate(owners), np.concatenate(corners)

    def _side_sizes(self, corners):
        x = self.points[corners]
        if self.dim == 2:
            return np.linalg.norm(x[:, 1] - x[:, 0], axis=1)
        last = np.where((corners[:, 3] >= 0)[:, None], x[:, 3], x[:, 0])
        return np.linalg.norm(np.cross(x[:, 2] - x[:, 0], last - x[:, 1]), axis=1) / 2

    @cached_property
    def boundary_nodes(self) -> np.ndarray:
        """True for nodes on a side that belongs to one cell only. Shape (n_nodes,)."""
        _, corners = self._sides()
        _, inverse, count = np.unique(
            np.sort(corners, axis=1), axis=0, return_inverse=True, return_counts=True
        )
        nodes = np.unique(corners[count[inverse.ravel()] == 1])
        on_boundary = np.zeros(self.n_nodes, bool)
        on_boundary[nodes[nodes >= 0]] = True
        return on_boundary

    def n_inverted(self, u: np.ndarray) -> int:
        """Return how many Gauss points displacements u, (n_nodes, d), turn inside out."""
        eye = np.eye(self.dim)
        return sum(
            int((np.linalg.det(eye + block.gradient(u)) <= 0).sum()) for block in self.blocks
        )

    def refined(self) -> tuple["Mesh", np.ndarray, sp.csr_matrix]:
        """Cut every cell once into cells of its own type.

        Returns
        -------
        mesh : Mesh
            The finer mesh; its first n_nodes nodes are those of this mesh.
        parent : (n_fine_cells,) int
            The cell that each finer cell comes from.
        interpolation : csr_matrix, (n_fine_nodes, n_nodes)
            Linear interpolation of nodal values.
        """
        parts = []  # (parents' nodes of each child node, padded with −1), per block
        for block in self.blocks:
            for child in block.cell.children:
                for group in child:
                    nodes = np.full((len(block.ids), 8), -1)
                    nodes[:, : len(group)] = np.sort(block.nodes[:, group], axis=1)
                    parts.append(nodes)
        keys = np.concatenate(parts)
        single = np.column_stack([np.arange(self.n_nodes), np.full((self.n_nodes, 7), -1)])
        # single nodes first, then edge, face and cell means: the old nodes keep their numbers
        order_key = np.column_stack(
            [(np.vstack([single, keys]) >= 0).sum(1), np.vstack([single, keys])]
        )
        unique, inverse = np.unique(order_key, axis=0, return_inverse=True)
        inverse = inverse.ravel()[self.n_nodes :]
        groups = unique[:, 1:]
        rows, cols = np.nonzero(groups >= 0)
        count = (groups >= 0).sum(axis=1)
        interpolation = sp.csr_matrix(
            (1.0 / count[rows], (rows, groups[rows, cols])), (len(groups), self.n_nodes)
        )
        blocks, parent, start, number = [], [], 0, 0
        for block in self.blocks:
            n, k = block.nodes.shape
            n_children = len(block.cell.children)
            nodes = inverse[start : start + n * k * n_children].reshape(n_children, k, n)
            start += n * k * n_children
            nodes = nodes.transpose(2, 0, 1).reshape(-1, k)
            blocks.append((block.cell.name, nodes, number + np.arange(len(nodes))))
            number += len(nodes)
            parent.append(np.repeat(block.ids, n_children))
        return Mesh(interpolation @ self.points, blocks), np.concatenate(parent), interpolation


def make_mesh(points: np.ndarray, cells) -> Mesh:
    """Return the Mesh of points (n, d) and cells: one array or a list of (kind, array)."""
    if not isinstance(cells, (list, tuple)):
        cells = np.asarray(cells)
        kinds = {(2, 3): "triangle", (2, 4): "quad", (3, 4): "tetra", (3, 8): "hexahedron"}
        kind = kinds.get((points.shape[1], cells.shape[1]))
        if kind is None:
            raise InputError(
                f"cells with {cells.shape[1]} nodes in {points.shape[1]} dimensions: name their "
                "kind, as in [('triangle', array)]"
            )
        cells = [(kind, cells)]
    blocks, start = [], 0
    for kind, nodes in cells:
        blocks.append((kind, np.asarray(nodes, int), start + np.arange(len(nodes))))
        start += len(nodes)
    return Mesh(points, blocks)


def plane_frame(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return an origin (3,) and an in-plane frame (3, 2) of points that lie in one plane.

    The frame's axes follow the world axes as far as the plane allows.

    Raises
    ------
    InputError
        If the points do not lie in a plane.
    """
    origin = points.mean(axis=0)
    _, sizes, axes = np.linalg.svd(points - origin, full_matrices=False)
    if sizes[2] > 1e-6 * sizes[0]:
        raise InputError(
            "the cells are triangles or quadrilaterals, but their nodes do not lie in one plane "
            f"(they leave it by {sizes[2] / sizes[0]:.1e} of the mesh size): flatten the mesh, "
            "curved surfaces are not supported"
        )
    normal = axes[2] * np.sign(axes[2][np.abs(axes[2]).argmax()])
    first = np.eye(3)[np.argsort(np.abs(normal), kind="stable")[0]]
    first = first - normal * (first @ normal)
    first /= np.linalg.norm(first)
    return origin, np.column_stack([first, np.cross(normal, first)])
