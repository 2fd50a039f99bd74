"""LameIdentification gives what the library gives, on the mesh that came in."""

import json

import elastoidentify as ei
import numpy as np
import pytest
from elastoidentify import InputError
from elastoidentify.fem.constitutive import KINEMATICS
from elastoidentify.filters import LameIdentification, PushingPhantom
from elastoidentify.inverse.methods import METHODS
from elastoidentify.results import QUANTITIES
from elastoidentify.vtk_io import convert

PAD = {1: (5000.0, 0.43)}


def updated(filter):
    filter.Update()
    return filter.GetOutput()


def cell(grid, name):
    return convert.get_array(grid.GetCellData(), name)


def by_library(grid, **settings):
    """The library's result for the arrays of a mesh."""
    blocks, order = convert.mesh_blocks(grid)
    points = grid.GetPointData()
    names = convert.displacement_names(grid)
    displacements = [convert.get_array(points, name) for name in names]
    result = ei.identify(
        convert.mesh_points(grid),
        blocks,
        np.stack(displacements),
        PAD,
        labels=cell(grid, "Label")[order],
        reaction_nodes=convert.get_array(points, "ReactionNodes").astype(bool),
        **settings,
    )
    return result, order


@pytest.mark.parametrize("shape", ["triangles", "quads", "tetrahedra", "hexahedra"])
@pytest.mark.parametrize("method", ["global", "sequential"])
def test_truth_is_found_on_every_kind_of_cell(shape, method):
    phantom = PushingPhantom(shape=shape, resolution=3, size=1.5)
    identification = LameIdentification(known_materials=PAD, method=method)
    found = identification(updated(phantom))
    status, mu = cell(found, "Status"), cell(found, "Mu")
    assert set(status[cell(found, "Label") == 1]) == {1}
    assert np.count_nonzero(status == 2) > 0 and not np.any(status == 3)
    some = status > 0
    np.testing.assert_allclose(mu[some], cell(found, "TrueMu")[some], rtol=1e-6)
    np.testing.assert_allclose(
        cell(found, "Lambda")[some], cell(found, "TrueLambda")[some], rtol=1e-5
    )
    assert np.all(np.isnan(mu[~some]))


@pytest.mark.parametrize(
    "settings",
    [
        {"method": "global"},
        {"method": "sequential"},
        {"method": "global", "grouping": "label"},
        {"method": "global", "kinematics": "neo-hookean"},
        {"method": "global", "plane": "stress"},
        {"method": "global", "unknowns": "young", "poisson_ratio": 0.43},
    ],
)
def test_numbers_are_the_librarys(settings):
    grid = updated(PushingPhantom(resolution=6, noise=1e-6))
    found = LameIdentification(known_materials=PAD, **settings)(grid)
    expected, _ = by_library(grid, **settings)
    for name, quantity in QUANTITIES.items():
        expected_values = getattr(expected, quantity.field)
        np.testing.assert_allclose(cell(found, name), expected_values, rtol=1e-12)
    np.testing.assert_array_equal(cell(found, "Status"), expected.status)
    np.testing.assert_array_equal(cell(found, "SequenceOrder"), expected.sequence_order)
    for number in (1, 2):
        residual = convert.get_array(found.GetPointData(), f"Residual_{number}")
        there = convert.vectors(expected.residuals[number - 1])
        np.testing.assert_allclose(residual, there, rtol=1e-12, atol=1e-12)
    report = json.loads(convert.get_text(found, "IdentificationReport"))
    assert report["method"] == expected.report["method"]


def test_every_method_and_kinematics_of_the_library_is_offered():
    assert LameIdentification.method.choices == tuple(METHODS)
    assert LameIdentification.kinematics.choices == tuple(KINEMATICS)
    assert {"auto", "sequential", "global", "regularized"} <= set(METHODS)


