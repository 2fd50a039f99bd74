"""Image files that are cut short, damaged, or say something else than their neighbours."""

import gzip
import os
import struct
import subprocess
import sys
from itertools import pairwise

import numpy as np
import pytest
from elastoidentify.errors import InputError
from elastoidentify.imaging.image import Image
from elastoidentify.imaging.io import check_outputs, check_writable, read_image, read_segmentation
from elastoidentify.imaging.io import write_image as write_ours

sitk = pytest.importorskip("SimpleITK")

WHOLE = {
    "image.nii": {},
    "image.nii.gz": {},
    "image.hdr": {"twin": "image.img"},
    "image.img": {"twin": "image.img", "cut": "image.img"},
    "image.nrrd": {"pack": True},
    "plain.nrrd": {},
    "image.nhdr": {"twin": "image.raw"},
    "image.mha": {"pack": True},
    "plain.mha": {},
    "image.mhd": {"twin": "image.raw"},
    "packed.mhd": {"twin": "packed.zraw", "pack": True},
    "image.vtk": {},
    "image.tif": {},
    "packed.tif": {"pack": True},
}


def values(shape=(4, 16, 18), dtype=np.int16):
    return np.random.default_rng(0).integers(0, 200, shape).astype(dtype)


def write(path, array, spacing=(0.5, 0.7, 2.0), pack=False):
    image = sitk.GetImageFromArray(array)
    image.SetSpacing(spacing[: array.ndim])
    sitk.WriteImage(image, str(path), pack)


@pytest.mark.parametrize("name", WHOLE)
@pytest.mark.parametrize("dtype", [np.uint8, np.int16, np.float32])
def test_a_whole_file_is_read_and_a_cut_one_is_not(tmp_path, name, dtype, capfd):
    how = WHOLE[name]
    if name.endswith("tif") and dtype == np.float32:
        dtype = np.uint16
    array = values(dtype=dtype)
    write(tmp_path / name, array, pack=how.get("pack", False))
    assert np.array_equal(read_image(tmp_path / name).array, array)
    cut = tmp_path / how.get("twin", name)
    whole = cut.read_bytes()
    capfd.readouterr()
    for share in (0.1, 0.5, 0.8, 0.99):
        cut.write_bytes(whole[: int(share * len(whole))])
        with pytest.raises(InputError, match=r"damaged|header|pair|no image") as error:
            read_image(tmp_path / name)
        assert "\n" not in str(error.value)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("name", ["flat.png", "flat.jpg", "flat.bmp", "flat.tif"])
def test_cut_pictures_are_refused(tmp_path, name):
    write(tmp_path / name, values((30, 40), np.uint8))
    assert read_image(tmp_path / name).size == (40, 30, 1)
    whole = (tmp_path / name).read_bytes()
    for share in (0.3, 0.9):
        (tmp_path / name).write_bytes(whole[: int(share * len(whole))])
        with pytest.raises(InputError, match=r"damaged|not an image"):
            read_image(tmp_path / name)


@pytest.mark.parametrize("name", ["image.nii.gz", "image.nrrd", "image.mha", "flat.png"])
def test_a_byte_that_a_checksum_shows_is_no_image(tmp_path, name):
    array = values((30, 40), np.uint8) if name == "flat.png" else values()
    write(tmp_path / name, array, pack=True)
    whole = bytearray((tmp_path / name).read_bytes())
    whole[-60] ^= 0x10
    (tmp_path / name).write_bytes(whole)
    with pytest.raises(InputError, match="damaged"):
        read_image(tmp_path / name)


@pytest.mark.parametrize("asked, other", [("x.nii.gz", "x.nii"), ("x.nii", "x.nii.gz")])
@pytest.mark.parametrize("other_type", [np.int16, np.float64, np.uint8])
def test_the_file_that_is_named_is_read_not_its_twin(tmp_path, asked, other, other_type):
    array = values()
    write(tmp_path / asked, array)
    write(tmp_path / other, values((2, 5, 6)).astype(other_type), (3.0, 3.0, 3.0))
    image = read_image(tmp_path / asked)
    assert np.array_equal(image.array, array) and np.allclose(image.spacing, [0.5, 0.7, 2])


def test_a_pair_is_read_beside_single_files_and_packed_twins(tmp_path):
    array = values()
    write(tmp_path / "x.hdr", array)
    for name in ("x.nii", "x.nii.gz"):
        write(tmp_path / name, array + 1)
    (tmp_path / "x.img.gz").write_bytes(gzip.compress((tmp_path / "x.img").read_bytes()[::-1]))
    for name in ("x.hdr", "x.img"):
        assert np.array_equal(read_image(tmp_path / name).array, array)
    (tmp_path / "x.img").unlink()
    (tmp_path / "x.img.gz").unlink()
    with pytest.raises(InputError, match="pair"):
        read_image(tmp_path / "x.hdr")


