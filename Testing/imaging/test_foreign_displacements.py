"""Displacements from other programs: where they have data, how tables are written, which units."""

import numpy as np
import pytest
from elastoidentify.errors import InputError
from elastoidentify.imaging.registration.sources import (
    displacement_from_field,
    displacement_from_points,
    displacement_from_transform,
)

sitk = pytest.importorskip("SimpleITK")

NODES = np.array(
    [[x, y, z] for x in (1.0, 7, 13, 19) for y in (1.0, 9, 17, 25, 33) for z in (2.0, 8)]
)
BEYOND = NODES[:, 1] > 20


def field(height=41, shift=(0.5, -0.25, 0.1), dtype=np.float64):
    """Return a field of 21 × height × 11 mm, constant but for a tilt in y."""
    _, j, i = np.mgrid[:11, :height, :21].astype(float)
    u = np.stack([shift[0] + 0.01 * j, shift[1] + 0.02 * j, shift[2] + 0 * i], -1)
    return sitk.GetImageFromArray(u.astype(dtype), isVector=True)


def warp(height=41, **how):
    return sitk.DisplacementFieldTransform(field(height, **how))


def expected(points, last, shift=(0.5, -0.25, 0.1)):
    """Return the field's displacement, beyond y = last that of the nearest place."""
    y = np.minimum(points[:, 1], last)
    return np.column_stack([shift[0] + 0.01 * y, shift[1] + 0.02 * y, shift[2] + 0 * y])


def affine(scale=0.96, move=(0.3, 1.0, -0.2)):
    transform = sitk.AffineTransform(3)
    transform.SetMatrix([1, 0, 0, 0, scale, 0, 0, 0, 1])
    transform.SetTranslation(move)
    return transform


def composite(*parts):
    """Return the transform that applies the last part first, as ITK does."""
    transform = sitk.CompositeTransform(3)
    for part in parts:
        transform.AddTransform(part)
    return transform


@pytest.mark.parametrize("suffix", [".h5", ".tfm", ".txt"])
def test_where_a_warp_ends_its_nearest_displacement_is_taken_without_weight(tmp_path, suffix):
    path = tmp_path / f"warp{suffix}"
    sitk.WriteTransform(warp(20), str(path))
    found = displacement_from_transform(path, NODES, noise=0.1)
    assert np.array_equal(found.covered, ~BEYOND)
    assert np.array_equal(found.information[:, 0] > 0, ~BEYOND)
    assert np.allclose(found.displacement, expected(NODES, 19), atol=1e-6)
    assert "nearest place" in found.notes[0]


def test_a_node_that_does_not_move_keeps_its_weight(tmp_path):
    still = field(shift=(0, 0, 0))
    array = sitk.GetArrayFromImage(still)
    array[:, 20:] = 0
    held = sitk.GetImageFromArray(array, isVector=True)
    sitk.WriteTransform(sitk.DisplacementFieldTransform(held), str(tmp_path / "held.h5"))
    found = displacement_from_transform(tmp_path / "held.h5", NODES, noise=0.1)
    assert found.covered.all() and (found.information[:, 0] > 0).all() and not found.notes
    assert (found.displacement[BEYOND] == 0).all()


@pytest.mark.parametrize("order", ["affine first", "warp first", "three"])
def test_a_composite_ends_where_its_warp_ends(tmp_path, order):
    parts = {
        "affine first": (warp(20), affine()),
        "warp first": (affine(), warp(20)),
        "three": (warp(41), affine(), warp(20)),
    }[order]
    sitk.WriteTransform(composite(*parts), str(tmp_path / "both.h5"))
    found = displacement_from_transform(tmp_path / "both.h5", NODES, noise=0.1)
    assert not found.covered[BEYOND].any() and found.covered[NODES[:, 1] < 17].all()
    whole = sitk.CompositeTransform(sitk.ReadTransform(str(tmp_path / "both.h5")))
    direct = np.array([whole.TransformPoint(p) for p in NODES.tolist()]) - NODES
    inside = found.covered
    assert np.allclose(found.displacement[inside], direct[inside], atol=1e-9)
    assert np.abs(found.displacement[BEYOND] - direct[BEYOND]).max() > 0.1  # ITK: the affine alone


