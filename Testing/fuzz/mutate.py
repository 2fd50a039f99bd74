"""Small files of every format that is read, and damage done to them: what the fuzzer throws.

Plain mutation from a seed: a case is its number, and can be made again from it.
"""

import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
import dicom_files

WORDS = (
    *(b"0", b"-1", b"1", b"nan", b"inf", b"1e308", b"-1e-308", b"2000000000", b"9" * 20),
    *(b"", b" ", b"\n", b"\0", b"\xff\xff\xff\xff", b"\x7f\xff", b",", b";", b'"', b"<", b">"),
)


@dataclass
class Sample:
    """One file that is read right, and how it is read."""

    kind: str  # "image", "segmentation", "mesh", "field", "transform", "points"
    name: str
    files: dict[str, bytes]  # name → content; the first is the one to damage
    checked: bool  # a length or checksum shows a byte that is missing at its end


def samples(folder: Path) -> list[Sample]:
    """Return the files, made in `folder`."""
    made = []

    def add(kind: str, write: Callable[[Path], object], *names: str, checked: bool = True):
        for name in names:
            write(folder / name)
        files = {name: (folder / name).read_bytes() for name in names}
        made.append(Sample(kind, names[0], files, checked))

    _images(folder, add)
    _dicom(folder, add)
    _displacements(folder, add)
    _meshes(folder, add)
    return made


def _images(folder: Path, add) -> None:
    import SimpleITK as sitk

    values = np.random.default_rng(0).integers(1, 200, (3, 8, 9)).astype(np.int16)

    def write(array, pack):
        image = sitk.GetImageFromArray(array)
        image.SetSpacing((0.5, 0.7, 2.0)[: array.ndim])
        return lambda path: sitk.WriteImage(image, str(path), pack)

    for name in ("a.nii", "a.nrrd", "a.mha", "a.vtk", "a.tif"):
        add("image", write(values, False), name)
    for name in ("p.nii.gz", "p.nrrd", "p.mha"):
        add("image", write(values, True), name)
    for name, twin in (("b.hdr", "b.img"), ("b.nhdr", "b.raw"), ("b.mhd", "b.raw2")):
        image = sitk.GetImageFromArray(values)
        sitk.WriteImage(image, str(folder / name))
        twin = twin.removesuffix("2")
        both = {one: (folder / one).read_bytes() for one in (name, twin)}
        made_of(add, "image", folder, both)
    for name in ("f.png", "f.bmp", "f.jpg"):
        add("image", write(values[0].astype(np.uint8), False), name)
    labels = (values > 100).astype(np.uint8) + 1
    add("segmentation", write(labels, True), "s.nrrd")


def made_of(add, kind: str, folder: Path, files: dict[str, bytes]) -> None:
    """Add a sample of several files, each of them once the one to damage."""
    names = list(files)
    for first in names:
        order = [first, *(name for name in names if name != first)]
        add(kind, lambda path: path.write_bytes(files[path.name]), *order)


def _dicom(folder: Path, add) -> None:
    values = dicom_files.volume(3, 8, 10)
    dicom_files.write_series(folder / "series", values, step=1.1)
    one = (folder / "series" / "001.dcm").read_bytes()
    add("image", lambda path: path.write_bytes(one), "one.dcm")
    add("image", lambda path: dicom_files.enhanced(path, values), "enhanced.dcm")
    labels = np.zeros((3, 8, 10), np.uint8)
    labels[:2, 1:5, 2:9] = 1
    for kind in ("BINARY", "FRACTIONAL"):
        name = f"seg-{kind.lower()}.dcm"
        add(
            "segmentation",
            lambda path, kind=kind: dicom_files.segmentation(path, labels, {1: "a"}, kind=kind),
            name,
        )
    square = np.array([[0, 0, 0], [9, 0, 0], [9, 9, 0], [0, 9, 0.0]])
    contours = [(1, square + np.array([0, 0, 2.0 * k])) for k in range(3)]
    add(
        "segmentation",
        lambda path: dicom_files.structures(path, contours, {1: "a"}),
        "contours.dcm",
        checked=False,
    )


