"""Image and mesh files: the geometry survives, what cannot be used is refused in one line."""

import numpy as np
import pytest
from elastoidentify.errors import InputError
from elastoidentify.imaging.image import Image
from elastoidentify.imaging.io import check_writable, read_image, write_image

sitk = pytest.importorskip("SimpleITK")


def rotation(*angles):
    """Rotations about z, then x, in radians."""
    a, b = angles
    about_z = [[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]]
    about_x = [[1, 0, 0], [0, np.cos(b), -np.sin(b)], [0, np.sin(b), np.cos(b)]]
    return np.array(about_z) @ np.array(about_x)


@pytest.fixture
def oblique():
    values = np.random.default_rng(0).random((3, 5, 7)).astype(np.float32)
    return Image(values, [10, -20, 3], [0.5, 0.7, 2], rotation(0.3, 0.5))


@pytest.mark.parametrize("suffix", [".nrrd", ".nii", ".nii.gz", ".mha"])
def test_an_oblique_image_comes_back_from_its_file(tmp_path, oblique, suffix):
    write_image(tmp_path / f"image{suffix}", oblique)
    back = read_image(tmp_path / f"image{suffix}")
    assert np.array_equal(back.array, oblique.array)
    corner = np.array([[6.0, 4.0, 2.0]])
    assert np.allclose(back.index_to_world(corner), oblique.index_to_world(corner), atol=1e-5)
    assert [file.name for file in tmp_path.iterdir()] == [f"image{suffix}"]


def test_world_positions_are_those_of_itk(tmp_path, oblique):
    write_image(tmp_path / "image.nrrd", oblique)
    point = sitk.ReadImage(str(tmp_path / "image.nrrd")).TransformIndexToPhysicalPoint((6, 1, 2))
    assert np.allclose(oblique.index_to_world(np.array([[6, 1, 2]]))[0], point)


def test_a_planar_image_becomes_one_slice(tmp_path):
    flat = sitk.GetImageFromArray(np.arange(12, dtype=np.int16).reshape(3, 4))
    flat.SetSpacing((0.5, 2.0))
    flat.SetOrigin((1.0, 2.0))
    sitk.WriteImage(flat, str(tmp_path / "flat.nrrd"))
    image = read_image(tmp_path / "flat.nrrd")
    assert image.size == (4, 3, 1)
    assert np.allclose(image.index_to_world(np.array([[3, 2, 0]])), [[2.5, 6.0, 0.0]])


def test_a_dicom_folder_is_read_in_order_of_position(tmp_path):
    for k in range(4):
        one = sitk.GetImageFromArray(np.full((1, 6, 5), 10 * k, np.int16))
        for tag, value in {
            "0008|0060": "MR",
            "0020|000e": "1.2.3.4",
            "0020|0013": str(k),
            "0020|0032": f"0\\0\\{3.0 * k}",
            "0020|0037": "1\\0\\0\\0\\1\\0",
            "0018|0050": "3",
        }.items():
            one.SetMetaData(tag, value)
        one.SetOrigin((0.0, 0.0, 3.0 * k))
        writer = sitk.ImageFileWriter()
        writer.KeepOriginalImageUIDOn()
        writer.SetFileName(str(tmp_path / f"{9 - k}.dcm"))
        writer.Execute(one)
    image = read_image(tmp_path)
    assert image.size == (5, 6, 4)
    assert image.array[:, 0, 0].tolist() == [0, 10, 20, 30]
    assert np.isclose(image.spacing[2], 3.0)


def test_a_grey_picture_stored_as_colours_is_grey_and_colours_are_refused(tmp_path):
    values = np.random.default_rng(0).integers(0, 255, (5, 6, 3)).astype(np.uint8)
    sitk.WriteImage(sitk.GetImageFromArray(values, isVector=True), str(tmp_path / "colour.png"))
    grey = np.repeat(values[..., :1], 3, axis=2)
    sitk.WriteImage(sitk.GetImageFromArray(grey, isVector=True), str(tmp_path / "grey.png"))
    assert np.array_equal(read_image(tmp_path / "grey.png").array[0], grey[..., 0])
    with pytest.raises(InputError, match="3 values per voxel"):
        read_image(tmp_path / "colour.png")


