"""What is determined does not depend on the processor: one Status under every kernel of OpenBLAS.

The kernels add in different orders. Singular and nearly singular problems are solved under each in
a process of its own, from the same inputs.
"""

import json
import os
import pickle
import subprocess
import sys

import bodies
import elastoidentify as ei
import numpy as np
import pytest
from bodies import floor_and_top, push_from_above, scattered_triangles
from elastoidentify.fem.forward import box_mesh, square_mesh

KERNELS = {  # and the instructions without which they crash
    "Nehalem": ("SSE42",),
    "Sandybridge": ("AVX",),
    "Haswell": ("AVX2", "FMA3"),
    "Zen": ("AVX2", "FMA3"),
    "SkylakeX": ("AVX512_SKX",),
}
PUSHES = ((0, -0.05), (-0.05, -0.05))


def squares(n, pattern="paper", young=(1e3, 5e3), pad=0.7, reaction=True):
    points, cells = square_mesh(n, n, 1, 1, pattern)
    known = points[cells].mean(axis=1)[:, 1] > pad
    held = floor_and_top(points) if reaction else np.zeros(len(points), bool)
    return bodies.body(points, cells, known, held, young=young)


def walled(n, gap=0):
    """Nothing beyond a wall has a scale; `gap` leaves that many nodes of it free."""
    line = np.column_stack([np.full(n - 1, 0.5), np.linspace(0, 1, n + 1)[1:-1]])
    points, cells = scattered_triangles(n, lines=[line])
    wall = np.isclose(points[:, 0], 0.5) & (points[:, 1] > (gap + 0.5) / n)
    known = (points[cells].mean(1) < [0.5, 2]).all(1) & (points[cells].mean(1)[:, 1] > 0.6)
    return push_from_above(
        bodies.body(points, cells, known, floor_and_top(points) | wall), 1.0, PUSHES
    )


def much_pad(share, trials):
    points, cells = scattered_triangles(8)
    centres = points[cells].mean(axis=1)
    unknown = (np.abs(centres - 0.5) < 0.45).all(axis=1)
    unknown &= np.random.default_rng(0).random(len(unknown)) < share
    one = bodies.body(points, cells, ~unknown, floor_and_top(points))
    return push_from_above(one, 1.0, PUSHES[:trials])


def pad_at_the_left(n):
    points, cells = scattered_triangles(n)
    one = bodies.body(points, cells, points[cells].mean(1)[:, 0] < 0.25, floor_and_top(points))
    return push_from_above(one, 1.0, PUSHES)


def uniform_strains(n, pattern):
    """Every node sees the same strain, so that many of its equations say the same."""
    one = squares(n, pattern)
    one.trials = [one.points @ np.array(g) for g in ([[0, 0], [0, 0.01]], [[0, 0.01], [0, 0]])]
    return one


def nearly_proportional(difference):
    one = push_from_above(squares(6), 1.0, PUSHES)
    first, second = one.trials
    one.trials = [first, first + difference * second]
    return one


def mostly_rigid(shift):
    """The strains are differences of numbers that are `shift` times as large."""
    one = push_from_above(squares(6), 1.0, PUSHES)
    one.trials = [u + shift for u in one.trials]
    return one


def single_precision():
    one = push_from_above(squares(8, "alternating"), 1.0, PUSHES)
    one.trials = [u.astype(np.float32).astype(float) for u in one.trials]
    return one


def equal_cells(n, pattern, trials=2):
    """Cells of one material in a regular mesh: many nodes are equally well conditioned."""
    one = squares(n, pattern, young=(5e3, 5e3))
    one.poisson[:] = 0.4
    return push_from_above(one, 1.0, PUSHES[:trials])


def bricks():
    points, cells = box_mesh((3, 3, 4), (1, 1, 1), "hexahedron")
    known = points[cells].mean(axis=1)[:, 2] > 0.7
    one = bodies.body(points, cells, known, floor_and_top(points))
    return push_from_above(one, 1.0, ((0, 0, -0.02), (0.02, 0, -0.02)))