def test_a_bspline_ends_at_its_domain(tmp_path):
    image = sitk.Image(21, 20, 11, sitk.sitkFloat32)
    spline = sitk.BSplineTransformInitializer(image, [4, 4, 4])
    parameters = np.random.default_rng(0).uniform(0.2, 0.6, len(spline.GetParameters()))
    spline.SetParameters(parameters.tolist())
    sitk.WriteTransform(spline, str(tmp_path / "spline.tfm"))
    found = displacement_from_transform(tmp_path / "spline.tfm", NODES, noise=0.1)
    assert np.array_equal(found.covered, ~BEYOND)
    assert (np.abs(found.displacement) > 0.1).all()
    direct = np.array([spline.TransformPoint(p) for p in NODES.tolist()]) - NODES
    assert np.allclose(found.displacement[~BEYOND], direct[~BEYOND], atol=1e-9)


def test_a_turned_warp_ends_where_its_grid_says(tmp_path):
    turned = field(20)
    turned.SetDirection([0, -1, 0, 1, 0, 0, 0, 0, 1])  # its j runs along −x
    turned.SetOrigin([19.0, 0, 0])
    sitk.WriteTransform(sitk.DisplacementFieldTransform(turned), str(tmp_path / "turned.h5"))
    found = displacement_from_transform(tmp_path / "turned.h5", NODES)
    assert np.array_equal(found.covered, NODES[:, 1] <= 20.5)


def test_a_transform_of_two_dimensions_serves_every_slice(tmp_path):
    j, _ = np.mgrid[:41, :21].astype(float)
    u = np.stack([0.5 + 0.01 * j, 0.02 * j], -1)
    flat = sitk.DisplacementFieldTransform(sitk.GetImageFromArray(u, isVector=True))
    sitk.WriteTransform(flat, str(tmp_path / "flat.tfm"))
    found = displacement_from_transform(tmp_path / "flat.tfm", NODES)
    assert found.covered.all() and (found.displacement[:, 2] == 0).all()
    assert np.allclose(found.displacement[:, 1], 0.02 * NODES[:, 1], atol=1e-9)


def test_transforms_of_slicer_and_elastix_that_lead_elsewhere_are_refused(tmp_path):
    sitk.WriteTransform(warp(20), str(tmp_path / "warp.tfm"))
    text = (tmp_path / "warp.tfm").read_text()
    inverse = text.replace("DisplacementFieldTransform", "InverseDisplacementFieldTransform")
    (tmp_path / "inverse.tfm").write_text(inverse)
    with pytest.raises(InputError, match="modelling transform"):
        displacement_from_transform(tmp_path / "inverse.tfm", NODES)
    (tmp_path / "elastix.txt").write_text(
        '(Transform "BSplineTransform")\n(NumberOfParameters 3)\n'
    )
    with pytest.raises(InputError, match="transformix"):
        displacement_from_transform(tmp_path / "elastix.txt", NODES)


@pytest.mark.parametrize("marked, fine", [("modeling", False), ("resampling", True)])
def test_a_field_of_slicer_says_which_way_it_leads(tmp_path, marked, fine):
    image = field()
    image.SetMetaData("displacement field type", marked)
    sitk.WriteImage(image, str(tmp_path / "field.nrrd"))
    if fine:
        found = displacement_from_field(tmp_path / "field.nrrd", NODES)
        assert np.allclose(found.displacement, expected(NODES, 99), atol=1e-6)
    else:
        with pytest.raises(InputError, match="modelling transform"):
            displacement_from_field(tmp_path / "field.nrrd", NODES)


@pytest.mark.parametrize("plane", ["axial", "coronal", "sagittal"])
@pytest.mark.parametrize("suffix", [".nii.gz", ".nii", ".nrrd", ".mha"])
def test_a_field_of_one_slice_is_read_in_any_plane(tmp_path, plane, suffix):
    rows = {"axial": [0, 1, 2], "coronal": [0, 2, 1], "sagittal": [1, 2, 0]}[plane]
    direction = np.eye(3)[:, rows]
    if np.linalg.det(direction) < 0:
        direction[:, 2] *= -1
    j, i = np.mgrid[:12, :10].astype(float)
    world = np.stack([3 * i, 2 * j, 0 * i], -1) @ direction.T + [5, 6, 7]
    u = 0.02 * world + [0.1, 0, 0.3]
    image = sitk.GetImageFromArray(u[None], isVector=True)
    image.SetSpacing((3.0, 2.0, 1.0))
    image.SetOrigin((5.0, 6.0, 7.0))
    image.SetDirection(direction.ravel().tolist())
    sitk.WriteImage(image, str(tmp_path / f"field{suffix}"))
    nodes = world[1:-1:2, 1:-1:2].reshape(-1, 3) + direction @ [0.5, 0.5, 0]
    found = displacement_from_field(tmp_path / f"field{suffix}", nodes)
    assert found.covered.all()
    assert np.allclose(found.displacement, 0.02 * nodes + [0.1, 0, 0.3], atol=1e-5)


