"""``elastoidentify``: from images to a stiffness map at a terminal.

Exit code 0: done; 2: bad input or usage, said in one line; 1: anything else. Outputs are written
whole or not at all. What a subcommand needs is imported when it runs.
"""

import argparse
import os
import sys
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from . import __version__
from .errors import Cancelled, InputError
from .report.terminal import TerminalProgress, figure

METHODS = ("auto", "sequential", "global", "regularized")
KINEMATICS = ("small-strain", "st-venant-kirchhoff", "neo-hookean")
EXTRAS = {
    "vtkmodules": "vtk",
    "SimpleITK": "registration",
    "itk": "registration",
    "matplotlib": "all",
    "skfem": "demo",
}


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command line (``sys.argv`` by default) and return its exit code."""
    argv = list(sys.argv[1:] if argv is None else argv)
    _print_anything()
    try:
        if argv[:1] == ["paraview"]:  # its arguments are ParaView's
            from .paraview.launch import main as launch

            return launch(argv[1:])
        arguments = _parser().parse_args(argv)
        arguments.command(arguments)
    except SystemExit as stop:  # of argparse: usage or --help
        return stop.code if isinstance(stop.code, int) else 2
    except InputError as error:
        return _say(str(error), 2)
    except ModuleNotFoundError as error:
        extra = EXTRAS.get((error.name or "").split(".")[0])
        if extra is None:
            raise
        return _say(f"{error.name} is missing: pip install 'elastoidentify[{extra}]'", 2)
    except (KeyboardInterrupt, Cancelled):
        return _say("cancelled, nothing was written", 1)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except Exception as error:
        if os.environ.get("ELASTOIDENTIFY_TRACEBACK"):
            raise
        return _say(
            f"unexpected {type(error).__name__}: {error} (ELASTOIDENTIFY_TRACEBACK=1 shows where)",
            1,
        )
    return 0


def _print_anything() -> None:
    """Let a terminal without Greek letters show question marks, not stop the work."""
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="replace")


def _say(message: str, code: int) -> int:
    """Print one line on standard error and return the exit code."""
    print("elastoidentify:", " ".join(message.split()), file=sys.stderr)
    return code


# ---- commands


def demo(arguments) -> None:
    """Go from a real MR slice to its stiffness map, and compare it with the truth."""
    from .examples.demo import run_demo

    run_demo(
        arguments.out,
        image=arguments.image,
        slice_index=arguments.slice,
        edge_pixels=arguments.edge_pixels,
        say=print,
    )


def phantom(arguments) -> None:
    """Make images of a pushed block whose stiffness is known."""
    from .imaging.io import output_folder, read_image
    from .imaging.phantom.planar import Inclusion, make_phantom, write_phantom
    from .imaging.phantom.texture import mni152_path, slice_of

    inclusions = [Inclusion()]
    if arguments.inclusion is not None:
        inclusions = [Inclusion(*numbers) for numbers in arguments.inclusion]
    options = {
        name: getattr(arguments, name)
        for name in (
            *("pad", "poisson", "noise", "seed", "width", "height", "pixels", "anisotropy"),
            *("tissue_young", "pad_young", "kinematics"),
        )
    }
    if arguments.push:
        options["pushes"] = arguments.push
    with output_folder(arguments.out), TerminalProgress("phantom") as progress:
        texture = None
        if arguments.image != "speckle":
            image = read_image(arguments.image or mni152_path())
            axis = None if arguments.slice_axis is None else "ijk".index(arguments.slice_axis)
            texture = slice_of(image, axis, arguments.slice)
        made = make_phantom(texture, inclusions=inclusions, progress=progress, **options)
        files = write_phantom(arguments.out, made)
    names = ", ".join(file.name for file in files)
    print(f"{len(files)} files in {arguments.out}: {names}")
    print("try them with:\n  " + run_command(made, Path(arguments.out)))


def run_command(phantom, folder: Path) -> str:
    """Return the command that identifies a phantom written to `folder`."""
    pad = phantom.label("pad")
    material = phantom.materials[pad]
    words = ["elastoidentify run", f"--rest {folder / 'rest.nrrd'}"]
    words += [f"--pushed {folder / f'pushed_{k + 1}.nrrd'}" for k in range(len(phantom.pushed))]
    words += [
        f"--segmentation {folder / 'segmentation.nrrd'}",
        f"--edge-length {12 * phantom.rest.spacing[:2].max():.3g}",
        f"--known {pad}:E={material.young:g},nu={material.poisson:g}",
        *(f"--rigid {label}" for label in phantom.rigid_labels),
        f"--unknowns young --poisson {material.poisson:g}",
        f"--kinematics {phantom.parameters['kinematics']}",
        f"-o {folder / 'map.vtu'} --picture {folder / 'map.png'} --table {folder / 'map.csv'}",
    ]
    return " ".join(words)


def mesh(arguments) -> None:
    """Mesh a segmentation."""
    _check_outputs(arguments.output)
    _write_mesh(arguments.output, _meshed(arguments, arguments.segmentation))


def register(arguments) -> None:
    """Measure the displacement of a mesh's nodes in images."""
    from .vtk_io.vtu import read_mesh

    _check_outputs(arguments.output)
    images = _images(arguments)
    grid = _registered(arguments, read_mesh(arguments.mesh), images)
    _write_mesh(arguments.output, grid)


