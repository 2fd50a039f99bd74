"""Any value of any option, in any combination: taken, or refused in one line.

``ELASTOIDENTIFY_FUZZ=20`` in the environment tries twenty times as many, and others each time.
"""

import os
import warnings
from itertools import chain

import elastoidentify as ei
import numpy as np
import pytest
from bodies import body, floor_and_top, push_from_above, scattered_triangles
from elastoidentify import InputError
from elastoidentify.cli import main
from elastoidentify.options import Choice, Flag, Picture
from elastoidentify.results import Status
from elastoidentify.study import IdentificationOptions, Study
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

TIMES = int(os.environ.get("ELASTOIDENTIFY_FUZZ", 1))
many = settings(max_examples=100 * TIMES, deadline=None, derandomize=TIMES == 1)
some = settings(
    max_examples=50 * TIMES, deadline=None, derandomize=TIMES == 1,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)  # fmt: skip

numbers = st.one_of(st.floats(), st.integers(), st.sampled_from([0, 1, 4, 0.45, -1e308, 1e-300]))
words = st.one_of(
    st.text(max_size=12), st.sampled_from(["None", "nan", "1e400", "0x10", "٣", "\n"])
)
simple = st.one_of(st.none(), st.booleans(), numbers, words, st.binary(max_size=4))
values = st.recursive(
    st.one_of(simple, numbers.map(np.array), st.lists(numbers, max_size=7).map(np.array)),
    lambda inner: st.one_of(
        st.lists(inner, max_size=6), st.dictionaries(st.integers(-2, 9), inner, max_size=3)
    ),
    max_leaves=12,
)
SCALARS = [name for name, one in Study.options().items() if not isinstance(one, Picture)]


@pytest.mark.parametrize("name", SCALARS)
@many
@given(value=values)
def test_any_value_is_taken_for_good_or_refused_in_one_line(name, value):
    try:
        study = Study(**{name: value})
    except InputError as error:
        assert len(str(error).splitlines()) == 1, error
        return
    taken = getattr(study, name)
    assert Study.options()[name].checked(taken) == taken  # what came in once comes in again


# ---- the command line


def said_of(option):
    """Return what might be said of an option: its flag, and right or any words."""
    if isinstance(option, Flag):
        return st.just([option.flags[0]])
    right = ["1", "4", "0.45", "1e-3", "2,3", "0,1,0,1", "1:E=5000,nu=0.43"]
    if isinstance(option, Choice):
        right += option.choices
    return st.tuples(st.sampled_from(option.flags), st.one_of(st.sampled_from(right), words)).map(
        lambda pair: [f"{pair[0]}={pair[1]}"]
    )


@pytest.fixture(scope="module")
def block(tmp_path_factory):
    pytest.importorskip("vtkmodules")
    from elastoidentify.filters import PushingPhantom
    from elastoidentify.vtk_io.vtu import write_mesh

    folder = tmp_path_factory.mktemp("block")
    phantom = PushingPhantom(resolution=4, noise=1e-4)
    phantom.Update()
    write_mesh(folder / "in.vtu", phantom.GetOutput())
    return folder


OPTIONS = [one for one in IdentificationOptions.options().values() if not isinstance(one, Picture)]


@some
@given(
    known=st.sampled_from([[], ["--known", "1:E=5000,nu=0.43"]]),
    said=st.lists(st.sampled_from(OPTIONS).flatmap(said_of), max_size=4),
)
def test_any_words_give_a_map_or_one_line(block, capsys, known, said):
    out = block / "out.vtu"
    out.unlink(missing_ok=True)
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # a library that warns has been given nonsense
        code = main(["identify", str(block / "in.vtu"), "-o", str(out), *known, *chain(*said)])
    err = capsys.readouterr().err.strip()
    assert code in (0, 2), err
    assert (code == 0) == out.exists()
    if code:
        assert len(err.splitlines()) == 1, err


# ---- the numerics


DAMAGES = (
    "none", "drop cells", "double", "flip", "nan", "far", "zero", "huge", "index", "move",
)  # fmt: skip


def damaged(one, kind, at, cell):
    """Return points, cells, trials, known, reaction nodes of a body, spoiled in one way."""
    points, cells, trials = one.points.copy(), one.cells.copy(), np.array(one.trials)
    keep = np.ones(len(cells), bool)
    if kind == "drop cells":
        keep[cell : cell + len(cells) // 3] = False
    elif kind == "double":
        keep = np.append(np.arange(len(cells)), cell)
    elif kind == "flip":
        cells[cell] = cells[cell][::-1]
    elif kind == "nan":
        trials[0, at] = np.nan
    elif kind == "far":
        trials[0, at] += 1.0
    elif kind == "zero":
        trials[:] = 0
    elif kind == "huge":
        trials *= 1e200
    elif kind == "index":
        cells[cell, 0] = len(points) + at
    elif kind == "move":
        points[at] = points[cells[cell, 0]]
    return points, cells[keep], trials, one.given[keep], one.reaction


CHOICES = {
    name: st.sampled_from(option.choices)
    for name, option in IdentificationOptions.options().items()
    if isinstance(option, Choice) and name != "grouping"
}


def pushed_body():
    points, cells = scattered_triangles(3, 1)
    known = points[cells].mean(axis=1)[:, 1] > 0.7
    one = body(points, cells, known, floor_and_top(points), seed=2)
    return push_from_above(one, 1.0, ((0, -0.05), (-0.05, -0.05)))


BODY = pushed_body()


@settings(parent=some, max_examples=100 * TIMES)
@given(
    kind=st.sampled_from(DAMAGES),
    at=st.integers(0, len(BODY.points) - 1),
    cell=st.integers(0, len(BODY.cells) - 1),
    chosen=st.fixed_dictionaries({}, optional=CHOICES),
    refine=st.sampled_from([None, 1, 4, 16, 3]),
    noise=st.sampled_from([None, 1e-4, 0.1]),
    poisson=st.sampled_from([None, 0.3, 0.499]),
)
def test_any_body_with_any_options_gives_an_honest_map_or_one_line(
    kind, at, cell, chosen, refine, noise, poisson
):
    points, cells, trials, known, reaction = damaged(BODY, kind, at, cell)
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        try:
            found = ei.identify(
                points, cells, trials, known, reaction_nodes=reaction, refine=refine, noise=noise,
                poisson_ratio=poisson, **chosen,
            )  # fmt: skip
        except InputError as error:
            assert len(str(error).splitlines()) == 1, error
            return
    given_cells = np.isfinite(known).all(axis=1)
    assert np.allclose(found.young[given_cells], known[given_cells, 0])
    left = found.status == Status.NOT_DETERMINED
    assert np.isnan(found.mu[left]).all()
    assert np.isfinite(found.mu[~left]).all()
