"""Sequential identification: node after node from the edge of the known region (source paper).

The walk is planned first, from the coefficients alone: which nodes are solved for which unknowns,
in which order. It is then a linear map from the right-hand side to θ, so that the propagated
error of any number of displacement errors costs one more pass each.
"""

from dataclasses import dataclass, field

import numpy as np

from ..progress import Progress, silent
from .balance_system import BalanceSystem

CONDITION_LIMIT = 1e-7  # smallest over largest singular value (columns scaled) that counts as rank
# Nodes of a block when it is tried. Small blocks are tried at many seeds; a large one means that
# nothing smaller helps anywhere, and then a few seeds do.
SMALL_BLOCKS = (2, 3, 4, 5, 6, 8, 10, 12, 16, 20, 24)
LARGE_BLOCKS = (32, 48, 64, 96, 128, 192, 256, 384)
LARGE_SEEDS = 3
SEEDS_PER_STALL = 16
# What is tried, in this order, after every success from the start: single nodes or blocks whose
# matrices are at least this well conditioned. Each ill-conditioned solve costs its digits once and
# for all that follows.
STAGES = (
    ("nodes", 1e-2),
    ("nodes", 1e-3),
    (SMALL_BLOCKS, 1e-3),
    ("nodes", 1e-5),
    (SMALL_BLOCKS, 1e-5),
    ("nodes", CONDITION_LIMIT),
    (LARGE_BLOCKS, CONDITION_LIMIT),
)
# On small meshes blocks are preferred to nodes that lose more than two digits.
THOROUGH_UP_TO = 1_000
THOROUGH_STAGES = (STAGES[0], (SMALL_BLOCKS, 1e-2), *STAGES[1:])
# Growing blocks for the sake of conditioning costs a Python loop per block. On meshes with more
# unknown groups than this round-off has won long before the end, and blocks are grown only where
# no node is left; graded limits would also break the wave of independent nodes into small batches.
CAREFUL_UP_TO = 5_000
FAST_STAGES = (
    ("nodes", CONDITION_LIMIT),
    (SMALL_BLOCKS, CONDITION_LIMIT),
    (LARGE_BLOCKS, CONDITION_LIMIT),
)


@dataclass
class Step:
    """Nodes solved at once, each for its own unknown groups (or one block of nodes jointly).

    Attributes
    ----------
    nodes : (n, s) int
        Row s of node numbers (places in ``system.nodes``) of each of n independent problems.
    groups : (n, c) int
        Groups that each problem finds.
    inverse : (n, c·p, s·R)
        Pseudo-inverse rows: from the right-hand sides of the nodes to the groups' parameters.
    """

    nodes: np.ndarray
    groups: np.ndarray
    inverse: np.ndarray


@dataclass
class Walk:
    """The planned walk.

    Attributes
    ----------
    steps : list of Step
    order : (n_groups,) int
        Number of the step that found a group, counted front by front, −1 where none did.
    """

    system: BalanceSystem
    coefficients: "Coefficients"
    steps: list[Step] = field(default_factory=list)
    order: np.ndarray | None = None

    def solve(self, right: np.ndarray) -> np.ndarray:
        """Return θ (n_params, m), NaN where the walk does not lead, for right (n_equations, m)."""
        c, m = self.coefficients, right.shape[1]
        theta = np.zeros((c.n_groups + 1, c.per_group, m))  # the last one stands for "no group"
        right = right.reshape(c.n_nodes, c.rows, m)
        for step in self.steps:
            known = np.einsum(
                "nskrp,nskpm->nsrm", c.values[step.nodes], theta[c.groups[step.nodes]]
            )
            rest = right[step.nodes] - known
            n, width = step.groups.shape
            found = step.inverse @ rest.reshape(n, -1, m)
            theta[step.groups.ravel()] = found.reshape(n * width, c.per_group, m)
        theta = theta[:-1]
        theta[self.order < 0] = np.nan
        return theta.reshape(-1, m)

    def spoiled(self, lost: np.ndarray) -> np.ndarray:
        """Return the groups that are lost themselves or rest on lost ones. (n_groups,) bool"""
        bad = np.zeros(len(lost) + 1, bool)  # of groups found so far
        for step in self.steps:
            rests_on_bad = bad[self.coefficients.groups[step.nodes]].any(axis=(1, 2))
            bad[step.groups] = lost[step.groups] | rests_on_bad[:, None]
        return bad[:-1] | (self.order < 0)

    def as_list(self) -> list[tuple[list[int], list[int]]]:
        """Return (mesh nodes, groups found) of every step in the order of ``order``."""
        entries = {}
        for step in self.steps:
            for nodes, groups in zip(step.nodes, step.groups, strict=True):
                mesh_nodes = self.system.nodes[nodes].tolist()
                entries[int(self.order[groups[0]])] = (mesh_nodes, groups.tolist())
        return [entries[key] for key in sorted(entries)]