def displacement(arguments) -> None:
    """Take the displacement of a mesh's nodes from fields, transforms or tables of points."""
    import numpy as np

    from .filters.registration import write_registration
    from .imaging.registration import sources as sources
    from .imaging.registration.registration import Registration
    from .vtk_io.convert import mesh_points, set_array
    from .vtk_io.vtu import read_mesh

    _check_outputs(arguments.output)
    if not arguments.sources:
        raise InputError("no displacement given: add --field, --transform or --points, one a trial")
    grid = read_mesh(arguments.mesh)
    points, measured = mesh_points(grid), []
    for kind, path in arguments.sources:
        if not Path(path).is_file():
            raise InputError(f"{path}: no such file")
        read = getattr(sources, f"displacement_from_{kind}")
        measured.append(read(path, points, noise=arguments.noise))
    notes = [note for one in measured for note in one.notes]
    for note in notes:
        print(f"note: {note}")
    known_noise = arguments.noise is not None
    information = np.array([one.information for one in measured]) if known_noise else ()
    displacements = np.array([one.displacement for one in measured])
    write_registration(grid, Registration(displacements, information, None, {"warnings": notes}))
    for number, one in enumerate(measured, 1):
        set_array(grid.GetPointData(), f"Covered_{number}", one.covered.astype(np.uint8))
    _write_mesh(arguments.output, grid)


def identify(arguments) -> None:
    """Identify the Lamé constants on a mesh with displacements."""
    from .vtk_io.vtu import read_mesh

    _check_outputs(arguments.output, arguments.picture, arguments.table)
    rest = _image(arguments.rest) if arguments.rest else None
    grid = _identified(arguments, read_mesh(arguments.mesh))
    _deliver(arguments, grid, rest)


def run(arguments) -> None:
    """Mesh, register and identify."""
    _check_outputs(arguments.output, arguments.picture, arguments.table)
    images = _images(arguments)
    grid = _meshed(arguments, arguments.segmentation)
    _rehearse(arguments, grid, images)
    grid = _identified(arguments, _registered(arguments, grid, images))
    _deliver(arguments, grid, images.reference)


def table2(arguments) -> None:
    """Print the source paper's table beside ours."""
    from .examples.paper import table2 as rows
    from .examples.paper import table2_text

    with TerminalProgress("table") as progress:
        lines = rows(progress=progress)
    print(table2_text(lines))


# ---- steps, each a filter without its pipeline, so that errors and Ctrl-C come through


def _image(path: str):
    from .imaging.io import read_image

    return read_image(path)


def _meshed(arguments, path: str):
    """Return the mesh of a segmentation file."""
    from .filters import SegmentationToTriangleMesh
    from .filters.direct import apply
    from .vtk_io.convert import get_text, image_to_vtk

    if not arguments.edge_length > 0:
        raise InputError(f"edge length {arguments.edge_length:g}: give a positive length")
    filter = SegmentationToTriangleMesh(
        edge_length=arguments.edge_length,
        rigid_labels=arguments.rigid,
        reaction_boxes=arguments.reaction_box,
        border_reactions=not arguments.free_border,
    )
    if arguments.slice is not None:
        axis, filter.slice_index = arguments.slice
        filter.slice_axis = axis
    with TerminalProgress("mesh") as progress:
        grid = apply(filter, image_to_vtk(_image(path), "Label"), progress=progress)
    print(f"mesh: {grid.GetNumberOfCells()} cells, {grid.GetNumberOfPoints()} nodes")
    for note in get_text(grid, "MeshNotes").splitlines():
        print(f"note: {note}")
    return grid


