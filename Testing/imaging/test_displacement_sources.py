"""Displacements measured elsewhere, at mesh nodes."""

from pathlib import Path

import numpy as np
import pytest
from elastoidentify.errors import InputError
from elastoidentify.imaging.registration.sources import (
    displacement_from_field,
    displacement_from_points,
    displacement_from_transform,
)

TRUTHCUBE = Path(__file__).parents[3] / "shared/data/truthcube/uniaxial_positions.csv"
GRADIENT = np.array([[-0.1, 0.02, 0.0], [0.03, 0.05, -0.01], [0.0, 0.02, 0.04]])


def linear_displacement(points):
    return points @ GRADIENT.T + [1.0, -2.0, 0.5]


@pytest.fixture
def nodes():
    return np.random.default_rng(0).uniform(20, 40, (50, 3))


def oblique_field(folder):
    """A linear displacement stored on an oblique anisotropic grid; returns its path."""
    sitk = pytest.importorskip("SimpleITK")
    angle = 0.4
    direction = np.array(
        [[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]]
    )
    spacing, origin = np.array([1.0, 2.0, 3.0]), np.array([10.0, -10.0, 0.0])
    k, j, i = np.mgrid[:20, :40, :60]
    index = np.stack([i, j, k], -1)
    world = (index * spacing) @ direction.T + origin
    image = sitk.GetImageFromArray(linear_displacement(world), isVector=True)
    image.SetSpacing(spacing.tolist())
    image.SetOrigin(origin.tolist())
    image.SetDirection(direction.ravel().tolist())
    path = folder / "field.nrrd"
    sitk.WriteImage(image, str(path))
    return path


def test_a_linear_field_on_an_oblique_grid_is_read_exactly(tmp_path, nodes):
    found = displacement_from_field(oblique_field(tmp_path), nodes, noise=0.1)
    assert found.covered.all()
    np.testing.assert_allclose(found.displacement, linear_displacement(nodes), atol=1e-9)
    np.testing.assert_allclose(found.information, [[100, 100, 100, 0, 0, 0]] * len(nodes))


def test_nodes_outside_the_field_have_no_weight_and_a_note(tmp_path, nodes):
    nodes[:3] += 500
    found = displacement_from_field(oblique_field(tmp_path), nodes, noise=0.1)
    assert not found.covered[:3].any() and found.covered[3:].all()
    assert not found.information[:3].any()
    assert "3 of 50 mesh nodes" in found.notes[0]


def test_a_field_elsewhere_is_refused(tmp_path, nodes):
    with pytest.raises(InputError, match="covers only 0 %"):
        displacement_from_field(oblique_field(tmp_path), nodes + 500)


def test_a_scalar_image_is_no_field(tmp_path, nodes):
    sitk = pytest.importorskip("SimpleITK")
    path = tmp_path / "scalar.nrrd"
    sitk.WriteImage(sitk.GetImageFromArray(np.ones((4, 4, 4), np.float32)), str(path))
    with pytest.raises(InputError, match=r"1 number\(s\) per voxel"):
        displacement_from_field(path, nodes)


def test_an_affine_transform_file_gives_its_displacement(tmp_path, nodes):
    sitk = pytest.importorskip("SimpleITK")
    transform = sitk.AffineTransform(3)
    transform.SetMatrix((np.eye(3) + GRADIENT).ravel().tolist())
    transform.SetTranslation([1.0, -2.0, 0.5])
    path = tmp_path / "affine.tfm"
    sitk.WriteTransform(transform, str(path))
    found = displacement_from_transform(path, nodes)
    assert found.covered.all() and found.information is None
    np.testing.assert_allclose(found.displacement, linear_displacement(nodes), atol=1e-9)


def test_an_unreadable_transform_is_one_line(tmp_path, nodes):
    path = tmp_path / "none.tfm"
    path.write_text("nothing")
    with pytest.raises(InputError) as error:
        displacement_from_transform(path, nodes)
    assert "\n" not in str(error.value)


def test_a_table_of_points_is_interpolated_exactly_where_linear(tmp_path, nodes):
    places = np.random.default_rng(1).uniform(15, 45, (200, 3))
    places = np.vstack([places, [[x, y, z] for x in (10, 50) for y in (10, 50) for z in (10, 50)]])
    path = tmp_path / "points.csv"
    rows = np.hstack([places, linear_displacement(places)])
    np.savetxt(path, rows, delimiter=",", header="x,y,z,u,v,w", comments="", fmt="%.17g")
    found = displacement_from_points(path, nodes)
    assert found.covered.all()
    np.testing.assert_allclose(found.displacement, linear_displacement(nodes), atol=1e-9)


def test_points_in_one_plane_serve_a_planar_mesh():
    places = np.array([[x, y, 7.0] for x in range(5) for y in range(5)])
    rows = np.hstack([places, linear_displacement(places)])
    nodes = np.array([[1.3, 2.2, 7.0], [3.9, 0.1, 7.0]])
    found = displacement_from_points(rows, nodes)
    np.testing.assert_allclose(found.displacement, linear_displacement(nodes), atol=1e-9)


@pytest.mark.parametrize(
    "text, said",
    [
        ("x,y,z,u,v\n1,2,3,4,5\n", "lacks the column"),
        ("x,y,z,u,v,w\n1,2,3,4,5,six\n", "row 2"),
        ("x,y,z,u,v,w\n1,2,3,4,5,nan\n", "not numbers in 1 of 1"),
        ("x,y,z,u,v,w\n0,0,0,1,1,1\n1,0,0,1,1,1\n2,0,0,1,1,1\n", "on one line"),
        ("", "lacks the column"),
    ],
)
def test_a_bad_table_is_one_line(tmp_path, nodes, text, said):
    path = tmp_path / "points.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=said) as error:
        displacement_from_points(path, nodes)
    assert "\n" not in str(error.value)


def test_measured_beads_predict_the_beads_between_them():
    """Each inner bead of the Truth Cube, from its neighbours, to within the CT's bead noise."""
    if not TRUTHCUBE.exists():
        pytest.skip("needs the measured beads, shared/data/truthcube beside the repository")
    lines = TRUTHCUBE.read_text().splitlines()
    numbers = [line.split(",") for line in lines if line[:1].isdigit()]
    rows = np.array([[float(v) for v in line[:15]] for line in numbers if all(line[:15])])
    assert len(rows) == 343
    table = np.hstack([rows[:, 3:6], rows[:, 9:12] - rows[:, 3:6]])
    inner = ((rows[:, :3] > rows[:, :3].min(0)) & (rows[:, :3] < rows[:, :3].max(0))).all(1)
    kept = rows[:, :3].sum(1) % 2 == 0
    asked = inner & ~kept
    found = displacement_from_points(table[kept], table[asked, :3])
    error = found.displacement - table[asked, 3:]
    noise = np.array([0.10, 0.27, 0.10]) * np.sqrt(2)  # two states enter each displacement
    assert found.covered.all()
    assert (error.std(0) < 2 * noise).all(), error.std(0)