@pytest.mark.parametrize("plane", ["axial", "coronal", "sagittal"])
def test_a_slice_in_nifti_keeps_its_place_in_space(tmp_path, plane):
    rows = {"axial": [0, 1, 2], "coronal": [0, 2, 1], "sagittal": [1, 2, 0]}[plane]
    image = Image(values((1, 16, 18)), [10, -20, 30], [0.5, 0.7, 2], np.eye(3)[:, rows])
    if np.linalg.det(image.direction) < 0:
        image = Image(image.array, image.origin, image.spacing, image.direction * [1, 1, -1])
    write_ours(tmp_path / "slice.nii.gz", image)
    back = read_image(tmp_path / "slice.nii.gz")
    assert np.allclose(back.axes[:, :2], image.axes[:, :2], atol=1e-5)
    assert np.allclose(back.origin, image.origin, atol=1e-5)


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("thin", [None, 0, 1, 2])
@pytest.mark.parametrize("name", ["x.nii", "x.nii.gz", "x.hdr"])
@pytest.mark.parametrize("unit", ["mm", "micron"])
def test_nibabel_and_we_agree_where_voxels_are(tmp_path, order, thin, name, unit):
    nibabel = pytest.importorskip("nibabel")
    array = np.random.default_rng(0).integers(0, 200, (9, 8, 4)).astype(f"{order}i2")
    if thin is not None:
        array = array.take([2], axis=thin)
    affine = np.array([[-0.5, 0, 0, 10], [0, 0, 2.0, -3], [0, 0.7, 0, 5], [0, 0, 0, 1]])
    kind = nibabel.Nifti1Pair if name.endswith("hdr") else nibabel.Nifti1Image
    made = kind(array, affine, nibabel.Nifti1Header(endianness=order))
    made.header.set_xyzt_units(unit)
    made.to_filename(tmp_path / name)
    image = read_image(tmp_path / name)
    assert np.array_equal(image.array.transpose(2, 1, 0), array)
    corner = np.array(array.shape) - 1
    where = (affine @ [*corner, 1])[:3] * [-1, -1, 1] * (1e-3 if unit == "micron" else 1)
    assert np.allclose(image.index_to_world(corner[None])[0], where, rtol=1e-5)


def test_what_is_packed_is_seen_in_the_file_not_in_its_name(tmp_path):
    array = values()
    write(tmp_path / "x.nii", array)
    plain = (tmp_path / "x.nii").read_bytes()
    (tmp_path / "x.nii").write_bytes(gzip.compress(plain))
    (tmp_path / "y.nii.gz").write_bytes(plain)
    for name in ("x.nii", "y.nii.gz"):
        assert np.array_equal(read_image(tmp_path / name).array, array)


def test_the_second_nifti_format_is_refused_by_its_name(tmp_path):
    nibabel = pytest.importorskip("nibabel")
    nibabel.Nifti2Image(values(), np.eye(4)).to_filename(tmp_path / "x.nii")
    with pytest.raises(InputError, match="NIfTI-2"):
        read_image(tmp_path / "x.nii")


def nifti_with(path, **numbers):
    """Write a NIfTI file and change numbers of its header."""
    write(path, values())
    raw = bytearray(path.read_bytes())
    forms = {"sform_code": ("<h", 254), "qform_code": ("<h", 252), "srow": ("<12f", 280)}
    for name, value in numbers.items():
        form, at = forms[name]
        struct.pack_into(form, raw, at, *np.ravel(value))
    path.write_bytes(raw)
    return path


def test_a_sheared_sform_gets_advice_that_fits(tmp_path):
    sheared = [[0.5, 0.2, 0, 0], [0, 0.7, 0, 0], [0, 0, 2, 0]]
    path = nifti_with(tmp_path / "x.nii", sform_code=1, qform_code=0, srow=sheared)
    with pytest.raises(InputError, match=r"right angles.*resample") as error:
        read_image(path)
    assert "convert it to NRRD" not in str(error.value)


def test_two_placements_of_a_header_are_said(tmp_path):
    moved = [[-0.5, 0, 0, 40], [0, -0.7, 0, 0], [0, 0, 2, 0]]
    path = nifti_with(tmp_path / "x.nii", sform_code=2, qform_code=1, srow=moved)
    assert "differ by 80 voxels" in read_image(path).notes[0]