@dataclass
class _Images:
    """The images of a registration, as the files have them."""

    rest: object  # an Image, or None
    pushed: list
    mask: object

    @property
    def reference(self):
        """The image on which the mesh was made."""
        return self.rest or self.pushed[0]

    @property
    def trials(self) -> int:
        return len(self.pushed) - (self.rest is None)


def _images(arguments) -> _Images:
    """Read every image, and see that there is something to register with, before any work."""
    from .workers.elastix_client import find_interpreter

    if arguments.rest is None and len(arguments.pushed) < 2:
        raise InputError(
            "one image is nothing to compare: add --rest with the image at rest, or a second "
            "--pushed to measure from one push to the other"
        )
    rest, mask = (path and _image(path) for path in (arguments.rest, arguments.mask))
    images = _Images(rest, [_image(path) for path in arguments.pushed], mask)
    find_interpreter()
    return images


def _registered(arguments, grid, images: _Images):
    """Return the mesh with the displacements of every pushed image."""
    import json

    from .filters.registration import displaced
    from .vtk_io.convert import get_text

    with TerminalProgress("registration") as progress:
        grid = displaced(
            grid,
            images.rest,
            images.pushed,
            mask=images.mask,
            parameters=arguments.parameters,
            reference=arguments.reference,
            progress=progress,
        )
    report = json.loads(get_text(grid, "RegistrationReport"))
    for number, trial in enumerate(report["trials"], 1):
        name = f"trial {number}" if images.rest else f"from push 1 to push {number + 1}"
        print(
            f"{name}: similarity {trial['similarity_before']:.3f} → "
            f"{trial['similarity_after']:.3f}, forward and backward agree to "
            f"{figure(trial['disagreement_median'], 2)} pixels (median)"
        )
    if images.rest is None:
        print(
            "note: without a rest image the displacements lead from the first push to the others, "
            "which balance on their own in small strain only"
        )
    _warn(report.get("warnings", []))
    return grid


class _Fine(Exception):
    """The identification has accepted its input."""


def _rehearse(arguments, grid, images: _Images) -> None:
    """Have the identification check its input before the long registration, not after it.

    It checks everything before its first word of progress; the displacements are made up.
    """
    import numpy as np

    from .filters.registration import write_registration
    from .imaging.registration.registration import Registration
    from .vtk_io.convert import mesh_points

    def stop(*_):
        raise _Fine

    points = mesh_points(grid)
    small = (
        1e-6
        * np.ptp(points)
        * np.random.default_rng(0).standard_normal((images.trials, *points.shape))
    )
    copy = grid.NewInstance()
    copy.ShallowCopy(grid)
    write_registration(copy, Registration(small, (), None))
    with suppress(_Fine):
        _identification(arguments).execute([copy], progress=stop)


def _identified(arguments, grid):
    """Return the mesh with the result arrays."""
    from .filters.direct import apply

    with TerminalProgress("identification") as progress:
        return apply(_identification(arguments), grid, progress=progress)


def _identification(arguments):
    """Return the identification that the options ask for."""
    from .filters import LameIdentification

    return LameIdentification(
        known_materials=arguments.known,
        method=arguments.method,
        kinematics=arguments.kinematics,
        plane=arguments.plane,
        unknowns=arguments.unknowns,
        poisson_ratio=arguments.poisson,
        grouping=arguments.group,
        noise=arguments.noise or 0.0,
        refine=arguments.refine or 0,
    )


def _deliver(arguments, grid, rest) -> None:
    """Print what was found and write the files asked for."""
    rows = _report(grid, arguments.unit, arguments.length_unit)
    _write_mesh(arguments.output, grid)
    if arguments.table:
        from .report.table import write_table

        write_table(arguments.table, rows)
        print(f"wrote {arguments.table}")
    if arguments.picture:
        from .report.picture import draw

        draw(arguments.picture, grid, rest, unit=arguments.unit, length=arguments.length_unit)
        print(f"wrote {arguments.picture}")