class Coefficients:
    """A, node by node, padded to the largest number of groups around a node.

    Attributes
    ----------
    groups : (n_nodes, k) int
        Groups around each node; ``n_groups`` where there is none.
    values : (n_nodes, k, R, p)
    """

    def __init__(self, system: BalanceSystem):
        self.rows, self.per_group = system.rows_per_node, system.unknowns.per_group
        self.n_groups, self.n_nodes = system.unknowns.n_groups, len(system.nodes)
        blocks = system.A.tobsr((self.rows, self.per_group))
        blocks.sort_indices()
        count = np.diff(blocks.indptr)
        self.node = np.repeat(np.arange(self.n_nodes), count)  # of each block
        place = np.arange(len(self.node)) - np.repeat(blocks.indptr[:-1], count)
        width = int(count.max(initial=1))
        self.groups = np.full((self.n_nodes, width), self.n_groups)
        self.groups[self.node, place] = blocks.indices
        self.values = np.zeros((self.n_nodes, width, self.rows, self.per_group))
        self.values[self.node, place] = blocks.data
        # the same incidence by group
        order = np.argsort(blocks.indices, kind="stable")
        self._group_nodes = self.node[order]
        self._group_start = np.searchsorted(blocks.indices[order], np.arange(self.n_groups + 1))

    def nodes_of(self, groups: np.ndarray) -> np.ndarray:
        """Return the nodes around any of the groups, each once."""
        start, stop = self._group_start[groups], self._group_start[groups + 1]
        count = stop - start
        first = np.repeat(start - np.concatenate([[0], np.cumsum(count)[:-1]]), count)
        return np.unique(self._group_nodes[first + np.arange(count.sum())])


class _Planner:
    """State of the planning: what is solved, and what each node could solve next."""

    def __init__(self, system: BalanceSystem):
        self.c = c = Coefficients(system)
        self.level = system.node_level
        self.solved = np.zeros(c.n_groups + 1, bool)
        self.solved[-1] = True
        self.total = (c.groups < c.n_groups).sum(axis=1)
        cells = system.node_cells[system.nodes]
        self.cells = np.diff(cells.indptr)  # around each node, known ones included
        self.open = self.total.copy()  # groups still to find at each node
        self.forced = self.level == 0  # a known force acts
        self.condition = np.zeros(c.n_nodes)
        self.steps: list[Step] = []

    def open_groups(self, nodes):
        """Unsolved groups of nodes that all have the same number of them: (n, c) and places."""
        c = self.c
        unsolved = ~self.solved[c.groups[nodes]]
        place = np.argsort(~unsolved, axis=1, kind="stable")[:, : self.open[nodes[0]]]
        return np.take_along_axis(c.groups[nodes], place, axis=1), place

    def local_matrices(self, nodes):
        """Matrices (n, R, c·p) of nodes with one number of open groups, and their groups."""
        groups, place = self.open_groups(nodes)
        blocks = self.c.values[nodes[:, None], place]  # (n, c, R, p)
        n, width, rows, per_group = blocks.shape
        return blocks.transpose(0, 2, 1, 3).reshape(n, rows, width * per_group), groups

    def is_candidate(self, nodes):
        enough = (self.open[nodes] > 0) & (self.open[nodes] * self.c.per_group <= self.c.rows)
        return enough & self.forced[nodes]

    def assess(self, nodes):
        """Set the condition of candidate nodes: smallest over largest singular value."""
        self.condition[nodes] = 0
        nodes = nodes[self.is_candidate(nodes)]
        for width in np.unique(self.open[nodes]):
            some = nodes[self.open[nodes] == width]
            matrices, _ = self.local_matrices(some)
            self.condition[some] = _reciprocal_condition(matrices)

    def choose(self, candidates):
        """Pick nodes that share no unknown: mostly known surroundings first, then condition."""
        share = self.open[candidates] / self.cells[candidates]
        good = candidates[share <= 0.5]
        if len(good) == 0:
            good = candidates
        key = np.empty(len(good))
        key[np.lexsort((good, -_grade(self.condition[good])))] = np.arange(len(good))
        best = np.full(self.c.n_groups + 1, np.inf)
        groups = self.c.groups[good]
        unsolved = ~self.solved[groups]
        np.minimum.at(best, groups[unsolved], np.broadcast_to(key[:, None], groups.shape)[unsolved])
        wins = ((best[groups] >= key[:, None]) | ~unsolved).all(axis=1)
        return good[wins]

    def take(self, nodes):
        """Record the steps that solve these independent nodes."""
        for width in np.unique(self.open[nodes]):
            some = nodes[self.open[nodes] == width]
            matrices, groups = self.local_matrices(some)
            self.record(some[:, None], groups, _pseudo_inverse(matrices))

    def record(self, nodes, groups, inverse):
        self.steps.append(Step(nodes, groups, inverse))

    def mark(self, first_step):
        """Update the state after new steps; return the nodes whose state changed."""
        groups = np.concatenate([s.groups.ravel() for s in self.steps[first_step:]])
        self.solved[groups] = True
        touched = self.c.nodes_of(groups)
        self.open[touched] = (~self.solved[self.c.groups[touched]]).sum(axis=1)
        self.forced[touched] = True
        self.assess(touched)
        return touched