SINGULAR = {
    "wall 8": lambda: walled(8),
    "wall 12": lambda: walled(12),
    "wall 16": lambda: walled(16),
    "pad at the left": lambda: pad_at_the_left(8),
    "one trial, some pad": lambda: much_pad(0.7, 1),
    "two trials, little pad": lambda: much_pad(0.95, 2),
    "uniform strains": lambda: uniform_strains(6, "paper"),
    "uniform strains, crossed": lambda: uniform_strains(5, "crossed"),
    "proportional": lambda: nearly_proportional(0.0),
    "equal cells": lambda: equal_cells(8, "paper"),
    "equal cells, alternating": lambda: equal_cells(8, "alternating"),
    "equal cells, crossed": lambda: equal_cells(5, "crossed"),
    "bricks": bricks,
}
GREY = {
    "leaky wall": lambda: walled(10, gap=2),
    **{f"1e-{k} from proportional": lambda k=k: nearly_proportional(10.0**-k)
       for k in (5, 8, 10, 11, 12, 14)},
    **{f"1e{k} times rigid": lambda k=k: mostly_rigid(10.0**k) for k in (5, 9, 11, 12)},
    "single precision": single_precision,
}  # fmt: skip

SLOW_TO_WALK = ("wall 12", "wall 16", "leaky wall", "1e-5 from proportional")


def can_run(instructions):
    features = np._core._multiarray_umath.__cpu_features__
    return all(features.get(name, False) for name in instructions)


def solve_all(cases):
    """Status of every case by its methods."""
    return {
        f"{name}, {method}": ei.identify(*arguments, **options, method=method).status.tolist()
        for name, (arguments, options, methods) in cases.items()
        for method in methods
    }


def rounded(one, seed):
    """The displacements as another program might have rounded them. (n_trials, n_nodes, d)"""
    u = np.array(one.trials)
    return u * (1 + np.finfo(float).eps * np.random.default_rng(seed).standard_normal(u.shape))


@pytest.fixture(scope="module")
def inputs(tmp_path_factory):
    cases = {}
    for name, make in (SINGULAR | GREY).items():
        one = make()
        more = {"unknowns": "young", "poisson_ratio": 0.375} if len(one.trials) == 1 else {}
        options = {"reaction_nodes": one.reaction, **more}
        methods = ("global",) if name in SLOW_TO_WALK else ("global", "sequential")
        arguments = (one.points, one.cells, np.array(one.trials), one.given)
        cases[name] = (arguments, options, methods)
        for seed in range(2) if name in SINGULAR else ():
            arguments = (one.points, one.cells, rounded(one, seed), one.given)
            cases[f"{name}, rounded {seed}"] = (arguments, options, ("global",))
    file = tmp_path_factory.mktemp("kernels") / "cases.pickle"
    file.write_bytes(pickle.dumps(cases))
    return file


def under(kernel, inputs):
    changes = {"OPENBLAS_CORETYPE": kernel, "OPENBLAS_NUM_THREADS": "1"}
    changes["PYTHONPATH"] = os.pathsep.join(path for path in sys.path if path)
    done = subprocess.run(
        [sys.executable, __file__, str(inputs)], env=os.environ | changes, capture_output=True,
        text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.fixture(scope="module")
def first(inputs):
    return under(next(kernel for kernel, needs in KERNELS.items() if can_run(needs)), inputs)


@pytest.mark.parametrize(
    "kernel",
    [
        pytest.param(kernel, marks=[] if kernel in ("Haswell", "SkylakeX") else pytest.mark.slow)
        for kernel in list(KERNELS)[1:]
    ],
)
def test_every_kernel_gives_the_same_status(kernel, first, inputs):
    if not can_run(KERNELS[kernel]):
        pytest.skip(f"this processor cannot run {kernel}")
    status = under(kernel, inputs)
    differ = {
        name: np.flatnonzero(np.not_equal(status[name], first[name])).tolist() for name in first
    }
    assert not {name: cells for name, cells in differ.items() if cells}


@pytest.mark.parametrize("name", list(SINGULAR))
def test_the_last_digit_of_the_displacements_decides_nothing(name, first):
    for seed in range(2):
        assert first[f"{name}, rounded {seed}, global"] == first[f"{name}, global"]


def test_the_cases_are_singular(first):
    """Else their agreement would mean nothing: each leaves some cells open, or nearly so."""
    open_cells = {name: status.count(0) for name, status in first.items()}
    for name in (
        "wall 8",
        "wall 12",
        "pad at the left",
        "equal cells, crossed",
        "single precision",
    ):
        assert open_cells[f"{name}, global"] > 0
        assert first[f"{name}, global"].count(2) > 0


if __name__ == "__main__":
    with open(sys.argv[1], "rb") as file:
        print(json.dumps(solve_all(pickle.load(file))))