def _report(grid, unit: str, length: str) -> list[dict]:
    """Print how it was found, and the figures per label; return those."""
    import json

    from .report.table import RESULT_ARRAYS, label_rows, table_text
    from .vtk_io.convert import get_array, get_text

    report = json.loads(get_text(grid, "IdentificationReport"))
    informed = grid.GetPointData().GetArray("DisplacementInformation_1") is not None
    for line in report_lines(report, informed and not report.get("noise_given"), length):
        print(line)
    cells = grid.GetCellData()
    if cells.GetArray("Label") is None:
        return []
    rows = label_rows({name: get_array(cells, name) for name in RESULT_ARRAYS})
    print(table_text(rows, unit))
    _warn(report.get("warnings", []))
    return rows


def report_lines(report: dict, informed: bool = False, length: str = "mm") -> list[str]:
    """Return what a person should know of an IdentificationReport, without the warnings.

    Parameters
    ----------
    report : dict
    informed : bool
        The displacements came with their information, which the noise is then a multiple of.
    length : str
        Unit of the displacements.
    """
    lines = [
        f"method: {report.get('method')}, {report.get('kinematics')}, "
        f"{_count(report.get('trials'), 'trial')}, unknowns {report.get('unknowns')} per "
        f"{report.get('grouping')}"
    ]
    if report.get("auto"):
        lines.append(f"chosen because: {report['auto']}")
    if report.get("noise_scale") is not None:
        origin = "given" if report.get("noise_given") else "estimated"
        size = (
            f"{figure(report['noise_scale'])} × what the images' information predicts"
            if informed
            else f"{figure(report['noise_scale'])} {length} per displacement component"
        )
        lines.append(f"noise: {size} ({origin})")
    if report.get("prior_weight"):
        weights = ", ".join(figure(weight) for weight in report["prior_weight"])
        lines.append(
            f"prior: weight {weights} chosen by {report.get('prior_rule')}; "
            f"{figure(report.get('effective_parameters'))} effective of "
            f"{report.get('parameters')} parameters"
        )
    if report.get("misfit") is not None:
        lines.append(f"misfit: {figure(report['misfit'])} (1: as large as the noise)")
    return lines


def _count(number: int, thing: str) -> str:
    return f"{number} {thing}" + ("" if number == 1 else "s")


def _warn(sentences: Sequence[str]) -> None:
    for sentence in sentences:
        print(f"warning: {sentence}")


def _write_mesh(path: str, grid) -> None:
    from .vtk_io.vtu import write_mesh

    write_mesh(path, grid)
    print(f"wrote {path}")


def _check_outputs(mesh: str, picture: str | None = None, table: str | None = None) -> None:
    """Refuse outputs that cannot be written, before any work is done."""
    from .imaging.io import check_writable

    suffixes = ((mesh, (".vtu",)), (picture, (".png", ".pdf", ".svg")), (table, (".csv",)))
    for path, allowed in suffixes:
        if path is None:
            continue
        if Path(path).suffix.lower() not in allowed:
            raise InputError(f"{path}: name a file that ends in {' or '.join(allowed)}")
        check_writable(path)
    if picture is not None:
        import matplotlib  # noqa: F401  a missing extra is said now


# ---- the command line


class _Parser(argparse.ArgumentParser):
    """A parser whose errors are one line."""

    def error(self, message):
        self.exit(2, f"{self.prog}: {message} (see {self.prog} --help)\n")


def _known(text: str) -> tuple[int, float, float]:
    """Parse ``LABEL:E=5000,nu=0.43``."""
    try:
        label, _, rest = text.partition(":")
        parts = dict(part.strip().split("=") for part in rest.split(","))
        parts = {name.strip().lower(): float(value) for name, value in parts.items()}
        young, poisson = parts.pop("e"), parts.pop("nu")
        if parts:
            raise ValueError
        return int(label), young, poisson
    except (ValueError, KeyError):
        raise argparse.ArgumentTypeError(
            f"{text!r} is not LABEL:E=MODULUS,nu=RATIO, as in 1:E=5000,nu=0.43"
        ) from None