def test_cells_of_a_mixed_mesh_keep_their_order(random):
    """Triangles and quads mixed at random: each cell's result must be on that cell."""
    square = updated(PushingPhantom(resolution=6, shape="quads"))
    quads = convert.simplices(square)
    labels, points = cell(square, "Label"), convert.mesh_points(square)[:, :2]
    split = random.random(len(quads)) < 0.5
    grid = convert.vtkUnstructuredGrid()
    grid.SetPoints(square.GetPoints())
    label_of = []
    for label, quad, cut in zip(labels, quads, split, strict=True):
        for nodes in [quad[[0, 1, 3]], quad[[1, 2, 3]]] if cut else [quad]:
            kind = {3: convert.VTK_TRIANGLE, 4: convert.VTK_QUAD}[len(nodes)]
            grid.InsertNextCell(kind, len(nodes), [int(node) for node in nodes])
            label_of.append(label)
    truth = random.uniform(1000.0, 5000.0, grid.GetNumberOfCells())
    truth[np.array(label_of) == 1] = 5000.0 / 2.86
    blocks, order = convert.mesh_blocks(grid)
    lam = truth * 2 * 0.43 / (1 - 2 * 0.43)
    held = convert.get_array(square.GetPointData(), "ReactionNodes").astype(bool)
    for number, push in enumerate([(0, -0.01), (0.01, -0.01), (0.01, 0.005)], 1):
        from elastoidentify.fem.forward import solve_push

        target = np.where(points[held][:, 1:] > 0.1, push, 0.0)
        moved = np.flatnonzero(held)
        u = solve_push(points, blocks, lam[order], truth[order], moved, target)
        convert.set_array(grid.GetPointData(), f"Displacement_{number}", convert.vectors(u))
    convert.set_array(grid.GetPointData(), "ReactionNodes", held.astype(np.uint8))
    convert.set_array(grid.GetCellData(), "Label", np.array(label_of, np.int32))
    found = LameIdentification(known_materials=PAD, method="global")(grid)
    some = cell(found, "Status") > 0
    assert np.mean(some) > 0.8
    np.testing.assert_allclose(cell(found, "Mu")[some], truth[some], rtol=1e-6)


def test_known_cells_can_be_given_cell_by_cell(phantom):
    grid = updated(phantom)
    label = cell(grid, "Label")
    for name, value in (("KnownYoungModulus", 5000.0), ("KnownPoissonRatio", 0.43)):
        known = np.where(label == 1, value, np.nan)
        convert.set_array(grid.GetCellData(), name, known)
    found = LameIdentification(method="global")(grid)
    np.testing.assert_array_equal(cell(found, "Status") == 1, label == 1)
    np.testing.assert_allclose(cell(found, "Mu"), cell(grid, "TrueMu"), rtol=1e-8)

    convert.set_array(
        grid.GetCellData(), "KnownYoungModulus", np.where(np.arange(32) == 31, 5000.0, np.nan)
    )
    both = LameIdentification(method="global", known_materials=PAD)(grid)
    np.testing.assert_array_equal(cell(both, "Status") == 1, label == 1)
    with pytest.raises(InputError, match="label 8"):
        LameIdentification(method="global", known_materials={8: (1.0, 0.3)})(grid)


@pytest.mark.parametrize("shape", ["triangles", "hexahedra"])
def test_the_phantom_brings_its_pad_and_a_material_given_by_label_replaces_it(shape):
    grid = updated(PushingPhantom(shape=shape, resolution=4, young_modulus=6000.0))
    pad = cell(grid, "Label") == 1
    np.testing.assert_array_equal(np.isfinite(cell(grid, "KnownYoungModulus")), pad)
    found = LameIdentification(method="global")(grid)
    np.testing.assert_allclose(cell(found, "Mu"), cell(grid, "TrueMu"), rtol=1e-6)
    doubled = LameIdentification(method="global", known_materials={1: (12000.0, 0.43)})(grid)
    np.testing.assert_allclose(cell(doubled, "Mu"), 2 * cell(grid, "TrueMu"), rtol=1e-6)


def test_extra_arrays_pass_through_and_the_input_stays_as_it_was(phantom, random):
    grid = updated(phantom)
    mine = random.normal(size=(grid.GetNumberOfPoints(), 4))
    convert.set_array(grid.GetPointData(), "Mine", mine)
    convert.set_text(grid, "Patient", "none")
    before = grid.GetCellData().GetNumberOfArrays()
    found = LameIdentification(known_materials=PAD, method="global")(grid)
    np.testing.assert_array_equal(convert.get_array(found.GetPointData(), "Mine"), mine)
    assert convert.get_text(found, "Patient") == "none"
    assert grid.GetCellData().GetNumberOfArrays() == before


# ---- the choice of trials


def trials(identification):
    """How many trials the last run used."""
    points = identification.GetOutput().GetPointData()
    return [n for n in range(1, 9) if points.HasArray(f"Residual_{n}")][-1]