def test_one_time_step_is_a_volume_and_several_are_refused(tmp_path):
    for steps, name in ((1, "one.nrrd"), (2, "two.nrrd")):
        values = np.zeros((steps, 3, 4, 5), np.float32)
        sitk.WriteImage(sitk.GetImageFromArray(values, isVector=False), str(tmp_path / name))
    assert read_image(tmp_path / "one.nrrd").size == (5, 4, 3)
    with pytest.raises(InputError, match="one time step"):
        read_image(tmp_path / "two.nrrd")


@pytest.mark.parametrize("name", ["text.nrrd", "text.nii.gz", "missing.nrrd", "empty"])
def test_what_is_no_image_is_refused_in_one_line(tmp_path, name):
    if name.startswith("text"):
        (tmp_path / name).write_text("no image")
    if name == "empty":
        (tmp_path / name).mkdir()
    with pytest.raises(InputError) as error:
        read_image(tmp_path / name)
    assert name in str(error.value)
    assert "\n" not in str(error.value)


def test_an_image_that_cannot_be_written_leaves_nothing(tmp_path, oblique, monkeypatch):
    with pytest.raises(InputError, match="written as"):
        write_image(tmp_path / "image.xyz", oblique)
    with pytest.raises(InputError, match="cannot be written"):
        write_image(tmp_path / "nowhere" / "image.nrrd", oblique)

    def disk_full(image, path, compress):
        with open(path, "w") as part:
            part.write("half of it")
        raise RuntimeError("no space left")

    monkeypatch.setattr(sitk, "WriteImage", disk_full)
    with pytest.raises(InputError, match="no space left"):
        write_image(tmp_path / "image.nrrd", oblique)
    assert list(tmp_path.iterdir()) == []


def test_outputs_are_checked_before_the_work(tmp_path):
    check_writable(tmp_path / "fine.vtu")
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(InputError, match="does not exist"):
        check_writable(tmp_path / "nowhere" / "map.vtu")
    with pytest.raises(InputError, match="is a folder"):
        check_writable(tmp_path)


# ---- meshes


@pytest.fixture
def vtu():
    pytest.importorskip("vtkmodules")
    from elastoidentify.vtk_io import vtu

    return vtu


@pytest.fixture
def triangle(vtu):
    from elastoidentify.vtk_io.convert import mesh_to_vtk, set_array, set_text

    grid = mesh_to_vtk(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2]]))
    set_array(grid.GetCellData(), "Label", np.array([7], np.int32))
    set_array(grid.GetPointData(), "Displacement_1", np.arange(9.0).reshape(3, 3))
    set_text(grid, "IdentificationReport", '{"method": "global", "μ": [1, 2]}')
    return grid


def test_a_mesh_comes_back_with_all_its_data(tmp_path, vtu, triangle):
    from elastoidentify.vtk_io.convert import get_array, get_text, mesh_points

    vtu.write_mesh(tmp_path / "mesh.vtu", triangle)
    back = vtu.read_mesh(tmp_path / "mesh.vtu")
    assert np.array_equal(mesh_points(back), mesh_points(triangle))
    assert get_array(back.GetCellData(), "Label").dtype == np.int32
    assert np.array_equal(get_array(back.GetPointData(), "Displacement_1").ravel(), np.arange(9.0))
    assert get_text(back, "IdentificationReport") == '{"method": "global", "μ": [1, 2]}'
    assert [file.name for file in tmp_path.iterdir()] == ["mesh.vtu"]


@pytest.mark.parametrize("share", [0.0, 0.3, 0.6, 0.9])
def test_a_cut_off_mesh_file_is_refused_and_nothing_printed(tmp_path, vtu, triangle, share, capfd):
    vtu.write_mesh(tmp_path / "mesh.vtu", triangle)
    whole = (tmp_path / "mesh.vtu").read_bytes()
    (tmp_path / "cut.vtu").write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(InputError, match=r"cut\.vtu"):
        vtu.read_mesh(tmp_path / "cut.vtu")
    assert capfd.readouterr() == ("", "")


def test_a_mesh_that_cannot_be_written_leaves_nothing(tmp_path, vtu, triangle):
    with pytest.raises(InputError, match="cannot be written"):
        vtu.write_mesh(tmp_path / "nowhere" / "mesh.vtu", triangle)
    with pytest.raises(InputError, match=r"written as \.vtu"):
        vtu.write_mesh(tmp_path / "mesh.vtk", triangle)
    assert list(tmp_path.iterdir()) == []
