"""Kinds of damage that the fuzzer found: each ended the process or came out as a traceback."""

import struct

import numpy as np
import pytest
from elastoidentify.errors import InputError
from elastoidentify.imaging.io import read_image
from elastoidentify.imaging.registration.sources import displacement_from_transform

sitk = pytest.importorskip("SimpleITK")

NODES = np.array([[x, y, 0.0] for x in (1.0, 4, 7) for y in (1.0, 4, 7)])


def image(path, pack=False):
    values = np.random.default_rng(0).integers(1, 200, (3, 8, 9)).astype(np.uint8)
    sitk.WriteImage(sitk.GetImageFromArray(values), str(path), pack)
    return path.read_bytes()


@pytest.mark.parametrize(
    "old, new",
    [
        (b"NDims = 3", b"NDims = 99999999"),
        (b"NDims = 3", b"NDims = -3"),
        (b"DimSize = 9 8 3", b"DimSize = 9 8"),
        (b"Offset = 0 0 0", b"Offset = 0"),
        (b"TransformMatrix = 1 0 0", b"TransformMatrix = 1 0"),
        (b"ElementDataFile = LOCAL\n", b"ElementDataFile = LOCAL"),
        (b"ElementDataFile = LOCAL", b"ElementDataFile = a%bLOCAL"),
        (b"ElementDataFile = LOCAL", b"ElementDataFile = LIST"),
        (b"ElementType = MET_UCHAR", b"ElementType = MET_UCHAZ"),
    ],
)
def test_a_metaimage_header_that_contradicts_itself(tmp_path, old, new):
    whole = image(tmp_path / "a.mha")
    assert old in whole
    (tmp_path / "a.mha").write_bytes(whole.replace(old, new))
    with pytest.raises(InputError):
        read_image(tmp_path / "a.mha")


def test_a_jpeg_whose_damage_only_its_library_prints(tmp_path, capfd):
    values = np.random.default_rng(0).integers(0, 255, (64, 64)).astype(np.uint8)
    sitk.WriteImage(sitk.GetImageFromArray(values), str(tmp_path / "a.jpg"))
    whole = bytearray((tmp_path / "a.jpg").read_bytes())
    middle = len(whole) // 2
    whole[middle : middle + 40] = b"\x55" * 40
    (tmp_path / "a.jpg").write_bytes(whole)
    capfd.readouterr()
    with pytest.raises(InputError, match=r"damaged|not an image"):
        read_image(tmp_path / "a.jpg")
    assert capfd.readouterr() == ("", "")


def test_a_tiff_whose_pictures_are_of_several_kinds(tmp_path):
    values = np.random.default_rng(0).integers(0, 200, (3, 8, 9)).astype(np.int16)
    sitk.WriteImage(sitk.GetImageFromArray(values), str(tmp_path / "a.tif"))
    whole = (tmp_path / "a.tif").read_bytes()
    tag = struct.pack("<HHI", 254, 4, 1)
    last = whole.rindex(tag) + len(tag)
    (tmp_path / "a.tif").write_bytes(whole[:last] + b"\0\0\0\0" + whole[last + 4 :])
    with pytest.raises(InputError, match="several kinds"):
        read_image(tmp_path / "a.tif")


def warp(path):
    array = np.full((2, 10, 10, 3), 0.25)
    field = sitk.GetImageFromArray(array, isVector=True)
    sitk.WriteTransform(sitk.DisplacementFieldTransform(field), str(path))
    return path.read_text()


@pytest.mark.parametrize(
    "old, new",
    [
        ("Parameters: 0.25 0.25 ", "Parameters: 0.25 "),
        ("Parameters: 0.25 0.25 ", "Parameters: 0.2 5 0.25 "),
        ("FixedParameters: 10 10 2", "FixedParameters: 10 10 200000"),
        ("FixedParameters: 10 10 2", "FixedParameters: 10 10"),
        ("FixedParameters: 10 10 2", "FixedParameters: 10 10 nan"),
        ("1 0 0 0 1 0 0 0 1", "0 0 0 0 1 0 0 0 1"),
        ("FixedParameters", "FixedParameter\u00e9"),
    ],
)
def test_a_transform_whose_numbers_do_not_fit_its_grid(tmp_path, old, new):
    text = warp(tmp_path / "a.tfm")
    assert old in text
    (tmp_path / "a.tfm").write_text(text.replace(old, new))
    with pytest.raises(InputError):
        displacement_from_transform(tmp_path / "a.tfm", NODES)