def test_all_displacements_are_trials_unless_chosen_otherwise():
    phantom = PushingPhantom(resolution=4, pushes=[(0, -0.01), (0.01, -0.01), (0.01, 0.0)])
    identification = LameIdentification(known_materials=PAD, method="global")
    identification.SetInputConnection(phantom.GetOutputPort())
    identification.Update()
    assert trials(identification) == 3
    identification.GetDisplacementArraySelection().DisableArray("Displacement_1")
    identification.Update()
    assert trials(identification) == 2
    identification.displacement_arrays = ["Displacement_3"]
    with pytest.raises(InputError):  # one trial is not enough for every cell
        identification.Update()
    identification.displacement_arrays = []
    identification.Update()
    assert trials(identification) == 3


def test_trials_follow_the_input_where_nothing_was_chosen():
    phantom = PushingPhantom(resolution=4)
    identification = LameIdentification(known_materials=PAD, method="global")
    identification.SetInputConnection(phantom.GetOutputPort())
    identification.Update()
    phantom.pushes = [(0, -0.01), (0.01, -0.01), (0.01, 0.0)]
    identification.Update()
    assert trials(identification) == 3
    phantom.pushes = [(0, -0.01), (0.01, -0.01)]
    identification.Update()
    assert trials(identification) == 2


def test_a_choice_made_before_the_first_run_holds():
    phantom = PushingPhantom(resolution=4, pushes=[(0, -0.01), (0.01, -0.01), (0.01, 0.0)])
    for choose in (
        lambda i: [i.EnableArray(f"Displacement_{k}") for k in (1, 3)],
        lambda i: i.DisableArray("Displacement_2"),
    ):
        identification = LameIdentification(known_materials=PAD, method="global")
        choose(identification.GetDisplacementArraySelection())
        identification.SetInputConnection(phantom.GetOutputPort())
        identification.Update()
        assert trials(identification) == 2


def test_other_vector_arrays_are_offered_switched_off(phantom):
    grid = updated(phantom)
    u = convert.get_array(grid.GetPointData(), "Displacement_2").copy()
    grid.GetPointData().RemoveArray("Displacement_2")
    convert.set_array(grid.GetPointData(), "Measured", u)
    identification = LameIdentification(known_materials=PAD, method="global")
    identification.SetInputData(grid)
    with pytest.raises(InputError):
        identification.Update()  # one trial only
    identification.GetDisplacementArraySelection().EnableArray("Measured")
    identification.Update()
    np.testing.assert_allclose(
        cell(identification.GetOutput(), "Mu"), cell(grid, "TrueMu"), rtol=1e-8
    )
    identification.displacement_arrays = ["Displacement_1", "Absent"]
    with pytest.raises(InputError, match="no point array 'Absent'"):
        identification.Update()


def test_displacements_must_be_there_and_be_vectors(phantom):
    grid = updated(phantom)
    for name in ("Displacement_1", "Displacement_2"):
        grid.GetPointData().RemoveArray(name)
    with pytest.raises(InputError, match="needs a point array Displacement_1"):
        LameIdentification(known_materials=PAD)(grid)
    convert.set_array(grid.GetPointData(), "Displacement_1", np.zeros(grid.GetNumberOfPoints()))
    with pytest.raises(InputError, match="holds no vectors"):
        LameIdentification(known_materials=PAD)(grid)


def test_information_reaches_the_library_only_if_every_trial_has_it(phantom, monkeypatch):
    seen = []
    monkeypatch.setattr(
        "elastoidentify.pipeline.identify",
        lambda *args, information, **rest: seen.append(information) or 1 / 0,
    )
    grid = updated(phantom)
    rows = np.tile([10.0, 20, 30, 1, 2, 3], (grid.GetNumberOfPoints(), 1))
    for number in (1, 2):
        with pytest.raises(ZeroDivisionError):
            LameIdentification(known_materials=PAD)(grid)
        assert seen.pop() is None
        convert.set_array(grid.GetPointData(), f"DisplacementInformation_{number}", rows)
    with pytest.raises(ZeroDivisionError):
        LameIdentification(known_materials=PAD)(grid)
    assert seen[0].shape == (2, grid.GetNumberOfPoints(), 3, 3)
    np.testing.assert_array_equal(seen[0][1, 4], [[10, 1, 3], [1, 20, 2], [3, 2, 30]])