@pytest.mark.parametrize("shape", [(3, 4, 16, 18), (2, 3, 4, 16, 18), (2, 1, 4, 16, 18)])
@pytest.mark.parametrize("suffix", [".nii", ".nii.gz", ".nrrd", ".mha"])
def test_series_and_five_dimensions_are_refused_in_words_that_fit(tmp_path, shape, suffix):
    sitk.WriteImage(
        sitk.GetImageFromArray(values(shape), isVector=False), str(tmp_path / f"x{suffix}")
    )
    with pytest.raises(InputError, match=r"time step|dimensions|5-D"):
        read_image(tmp_path / f"x{suffix}")


@pytest.mark.parametrize("suffix", [".nii", ".nrrd", ".mha"])
def test_axes_of_length_one_do_not_matter(tmp_path, suffix):
    array = values((1, 1, 4, 16, 18))
    sitk.WriteImage(sitk.GetImageFromArray(array, isVector=False), str(tmp_path / f"x{suffix}"))
    assert np.array_equal(read_image(tmp_path / f"x{suffix}").array, array[0, 0])


def nrrd(path, array, header):
    lines = [
        "NRRD0005", f"type: {array.dtype}", f"dimension: {array.ndim}",
        "sizes: " + " ".join(str(n) for n in array.shape[::-1]), "endian: little",
        "encoding: raw", *header,
    ]  # fmt: skip
    path.write_bytes("\n".join([*lines, "", ""]).encode() + array.tobytes())
    return path


DIRECTIONS = "space directions: none (1,0,0) (0,1,0) (0,0,1)"


def test_a_slicer_sequence_is_called_a_series(tmp_path):
    header = ["space: left-posterior-superior", "kinds: list domain domain domain", DIRECTIONS]
    path = nrrd(tmp_path / "x.seq.nrrd", values((4, 5, 6, 3)), header)
    with pytest.raises(InputError, match="series of 3 images"):
        read_image(path)


def test_the_layers_of_a_slicer_segmentation_are_one_labelmap_with_names(tmp_path):
    layers = np.zeros((4, 5, 6, 2), np.uint8)
    layers[:2, ..., 0], layers[2:, ..., 0], layers[1:3, 2:, :, 1] = 1, 2, 1
    header = ["space: left-posterior-superior", "kinds: list domain domain domain", DIRECTIONS]
    segments = [("pad", 1, 0), ("tissue", 2, 0), ("tumour", 1, 1)]
    for number, (name, label, layer) in enumerate(segments):
        header += [
            f"Segment{number}_Name:={name}",
            f"Segment{number}_LabelValue:={label}",
            f"Segment{number}_Layer:={layer}",
        ]
    path = nrrd(tmp_path / "x.seg.nrrd", layers, header)
    image, names = read_segmentation(path)
    assert names == {1: "pad", 2: "tissue", 3: "tumour"}
    expected = layers[..., 0].astype(int)
    expected[layers[..., 1] == 1] = 3
    assert np.array_equal(image.array, expected)
    assert "numbered anew" in image.notes[0] and "overlap" in image.notes[1]
    single = nrrd(
        tmp_path / "y.seg.nrrd",
        layers[..., 0].copy(),
        ["Segment0_Name:=pad", "Segment0_LabelValue:=1"],
    )
    assert read_segmentation(single)[1] == {1: "pad"}


# ---- TIFF


def tiff(path, pages, description, resolution=None, unit=1, tiled=False):
    """Write an uncompressed TIFF of pages (rows, columns) by hand."""
    body, offsets, blocks = bytearray(b"II*\0\0\0\0\0"), [], []
    for page in pages:
        blocks.append(len(body))
        body += page.tobytes() + b"\0" * (page.nbytes % 2)
    for number, page in enumerate(pages):
        rows, columns = page.shape
        entries = {256: (3, [columns]), 257: (3, [rows]), 258: (3, [8 * page.itemsize]),
                   259: (3, [1]), 262: (3, [1]), 277: (3, [1]), 296: (3, [unit]),
                   339: (3, [{"u": 1, "i": 2, "f": 3}[page.dtype.kind]])}  # fmt: skip
        if tiled:
            entries |= {322: (3, [columns]), 323: (3, [rows])}
            entries |= {324: (4, [blocks[number]]), 325: (4, [page.nbytes])}
        else:
            entries |= {273: (4, [blocks[number]]), 278: (3, [rows]), 279: (4, [page.nbytes])}
        if description:
            entries[270] = (2, description.encode() + b"\0")
        if resolution:
            for tag, value in zip((282, 283), resolution, strict=True):
                entries[tag] = (5, [round(value * 10**6), 10**6])
        table = b""
        for tag, (kind, content) in sorted(entries.items()):
            form = {2: "s", 3: "H", 4: "I", 5: "I"}[kind]
            data = content if kind == 2 else struct.pack(f"<{len(content)}{form}", *content)
            count = len(data) if kind == 2 else len(content) // (2 if kind == 5 else 1)
            if len(data) > 4:
                place, data_at = len(body), data + b"\0" * (len(data) % 2)
                body += data_at
                data = struct.pack("<I", place)
            table += struct.pack("<HHI4s", tag, kind, count, data.ljust(4, b"\0"))
        offsets.append((len(body), len(entries)))
        body += struct.pack("<H", len(entries)) + table + b"\0\0\0\0"
    struct.pack_into("<I", body, 4, offsets[0][0])
    for (at, count), (following, _) in pairwise(offsets):
        struct.pack_into("<I", body, at + 2 + 12 * count, following)
    path.write_bytes(body)
    return path