def _numbers(*counts: int):
    """Return a parser of so many numbers with commas between."""

    def parse(text: str) -> tuple[float, ...]:
        try:
            numbers = tuple(float(number) for number in text.split(","))
        except ValueError:
            numbers = ()
        if len(numbers) not in counts:
            wanted = " or ".join(map(str, counts))
            raise argparse.ArgumentTypeError(f"{text!r} is not {wanted} numbers with commas")
        return numbers

    return parse


def _slice(text: str) -> tuple[str, int]:
    """Parse ``k:42``."""
    axis, _, index = text.partition(":")
    if axis not in ("i", "j", "k") or not index.isdigit():
        raise argparse.ArgumentTypeError(f"{text!r} is not AXIS:NUMBER, as in k:42")
    return axis, int(index)


def _source(kind: str):
    """Return a parser that remembers of which kind a displacement file is."""
    return lambda path: (kind, path)


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="elastoidentify",
        description="Stiffness of soft tissue from images alone. Files are in the world of ITK "
        "(LPS); lengths are in the images' unit (mm), moduli in the unit of the known material.",
    )
    parser.add_argument("--version", action="version", version=f"elastoidentify {__version__}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND", parser_class=_Parser)

    def add(command, **options):
        name, text = command.__name__, command.__doc__.splitlines()[0]
        one = commands.add_parser(name, help=text, description=text, **options)
        one.set_defaults(command=command)
        return one

    _demo_options(add(demo))
    _phantom_options(add(phantom))
    one = add(mesh)
    one.add_argument("segmentation", metavar="SEG", help="labelmap; 0 is background")
    _mesh_options(one)
    _output_option(one)
    one = add(register)
    one.add_argument("--mesh", required=True, metavar="MESH.vtu")
    _image_options(one)
    _output_option(one)
    _displacement_options(add(displacement))
    one = add(identify)
    one.add_argument("mesh", metavar="IN.vtu", help="mesh with Displacement_1, Displacement_2, …")
    one.add_argument("--rest", metavar="IMAGE", help="rest image, for the picture")
    _identification_options(one)
    one = add(run)
    one.add_argument("--segmentation", required=True, metavar="SEG", help="labelmap")
    _mesh_options(one)
    _image_options(one)
    _identification_options(one)
    add(table2)
    commands.add_parser("paraview", help="Start ParaView with the filters in place.")
    return parser


def _output_option(parser) -> None:
    parser.add_argument("-o", "--output", required=True, metavar="OUT.vtu")


def _demo_options(parser) -> None:
    parser.add_argument("--out", default="elastoidentify-demo", metavar="DIR", help="output folder")
    parser.add_argument(
        "--image", metavar="FILE", help="texture of the tissue; default: the MNI152 T1 template"
    )
    parser.add_argument("--slice", type=int, metavar="N", help="slice of it")
    parser.add_argument(
        "--edge-pixels", type=float, default=12.0, metavar="N", help="cell size (default 12)"
    )


def _phantom_options(parser) -> None:
    add = parser.add_argument
    add("--out", required=True, metavar="DIR", help="output folder")
    add("--image", metavar="FILE", help="texture: an image, or 'speckle'; default: MNI152 T1")
    add("--slice", type=int, metavar="N", help="slice of a volume (default: the middle)")
    add("--slice-axis", choices=("i", "j", "k"), help="axis across the slice (default: axial)")
    add(
        "--inclusion",
        action="append",
        type=_numbers(4),
        metavar="X,Y,RADIUS,CONTRAST",
        help="disc: centre and radius as shares of the block, stiffness over the tissue's; "
        "repeatable (default 0.55,0.6,0.15,3)",
    )
    add(
        "--push",
        action="append",
        type=_numbers(2),
        metavar="X,Y",
        help="of the indenter, right and down, as shares of the height; one per trial "
        "(default 0,0.05 and 0.035,0.035)",
    )
    add("--pad", type=float, default=0.25, help="thickness of the pad, share of the height")
    add("--tissue-young", type=float, default=3000.0, metavar="PA")
    add("--pad-young", type=float, default=5000.0, metavar="PA")
    add("--poisson", type=float, default=0.45, metavar="NU")
    add("--noise", type=float, default=0.02, help="Rician, share of the signal (default 0.02)")
    add("--seed", type=int, default=0)
    add("--width", type=float, metavar="MM", help="of the block")
    add("--height", type=float, metavar="MM", help="of the block (default: its width)")
    add("--pixels", type=int, default=208, help="across the block (default 208)")
    add("--anisotropy", type=float, default=1.0, help="height over width of a pixel")
    add("--kinematics", choices=("small-strain", "neo-hookean"), default="small-strain")