def _displacements(folder: Path, add) -> None:
    import SimpleITK as sitk

    k, j, i = np.mgrid[:3, :12, :12].astype(float)
    u = np.stack([0.02 * i + 0.1, 0.03 * j, 0 * k], -1)
    image = sitk.GetImageFromArray(u, isVector=True)
    for name in ("u.nrrd", "u.nii", "u.mha"):
        add("field", lambda path: sitk.WriteImage(image, str(path)), name)
    warp = sitk.DisplacementFieldTransform(sitk.Image(image))
    affine = sitk.AffineTransform(3)
    affine.SetMatrix([1, 0, 0, 0, 0.96, 0, 0, 0, 1])
    both = sitk.CompositeTransform(3)
    both.AddTransform(affine)
    both.AddTransform(warp)
    for name in ("t.h5", "t.tfm"):
        add("transform", lambda path: sitk.WriteTransform(both, str(path)), name, checked=False)
    add(
        "transform",
        lambda path: sitk.WriteTransform(affine, str(path)),
        "affine.mat",
        checked=False,
    )
    rows = np.array([[x, y, 0, 0.02 * x, -0.01 * y, 0] for x in (0, 6, 12) for y in (0, 6, 12.0)])
    text = "x,y,z,u,v,w\n" + "\n".join(",".join(f"{v:g}" for v in row) for row in rows) + "\n"
    add("points", lambda path: path.write_text(text), "t.csv", checked=False)


def block():
    """Return a square mesh with labels, a displacement and a report."""
    from elastoidentify.vtk_io import convert

    y, x = np.mgrid[:4, :4] * 3.0 + 1
    points = np.column_stack([x.ravel(), y.ravel(), np.zeros(16)])
    a = (np.arange(3)[:, None] * 4 + np.arange(3)).ravel()
    cells = np.vstack([np.column_stack([a, a + 1, a + 4]), np.column_stack([a + 1, a + 5, a + 4])])
    grid = convert.mesh_to_vtk(points, cells)
    labels = np.where(points[cells].mean(axis=1)[:, 1] > 5, 1, 2)
    convert.set_array(grid.GetCellData(), "Label", labels.astype(np.int32))
    convert.set_array(grid.GetPointData(), "Displacement_1", 0.02 * points + 0.1)
    convert.set_text(grid, "IdentificationReport", '{"method": "global"}')
    return grid


def _meshes(folder: Path, add) -> None:
    from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridWriter

    def write(mode: str, packed: str):
        writer = vtkXMLUnstructuredGridWriter()
        writer.SetInputData(block())
        getattr(writer, f"SetDataModeTo{mode.removesuffix('Raw')}")()
        if mode == "AppendedRaw":
            writer.EncodeAppendedDataOff()
        getattr(writer, f"SetCompressorTypeTo{packed}")()

        def to(path: Path) -> None:
            writer.SetFileName(str(path))
            writer.Write()

        return to

    for mode in ("Ascii", "Binary", "Appended", "AppendedRaw"):
        for packed in ("None", "ZLib", "LZ4", "LZMA"):
            if mode == "Ascii" and packed != "None":
                continue
            add("mesh", write(mode, packed), f"{mode}-{packed}.vtu")


def damage(content: bytes, random: np.random.Generator) -> tuple[bytes, str]:
    """Return the content with one kind of damage, and which."""
    kinds = ("cut", "flip", "byte", "drop", "twice", "zero", "word", "number", "swap")
    kind = kinds[random.integers(len(kinds))]
    raw, n = bytearray(content), len(content)
    # headers are where damage matters: half of it goes to the first bytes
    reach = min(n, 512) if random.random() < 0.5 else n
    at = int(random.integers(max(reach, 1)))
    length = int(random.integers(1, 33))
    if kind == "cut":
        return content[: int(random.integers(n))], kind
    if kind == "flip":
        for _ in range(int(random.integers(1, 5))):
            raw[int(random.integers(reach))] ^= 1 << int(random.integers(8))
    elif kind == "byte":
        raw[at] = int(random.integers(256))
    elif kind == "drop":
        del raw[at : at + length]
    elif kind == "twice":
        raw[at:at] = raw[at : at + length]
    elif kind == "zero":
        raw[at : at + length] = bytes(len(raw[at : at + length]))
    elif kind == "word":
        word = WORDS[random.integers(len(WORDS))]
        raw[at : at + len(word)] = word
    elif kind == "number":
        digits = [k for k in range(reach) if chr(raw[k]).isdigit()]
        if digits:
            k = digits[random.integers(len(digits))]
            raw[k : k + 1] = (b"9", b"-", b"0", b"99999999", b".")[random.integers(5)]
    else:
        other = int(random.integers(n))
        raw[at], raw[other] = raw[other], raw[at]
    return bytes(raw), kind