PAGES = list(values((3, 16, 18), np.uint16))


@pytest.mark.parametrize("unit, mm", [("micron", 1e-3), ("mm", 1), ("cm", 10), ("\\u00B5m", 1e-3)])
def test_an_imagej_stack_has_its_size(tmp_path, unit, mm):
    text = f"ImageJ=1.53t\nimages=3\nslices=3\nunit={unit}\nspacing=2.5\n"
    image = read_image(tiff(tmp_path / "x.tif", PAGES, text, (4.0, 5.0)))
    assert np.array_equal(image.array, PAGES)
    assert np.allclose(image.spacing, np.array([0.25, 0.2, 2.5]) * mm)


@pytest.mark.parametrize("unit, mm", [(None, 1e-3), ("mm", 1), ("nm", 1e-6), ("µm", 1e-3)])
def test_an_ome_stack_has_its_size(tmp_path, unit, mm):
    units = "" if unit is None else "".join(f' PhysicalSize{a}Unit="{unit}"' for a in "XYZ")
    sizes = "".join(f' PhysicalSize{a}="{v}"' for a, v in zip("XYZ", (0.5, 0.25, 2), strict=True))
    counts = 'SizeX="18" SizeY="16" SizeZ="3" SizeC="1" SizeT="1"'
    text = f'<?xml version="1.0"?><OME><Image><Pixels {counts}{sizes}{units}/></Image></OME>'
    image = read_image(tiff(tmp_path / "x.ome.tif", PAGES, text))
    assert np.allclose(image.spacing, np.array([0.5, 0.25, 2]) * mm)


@pytest.mark.parametrize(
    "text, said",
    [
        ("ImageJ=1.53t\nimages=3\nframes=3\nunit=mm\n", "3 times"),
        ("ImageJ=1.53t\nimages=3\nchannels=3\nunit=mm\n", "3 channels"),
        ("ImageJ=1.53t\nimages=300\nslices=300\nunit=mm\n", "300 pictures of which 3"),
        ('<OME><Pixels SizeZ="1" SizeC="1" SizeT="3"/></OME>', "3 times"),
    ],
)
def test_stacks_of_times_or_channels_are_refused(tmp_path, text, said):
    with pytest.raises(InputError, match=said):
        read_image(tiff(tmp_path / "x.tif", PAGES, text, (4.0, 5.0)))


def test_a_picture_without_size_says_so(tmp_path):
    for text in ("", "ImageJ=1.53t\nimages=3\nslices=3\nunit=pixel\n"):
        image = read_image(tiff(tmp_path / "x.tif", PAGES, text))
        assert image.spacing[:2].tolist() == [1, 1] and "size" in image.notes[0]
    printed = tiff(tmp_path / "x.tif", PAGES, "", (72.0, 72.0), unit=2)
    assert "72 dots per inch" in read_image(printed).notes[0]


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.int16, np.float32])
def test_a_plain_tiff_has_the_values_that_were_written(tmp_path, dtype):
    pages = list(values((3, 16, 18), dtype))
    assert np.array_equal(read_image(tiff(tmp_path / "x.tif", pages, "")).array, pages)


@pytest.mark.parametrize("dtype", [np.uint16, np.int16, np.float32])
def test_tiles_that_would_be_read_as_8_bits_are_refused(tmp_path, dtype):
    pages = [values((16, 32), dtype)]
    with pytest.raises(InputError, match="tiled TIFF"):
        read_image(tiff(tmp_path / "x.tif", pages, "", tiled=True))