@pytest.mark.parametrize("at", [0, 4, 8, 12, 16])
@pytest.mark.parametrize("value", [-1, 1000, 2**30])
def test_a_matlab_transform_whose_header_does_not_fit(tmp_path, at, value):
    affine = sitk.AffineTransform(3)
    affine.SetTranslation([0.1, 0.2, 0])
    sitk.WriteTransform(affine, str(tmp_path / "a.mat"))
    found = displacement_from_transform(tmp_path / "a.mat", NODES)
    assert np.allclose(found.displacement, [0.1, 0.2, 0])
    whole = (tmp_path / "a.mat").read_bytes()
    lie = whole[:at] + struct.pack("<i", value) + whole[at + 4 :]
    (tmp_path / "a.mat").write_bytes(lie)
    with pytest.raises(InputError, match="damaged"):
        displacement_from_transform(tmp_path / "a.mat", NODES)


@pytest.mark.parametrize("share", [0.2, 0.5, 0.77, 0.95])
def test_a_cut_hdf5_transform(tmp_path, share, capfd):
    array = np.full((2, 10, 10, 3), 0.25)
    field = sitk.GetImageFromArray(array, isVector=True)
    sitk.WriteTransform(sitk.DisplacementFieldTransform(field), str(tmp_path / "a.h5"))
    whole = (tmp_path / "a.h5").read_bytes()
    (tmp_path / "a.h5").write_bytes(whole[: int(share * len(whole))])
    capfd.readouterr()
    with pytest.raises(InputError, match="transform"):
        displacement_from_transform(tmp_path / "a.h5", NODES)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("mode", ["Ascii", "Binary", "Appended"])
@pytest.mark.parametrize("packed", ["None", "ZLib", "LZ4", "LZMA"])
@pytest.mark.parametrize("claim", [0, 2, 100])
def test_texts_of_a_mesh_that_are_not_as_many_as_it_claims(tmp_path, mode, packed, claim):
    pytest.importorskip("vtkmodules")
    from elastoidentify.vtk_io import convert
    from elastoidentify.vtk_io.vtu import read_mesh
    from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridWriter

    grid = convert.mesh_to_vtk(np.eye(3), np.array([[0, 1, 2]]))
    convert.set_text(grid, "Report", "a report " * 50)
    writer = vtkXMLUnstructuredGridWriter()
    writer.SetFileName(str(tmp_path / "a.vtu"))
    writer.SetInputData(grid)
    getattr(writer, f"SetDataModeTo{mode}")()
    getattr(writer, f"SetCompressorTypeTo{packed}")()
    writer.Write()
    assert convert.get_text(read_mesh(tmp_path / "a.vtu"), "Report") == "a report " * 50
    whole = (tmp_path / "a.vtu").read_bytes()
    assert b'NumberOfTuples="1"' in whole
    lie = whole.replace(b'NumberOfTuples="1"', b'NumberOfTuples="%d"' % claim)
    (tmp_path / "a.vtu").write_bytes(lie)
    with pytest.raises(InputError, match="texts"):
        read_mesh(tmp_path / "a.vtu")


@pytest.mark.parametrize("packed", ["None", "ZLib"])
@pytest.mark.parametrize("gone", [1, 4, 7, 40])
def test_texts_of_a_mesh_that_are_shorter_than_they_claim(tmp_path, packed, gone):
    pytest.importorskip("vtkmodules")
    from elastoidentify.vtk_io import convert
    from elastoidentify.vtk_io.vtu import read_mesh
    from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridWriter

    grid = convert.mesh_to_vtk(np.eye(3), np.array([[0, 1, 2]]))
    convert.set_text(grid, "Report", "".join(str(n) for n in range(60)))
    writer = vtkXMLUnstructuredGridWriter()
    writer.SetFileName(str(tmp_path / "a.vtu"))
    writer.SetInputData(grid)
    writer.SetDataModeToBinary()
    getattr(writer, f"SetCompressorTypeTo{packed}")()
    writer.Write()
    whole = (tmp_path / "a.vtu").read_bytes()
    end = whole.index(b"\n", whole.index(b">", whole.index(b'"Report"')) + 2)
    (tmp_path / "a.vtu").write_bytes(whole[: end - 6 - gone] + whole[end - 6 :])
    with pytest.raises(InputError):
        read_mesh(tmp_path / "a.vtu")