def plan_walk(system: BalanceSystem, progress: Progress | None = None) -> Walk:
    """Plan the order in which nodes are solved.

    A node is ready when its balance equations determine all its unknown groups, judged by the
    singular values of its matrix. Ready nodes at least half of whose cells are known go first;
    those that share no unknown are solved together. Where no single node is ready, the smallest
    block of neighbouring nodes that determines something is solved jointly.
    """
    progress = progress or silent
    plan = _Planner(system)
    nodes = np.arange(plan.c.n_nodes)
    plan.assess(nodes)
    candidates = nodes[plan.condition > CONDITION_LIMIT]
    stages = FAST_STAGES
    if plan.c.n_groups <= CAREFUL_UP_TO:
        stages = THOROUGH_STAGES if plan.c.n_groups <= THOROUGH_UP_TO else STAGES
    in_vain = [np.zeros(plan.c.n_nodes, bool) for _ in stages]  # seeds tried, unchanged since
    while True:
        first_step = len(plan.steps)
        if not any(
            _try_stage(plan, stage, limit, candidates, tried)
            for (stage, limit), tried in zip(stages, in_vain, strict=True)
        ):
            break
        touched = plan.mark(first_step)
        for tried in in_vain:
            tried[touched] = False
        candidates = np.union1d(candidates, touched)
        candidates = candidates[plan.condition[candidates] > CONDITION_LIMIT]
        if len(plan.steps) % 50 == 0:
            share = plan.solved[:-1].mean()
            progress(share, f"sequential: {share:.0%} of the unknowns have a place in the walk")
    order = _front_order(plan, system)
    return Walk(system, plan.c, plan.steps, order)


def _front_order(plan, system):
    """Number the problems of all steps front by front (level, then time), as the paper walks."""
    order = np.full(plan.c.n_groups, -1)
    if not plan.steps:
        return order
    front = np.zeros(plan.c.n_groups + 1, int)  # of each group found so far
    keys, owners, number = [], [], 0
    for time, step in enumerate(plan.steps):
        level = system.node_level[step.nodes].min(axis=1)
        # never before the groups that it rests on
        level = np.maximum(level, front[plan.c.groups[step.nodes]].max(axis=(1, 2)))
        front[step.groups] = level[:, None]
        keys.append(np.column_stack([level, np.full(len(level), time), step.nodes.min(axis=1)]))
        owners.append((step.groups, number + np.arange(len(level))))
        number += len(level)
    keys = np.concatenate(keys)
    rank = np.empty(number, int)
    rank[np.lexsort(keys.T[::-1])] = np.arange(number)
    for groups, problem in owners:
        order[groups] = rank[problem][:, None]
    return order