# ---- outputs


def test_an_output_that_is_an_input_or_another_output_is_refused(tmp_path):
    write(tmp_path / "rest.nrrd", values())
    (tmp_path / "link.nrrd").symlink_to(tmp_path / "rest.nrrd")
    (tmp_path / "series").mkdir()
    inputs = {"--rest": tmp_path / "rest.nrrd", "--pushed": [tmp_path / "series"], "--mask": None}
    check_outputs({"--output": tmp_path / "map.vtu", "--table": None}, inputs)
    same = [tmp_path / "rest.nrrd", tmp_path / "link.nrrd", tmp_path / "series/../rest.nrrd"]
    for path in same:
        with pytest.raises(InputError, match=r"--picture.*reads \(--rest\)"):
            check_outputs({"--picture": path}, inputs)
    with pytest.raises(InputError, match="folder that the command reads"):
        check_outputs({"--picture": tmp_path / "series" / "map.png"}, inputs)
    with pytest.raises(InputError, match=r"--table.*writes \(--output\)"):
        check_outputs({"--output": tmp_path / "x.vtu", "--table": tmp_path / "x.vtu"}, inputs)
    with pytest.raises(InputError, match="reads"):
        check_outputs([tmp_path / "rest.nrrd"], [tmp_path / "rest.nrrd"])
    assert sorted(p.name for p in tmp_path.iterdir()) == ["link.nrrd", "rest.nrrd", "series"]


@pytest.mark.parametrize("name", ["x" * 300, "x" * 252 + ".nrrd", "bad\0name", "ä" * 130])
def test_names_that_cannot_be_are_refused_before_the_work(tmp_path, name):
    with pytest.raises(InputError):
        check_writable(tmp_path / name)


def test_the_longest_name_can_be_written(tmp_path):
    path = tmp_path / ("x" * 250 + ".nrrd")
    check_writable(path)
    write_ours(path, Image(values()))
    assert read_image(path).size == (18, 16, 4)
    assert len(list(tmp_path.iterdir())) == 1


def test_a_full_disk_is_found_before_the_work_and_in_words(tmp_path, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("elastoidentify.imaging.io.writing._fill", full)
    with pytest.raises(InputError, match="No space left on device"):
        check_outputs({"--output": tmp_path / "map.vtu"})
    assert list(tmp_path.iterdir()) == []


def test_a_disk_that_fills_up_while_writing_is_said_in_words(tmp_path, monkeypatch):
    def half(image, path, compress):
        with open(path, "w") as part:
            part.write("half of it")
        raise RuntimeError("[nrrd] _nrrdGzWrite: failed")

    monkeypatch.setattr(sitk, "WriteImage", half)
    monkeypatch.setattr("shutil.disk_usage", lambda folder: type("Usage", (), {"free": 0}))
    with pytest.raises(InputError, match="No space left on device"):
        write_ours(tmp_path / "image.nrrd", Image(values()))
    assert list(tmp_path.iterdir()) == []


KILLED = """
import os, signal, sys
from pathlib import Path
from elastoidentify.imaging.io.writing import write_whole
def half(part):
    part.write_text("half of it")
    print(part.name, flush=True)
    if sys.argv[2] == "killed":
        os.kill(os.getpid(), signal.SIGKILL)
    sys.stdin.read()
write_whole(Path(sys.argv[1]), half)
"""


def writer(path, how):
    return subprocess.Popen(
        [sys.executable, "-c", KILLED, str(path), how],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip


@pytest.mark.skipif(os.name == "nt", reason="files that are open cannot be swept on Windows")
def test_what_a_process_left_that_was_killed_while_writing_goes_with_the_next_result(tmp_path):
    path = tmp_path / "map.nrrd"
    write_ours(path, Image(values()))
    with writer(path, "killed") as process:
        process.stdout.read()
    assert len(list(tmp_path.iterdir())) == 2
    assert read_image(path).size == (18, 16, 4)  # the old result
    write_ours(path, Image(2 * values()))
    assert [entry.name for entry in tmp_path.iterdir()] == ["map.nrrd"]


@pytest.mark.skipif(os.name == "nt", reason="files that are open cannot be swept on Windows")
def test_what_another_process_is_writing_is_left_to_it(tmp_path):
    with writer(tmp_path / "other.nrrd", "goes on") as process:
        part = process.stdout.readline().strip()
        write_ours(tmp_path / "map.nrrd", Image(values()))
        assert (tmp_path / part).is_file()
        process.stdin.close()
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["map.nrrd", "other.nrrd"]