def _mesh_options(parser) -> None:
    add = parser.add_argument
    add("--edge-length", type=float, required=True, metavar="MM", help="of the cells")
    add(
        "--slice",
        type=_slice,
        metavar="AXIS:N",
        help="mesh one slice of a volume, as in k:42 (default: all of it)",
    )
    add(
        "--rigid",
        type=int,
        action="append",
        default=[],
        metavar="LABEL",
        help="a rigid body (floor, indenter): not meshed, may push where it touches; repeatable",
    )
    add(
        "--reaction-box",
        type=_numbers(4, 6),
        action="append",
        default=[],
        metavar="X0,X1,Y0,Y1[,Z0,Z1]",
        help="world box in which an outside body may push; repeatable",
    )
    add("--free-border", action="store_true", help="nothing pushes at the image's border")


def _image_options(parser) -> None:
    add = parser.add_argument
    add(
        "--rest",
        metavar="IMAGE",
        help="image at rest, or a DICOM folder; without it the first pushed image takes its place, "
        "on which the mesh must have been made then",
    )
    add(
        "--pushed",
        required=True,
        action="append",
        metavar="IMAGE",
        help="pushed image of a trial; repeatable",
    )
    add(
        "--reference",
        choices=("rest", "previous"),
        default="rest",
        help="what a pushed image is registered to: the rest image, or the image before it, for a "
        "series of ever larger pushes (default rest)",
    )
    add(
        "--mask",
        metavar="IMAGE",
        help="compare the images where it is not 0; leave room around the object",
    )
    add(
        "--parameters",
        metavar="FILE",
        action="append",
        help="elastix parameter file instead of ours, 'affine' or 'bspline'; repeatable: one map "
        "after the other",
    )


def _displacement_options(parser) -> None:
    add = parser.add_argument
    add("--mesh", required=True, metavar="MESH.vtu")
    for kind, text in (
        ("field", "image of displacement vectors"),
        ("transform", "ITK transform file, rest to pushed"),
        ("points", "CSV with the columns x,y,z,u,v,w"),
    ):
        add(
            f"--{kind}",
            dest="sources",
            action="append",
            type=_source(kind),
            metavar="FILE",
            help=f"{text}; one source per trial",
        )
    add("--noise", type=float, metavar="LENGTH", help="standard deviation of a component")
    _output_option(parser)


def _identification_options(parser) -> None:
    add = parser.add_argument
    _output_option(parser)
    add(
        "--known",
        type=_known,
        action="append",
        default=[],
        metavar="LABEL:E=5000,nu=0.43",
        help="known material of a label; repeatable",
    )
    add("--method", choices=METHODS, default="auto")
    add("--kinematics", choices=KINEMATICS, default="small-strain")
    add("--plane", choices=("strain", "stress"), default="strain")
    add("--unknowns", choices=("lambda-mu", "young"), default="lambda-mu")
    add("--poisson", type=float, metavar="NU", help="of the unknown cells, with --unknowns young")
    add("--group", choices=("cell", "label"), default="cell", help="one unknown per cell or label")
    add(
        "--noise",
        type=float,
        metavar="LENGTH",
        help="standard deviation of a displacement component (default: estimated)",
    )
    add("--refine", type=int, choices=(1, 4, 16), help="sub-cells of the fit's forward problem")
    add("--picture", metavar="OUT.png", help="draw rest image, μ, λ and uncertainty")
    add("--table", metavar="OUT.csv", help="write the figures per label")
    add("--unit", default="Pa", help="unit of the known modulus, for texts (default Pa)")
    add("--length-unit", default="mm", help="unit of lengths, for texts (default mm)")


if __name__ == "__main__":
    sys.exit(main())