def _grade(condition):
    """Grade conditions in steps of a tenth of a decade.

    In regular meshes many nodes are equally well conditioned, and round-off must not choose among
    them. The grades' bounds lie off the round numbers that regular meshes give.
    """
    return np.floor(10 * np.log10(np.maximum(condition, np.finfo(float).tiny)) + 0.37)


def _scaled(matrices):
    norm = np.linalg.norm(matrices, axis=-2, keepdims=True)
    return matrices / np.where(norm > 0, norm, 1), norm


def _reciprocal_condition(matrices):
    values = np.linalg.svd(_scaled(matrices)[0], compute_uv=False)
    largest = values[..., 0]
    return np.where(largest > 0, values[..., -1] / np.where(largest > 0, largest, 1), 0)


def _pseudo_inverse(matrices):
    scaled, norm = _scaled(matrices)
    return np.linalg.pinv(scaled, rcond=CONDITION_LIMIT / 10) / np.swapaxes(norm, -1, -2)


def _try_stage(plan, stage, limit, candidates, tried) -> bool:
    """Record the steps of one stage; False where there is none."""
    if stage == "nodes":
        good = candidates[plan.condition[candidates] > limit]
        if len(good):
            plan.take(plan.choose(good))
        return len(good) > 0
    return _solve_blocks(plan, stage, limit, tried)


def _solve_blocks(plan, sizes, limit, tried) -> bool:
    """Solve the smallest blocks that determine something, at seeds that share no unknown."""
    seeds = np.flatnonzero(plan.forced & (plan.open > 0) & ~tried)
    deficit = plan.open[seeds] * plan.c.per_group - plan.c.rows
    seeds = seeds[np.lexsort((plan.level[seeds], deficit))]
    if sizes is LARGE_BLOCKS:
        seeds = seeds[:LARGE_SEEDS]
    taken, found = set(), 0
    for seed in seeds:
        block = _grow(plan, int(seed), sizes, limit)
        if block is None:
            tried[seed] = True
        elif not taken & set(block[1].tolist()):
            nodes, groups, inverse = block
            plan.record(nodes[None], groups[None], inverse[None])
            taken |= set(groups.tolist())
            found += 1
        if found == SEEDS_PER_STALL:
            break
    return found > 0


def _grow(plan, seed, sizes, limit):
    """Grow a block of nodes from a seed; return nodes, groups found, inverse, or None."""
    c = plan.c
    nodes, groups = [seed], set(_unsolved(plan, seed))
    neighbours = set(c.nodes_of(np.array(sorted(groups))).tolist()) - {seed}
    for size in sizes:
        while len(nodes) < size and neighbours:
            new = {n: [g for g in _unsolved(plan, n) if g not in groups] for n in neighbours}
            best = min(neighbours, key=lambda n, new=new: (len(new[n]), plan.level[n], n))
            nodes.append(best)
            groups.update(new[best])
            if new[best]:
                neighbours |= set(c.nodes_of(np.array(new[best])).tolist())
            neighbours -= set(nodes)
        found = _determined(plan, nodes, sorted(groups), limit)
        if found is not None or not neighbours:
            return found
    return None


def _unsolved(plan, node):
    groups = plan.c.groups[node]
    return groups[~plan.solved[groups]].tolist()


def _determined(plan, nodes, groups, limit):
    """Return the groups that the joint equations of some nodes determine, with their inverse."""
    c = plan.c
    column = {g: k for k, g in enumerate(groups)}
    matrix = np.zeros((len(nodes), c.rows, len(groups), c.per_group))
    for row, node in enumerate(nodes):
        for place, group in enumerate(c.groups[node]):
            if group in column:
                matrix[row, :, column[group]] = c.values[node, place]
    matrix = matrix.reshape(len(nodes) * c.rows, -1)
    scaled, norm = _scaled(matrix)
    U, s, Vt = np.linalg.svd(scaled, full_matrices=True)
    rank = int((s > limit * s[0]).sum()) if s[0] > 0 else 0
    null = np.linalg.norm(Vt[rank:], axis=0) if rank < Vt.shape[0] else np.zeros(Vt.shape[1])
    free = (null.reshape(-1, c.per_group) > 1e-6).any(axis=1)
    if free.all() or rank == 0:
        return None
    inverse = (Vt[:rank].T / s[:rank]) @ U[:, :rank].T / norm.T
    keep = np.repeat(~free, c.per_group)
    return np.array(nodes), np.array(groups)[~free], inverse[keep]