def test_a_cut_field_is_refused(tmp_path):
    for name in ("field.nii", "field.mha", "field.nrrd"):
        sitk.WriteImage(field(), str(tmp_path / name))
        whole = (tmp_path / name).read_bytes()
        (tmp_path / name).write_bytes(whole[: len(whole) // 2])
        with pytest.raises(InputError, match="damaged"):
            displacement_from_field(tmp_path / name, NODES)


# ---- units


@pytest.mark.parametrize("factor, said", [(1000.0, "unit of length"), (1e-5, "unit of length")])
def test_a_field_in_another_unit_is_seen(tmp_path, factor, said):
    array = factor * sitk.GetArrayFromImage(field())
    sitk.WriteImage(sitk.GetImageFromArray(array, isVector=True), str(tmp_path / "field.nrrd"))
    if factor > 1:
        with pytest.raises(InputError, match=said):
            displacement_from_field(tmp_path / "field.nrrd", NODES)
    else:
        assert said in displacement_from_field(tmp_path / "field.nrrd", NODES).notes[0]


@pytest.mark.parametrize("noise", [0.0, -1.0, np.nan, np.inf, 1e-200])
def test_a_noise_that_is_no_length_is_refused(tmp_path, noise):
    sitk.WriteTransform(warp(), str(tmp_path / "warp.h5"))
    with pytest.raises(InputError, match="noise"):
        displacement_from_transform(tmp_path / "warp.h5", NODES, noise=noise)


# ---- tables


def table(separator=",", comma=False, names="x,y,z,u,v,w", end="", encoding="utf-8"):
    """Return the bytes of a table of a linear displacement."""
    lines = [names.replace(",", separator)]
    for x in (0, 10, 20):
        for y in (0, 20, 40):
            for z in (0, 10):
                numbers = [x, y, z, 0.02 * x, -0.01 * y, 0.25]
                cells = [f"{n:.4f}".replace(".", "," if comma else ".") for n in numbers]
                lines.append(separator.join(cells) + end)
    return "\n".join(lines).encode(encoding)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
@pytest.mark.parametrize(
    "separator, comma", [(",", False), (";", False), (";", True), ("\t", True)]
)
def test_tables_of_spreadsheets_are_read(tmp_path, separator, comma, encoding):
    (tmp_path / "t.csv").write_bytes(table(separator, comma, end=separator, encoding=encoding))
    found = displacement_from_points(tmp_path / "t.csv", NODES)
    truth = np.column_stack([0.02 * NODES[:, 0], -0.01 * NODES[:, 1], 0 * NODES[:, 0] + 0.25])
    assert np.allclose(found.displacement, truth, atol=1e-9)


@pytest.mark.parametrize(
    "content, said",
    [
        (table(",", comma=True), "12 cells under 6 columns.*decimal commas"),
        (table(",", names="x,y,z,u,v,w,x"), "'?x'? twice"),
        (b"x,y,z,u,v,w\n1,2,3,4,5,1_0\n", "row 2"),
        (b"x,y,z,u,v,w\n" + b"1" * 200_000 + b",1,1,1,1,1\n", "read the table"),
        (b"x,y,z,u,v,w\n1,2,3\n", "row 2"),
        (b"\xff\xfe\x00", "read the table|lacks"),
        (b"x,y,z,u,v,w\n", "on one line"),
    ],
)
def test_other_tables_are_refused_in_one_line(tmp_path, content, said):
    (tmp_path / "t.csv").write_bytes(content)
    with pytest.raises(InputError, match=said) as error:
        displacement_from_points(tmp_path / "t.csv", NODES)
    assert "\n" not in str(error.value) and len(str(error.value)) < 500


def test_masked_and_complex_points_are_refused():
    rows = np.random.default_rng(0).random((9, 6))
    with pytest.raises(InputError, match="masked"):
        displacement_from_points(np.ma.masked_greater(rows, 0.9), NODES)
    with pytest.raises(InputError, match="complex"):
        displacement_from_points(rows + 1j, NODES)
