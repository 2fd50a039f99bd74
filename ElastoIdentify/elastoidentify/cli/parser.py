"""The command line's options, made from the table of options. Imports no numerics."""

import argparse
import re

from .. import __version__
from ..errors import InputError
from ..options import Choice, File, Flag, Number, Option, Picture, Rows, Table
from ..study import (
    LAWS,
    IdentificationOptions,
    MeshOptions,
    ReadOptions,
    RegistrationOptions,
    ReportOptions,
)

MESH, PICTURE, TABLE, REPORT = (".vtu",), (".png", ".pdf", ".svg"), (".csv",), (".json",)
PAGE = (".html", ".htm")
"""How output files of each kind must end."""


class Parser(argparse.ArgumentParser):
    """A parser whose errors are one line, and which takes ``-5,60,0,20`` for a value."""

    def __init__(self, *arguments, **options):
        super().__init__(*arguments, **options)
        self._negative_number_matcher = re.compile(r"^-\.?\d[\d.,eE+-]*$")

    def error(self, message):
        _, unknown, words = message.partition("unrecognized arguments: ")  # argparse's
        if unknown:
            message = (
                f"unrecognized arguments: {words}; an option for several files is said once for "
                "each"
            )
        self.exit(2, f"{self.prog}: {message} (see {self.prog} --help)\n")


# ---- from the table of options


def add_options(parser, table: type[Table], leave_out=()) -> None:
    """Declare the options of a table; only those that are said end up in the arguments."""
    groups = {group.title: group for group in parser._action_groups}
    said = {action.dest for action in parser._actions}  # two steps may share an option
    for name, option in table.options().items():
        if name in leave_out or name in said:
            continue
        if option.group not in groups:
            groups[option.group] = parser.add_argument_group(option.group)
        groups[option.group].add_argument(
            *option.flags, dest=name, default=argparse.SUPPRESS, help=_help(option), **_kind(option)
        )


def chosen(arguments, table: type[Table]) -> dict:
    """Return the options of a table that were said, by name; images are still paths."""
    return {name: getattr(arguments, name) for name in table.options() if hasattr(arguments, name)}


def _help(option: Option) -> str:
    unit = f" ({option.unit})" if option.unit else ""
    default = ""
    if option.default not in (None, "", (), option.own_choice) and not isinstance(option, Flag):
        default = f" (default {option.default})"
    several = "; repeatable" if _is_repeatable(option) else ""
    text = option.__doc__.rstrip(".")
    if isinstance(option, Flag) and option.default:
        text = f"switch off: {text[0].lower()}{text[1:]}"
    return (text + unit + several + default).replace("%", "%%")


def _is_repeatable(option: Option) -> bool:
    return isinstance(option, (Rows, File)) or getattr(option, "repeatable", False)


def _kind(option: Option) -> dict:
    """Return what argparse has to know of an option."""
    if isinstance(option, Flag):
        return {"action": "store_const", "const": not option.default}
    words = {"metavar": option.metavar or option.name.upper()}
    if isinstance(option, Choice):
        return {"choices": option.choices}
    if isinstance(option, Rows):
        words |= {"action": "append", "type": _row(option)}
    elif _is_repeatable(option):
        words |= {"action": "append"}
    elif isinstance(option, Number):
        words |= {"type": _checked(option)}
    if isinstance(option, Picture):
        words |= {"required": option.required or not (option.optional or option.repeatable)}
    return words


def _checked(option: Option):
    """Return a parser of an option's value, with an error that says what is allowed."""

    def parse(text: str):
        try:
            return option.checked(text)
        except InputError:
            raise argparse.ArgumentTypeError(f"{text!r} is not {option.wanted()}") from None

    return parse


def _row(option: Rows):
    if option.name == "known_materials":
        return parse_known
    if len(option.columns) == 1:
        return option.kinds[0]
    if option.metavar == "LABEL:LABEL":
        return parse_pair
    return parse_numbers(*option.lengths)


def parse_known(text: str) -> tuple[int, float, float]:
    """Parse ``LABEL:E=5000,nu=0.43``."""
    try:
        label, _, rest = text.partition(":")
        pairs = [part.strip().lower().split("=") for part in rest.split(",")]
        parts = {name.strip(): float(value) for name, value in pairs}
        young, poisson = parts.pop("e"), parts.pop("nu")
        if parts or len(pairs) != 2:
            raise ValueError
        return int(label), young, poisson
    except (ValueError, KeyError):
        raise argparse.ArgumentTypeError(
            f"{text!r} is not LABEL:E=MODULUS,nu=RATIO, as in 1:E=5000,nu=0.43"
        ) from None


def parse_pair(text: str) -> tuple[int, int]:
    """Parse ``1:2``."""
    first, _, second = text.partition(":")
    try:
        return int(first), int(second)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not LABEL:LABEL, as in 1:2") from None


def parse_numbers(*counts: int):
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


class _Slice(argparse.Action):
    """``--slice k:42``: two options in one."""

    def __call__(self, parser, namespace, value, option=None):
        axis, _, index = value.partition(":")
        if axis not in ("i", "j", "k") or not index.isdigit():
            parser.error(f"argument --slice: {value!r} is not AXIS:NUMBER, as in k:42")
        namespace.slice_axis, namespace.slice_index = axis, int(index)


# ---- the commands


def make_parser() -> Parser:
    """Return the parser of the whole command line."""
    from . import commands, exports, plan

    parser = Parser(
        prog="elastoidentify",
        description="Stiffness of soft tissue from images alone. Files are in the world of ITK "
        "(LPS); lengths are in the images' unit (mm), moduli in the unit of the known material.",
    )
    parser.add_argument("--version", action="version", version=f"elastoidentify {__version__}")
    subparsers = parser.add_subparsers(required=True, metavar="COMMAND", parser_class=Parser)

    def add(command):
        name, text = command.__name__.replace("_", "-"), command.__doc__.splitlines()[0]
        one = subparsers.add_parser(name, help=text, description=text)
        one.set_defaults(command=command)
        return one

    _demo(add(commands.demo))
    _phantom(add(commands.phantom))
    one = add(commands.mesh)
    one.add_argument("segmentation", metavar="SEG", help="labelmap; 0 is background")
    _mesh(one, leave_out=["segmentation"])
    add_options(one, RegistrationOptions, RegistrationOptions.options().keys() - {"rest"})
    add_options(one, ReadOptions)
    _output(one)
    one = add(commands.register)
    one.add_argument("--mesh", required=True, metavar="MESH.vtu", help="of the command mesh")
    add_options(one, RegistrationOptions)
    add_options(one, ReadOptions)
    _output(one)
    _displacement(add(commands.displacement))
    one = add(commands.identify)
    one.add_argument("mesh", metavar="IN.vtu", help="mesh with Displacement_1, Displacement_2, …")
    one.add_argument("--rest", metavar="IMAGE", help="rest image, for the picture")
    add_options(one, ReadOptions)
    _results(one)
    one = add(commands.run)
    _mesh(one)
    add_options(one, RegistrationOptions)
    add_options(one, ReadOptions)
    _results(one)
    plan.declare(add(plan.plan))
    one = add(commands.info)
    one.add_argument("map", metavar="MAP.vtu", help="a result")
    _export(add(exports.export))
    _convert(add(exports.convert))
    _to_fem(add(exports.to_fem))
    _repeatability(add(exports.repeatability))
    add(commands.table2)
    subparsers.add_parser("paraview", help="Start ParaView with the filters in place.")
    return parser


def _output(parser) -> None:
    parser.add_argument("-o", "--output", required=True, metavar="OUT.vtu", help="file to write")


def _mesh(parser, leave_out=()) -> None:
    add_options(parser, MeshOptions, leave_out)
    parser.add_argument(
        "--slice",
        action=_Slice,
        default=argparse.SUPPRESS,
        metavar="AXIS:N",
        help="--slice-axis and --slice-index in one, as in k:42",
    )


def _results(parser) -> None:
    """Declare the options of the identification, and of what comes out."""
    _output(parser)
    add_options(parser, IdentificationOptions)
    add_options(parser, ReportOptions)
    add = parser.add_argument
    add("--picture", metavar="OUT.png", help="draw rest image, μ, λ and uncertainty")
    add("--table", metavar="OUT.csv", help="write the figures per label")
    add("--report", metavar="OUT.json", help="write how it was made, all reports and warnings")
    _formats(parser)


def _formats(parser) -> None:
    """Declare what a result is written as, beside its mesh."""
    add = parser.add_argument_group("for others").add_argument
    add(
        "--dicom",
        metavar="FOLDER",
        help="write μ and its standard deviation as DICOM Parametric Maps in kPa, labels and cells "
        "that were not determined as DICOM SEG, on the rest image's grid",
    )
    add(
        "--nifti",
        metavar="PREFIX",
        help="write PREFIX_mu.nii.gz, _mu_std, _E, _E_std, _status, _label, on the rest image's "
        "grid, with JSON sidecars",
    )
    add("--html", metavar="OUT.html", help="write a page: picture, figures, warnings, provenance")


def _export(parser) -> None:
    parser.add_argument("map", metavar="MAP.vtu", help="a result")
    parser.add_argument("--rest", metavar="IMAGE", help="the rest image: maps get its grid")
    _formats(parser)
    add = parser.add_argument
    add("--quantity", choices=("Mu", "YoungModulus"), default="Mu", help="for --dicom (default Mu)")
    add("--patient-id", default="", metavar="ID", help="for --dicom, of a rest image without DICOM")
    add("--patient-name", default="", metavar="NAME", help="likewise, as in Doe^Jane")
    add_options(parser, ReadOptions)


def _convert(parser) -> None:
    add = parser.add_argument
    add("source", metavar="IN", help="whatever is read elsewhere: NRRD, NIfTI, MHA, DICOM, .mat, …")
    add("target", metavar="OUT", help="ends in .nrrd, .nii, .nii.gz or .mha")
    add(
        "--segmentation",
        dest="is_segmentation",
        action="store_true",
        help="labels are read, of DICOM SEG and RTSTRUCT too",
    )
    add("--reference", metavar="IMAGE", help="what was segmented, for the grid of an RTSTRUCT")
    add(
        "--spacing",
        type=float,
        nargs="+",
        metavar="LENGTH",
        help="size of a voxel along i, j (and k), where the file has none or a wrong one",
    )
    add_options(parser, ReadOptions)


def _to_fem(parser) -> None:
    add = parser.add_argument
    add("map", metavar="MAP.vtu", help="a result")
    add(
        "target",
        metavar="OUT",
        help="ends in .inp (Abaqus, CalculiX), .feb (FEBio), .vtu, .vtk or .msh",
    )
    add("--trial", type=int, default=1, metavar="N", help="whose push is applied (default 1)")
    add(
        "--held",
        choices=("reaction", "boundary"),
        default="reaction",
        help="nodes whose displacement is given: where an outside body may push (default), or the "
        "whole boundary",
    )
    add(
        "--fill",
        metavar="E",
        help="for cells without a value: label (the mean of their label) or a Young's modulus; "
        "without it they are refused",
    )


def _repeatability(parser) -> None:
    add = parser.add_argument
    add("results", nargs="*", metavar="RESULT", help="maps (.vtu) or tables (.csv) of one subject")
    add(
        "--subject",
        dest="subjects",
        action="append",
        nargs="+",
        metavar="RESULT",
        help="the results of one more subject, in the order of time; repeatable",
    )
    add(
        "--column",
        metavar="NAME",
        help="which figure of the table of labels (default 'Mu core', the mean of the cells that "
        "touch no other label, or 'Mu mean' where a label is too thin for it)",
    )
    add("--table", metavar="OUT.csv", help="write the figures")
    add("--picture", metavar="OUT.png", help="draw differences over means (Bland-Altman)")


def _demo(parser) -> None:
    add = parser.add_argument
    add("--out", default="elastoidentify-demo", metavar="DIR", help="output folder")
    add("--image", metavar="FILE", help="texture of the tissue; default: the MNI152 T1 template")
    add("--slice", type=int, metavar="N", help="slice of it")
    add("--edge-pixels", type=float, default=12.0, metavar="N", help="cell size (default 12)")


def _phantom(parser) -> None:
    add = parser.add_argument
    add("--out", required=True, metavar="DIR", help="output folder")
    add(
        "--image",
        metavar="FILE",
        help="texture: an image, or 'speckle'; default: MNI152 T1 of nilearn, or speckle",
    )
    add("--slice", type=int, metavar="N", help="slice of a volume (default: the middle)")
    add("--slice-axis", choices=("i", "j", "k"), help="axis across the slice (default: axial)")
    add(
        "--inclusion",
        action="append",
        type=parse_numbers(4, 5),
        metavar="X,Y[,Z],RADIUS,CONTRAST",
        help="disc, or ball with --3d: centre and radius as shares of the block, stiffness over "
        "the tissue's; repeatable (default 0.55,0.6,0.15,3; with --3d 0.5,0.5,0.4,0.2,3)",
    )
    add(
        "--push",
        action="append",
        type=parse_numbers(2, 3),
        metavar="X,Y[,Z]",
        help="of the indenter, right and down (with --3d: right, back, up), as shares of the "
        "height; one per trial (default 0,0.05 and 0.035,0.035; with --3d three of them)",
    )
    add("--3d", dest="volume", action="store_true", help="volumes with a ball instead of a slice")
    add("--slipping", action="store_true", help="the pad slides on the tissue; without --3d")
    add("--hidden", action="store_true", help="the segmentation does not show the inclusions")
    add("--pad", type=float, default=0.25, help="thickness of the pad, share of the height")
    add("--tissue-young", type=float, default=3000.0, metavar="PA", help="E (default 3000)")
    add("--pad-young", type=float, default=5000.0, metavar="PA", help="E (default 5000)")
    add("--poisson", type=float, default=0.45, metavar="NU", help="of all (default 0.45)")
    add("--noise", type=float, default=0.02, help="Rician, share of the signal (default 0.02)")
    add("--seed", type=int, default=0, help="of noise and speckle (default 0)")
    add("--width", type=float, metavar="MM", help="of the block")
    add("--height", type=float, metavar="MM", help="of the block (default: its width)")
    add("--pixels", type=int, help="across the block (default 208; with --3d 48)")
    add("--anisotropy", type=float, default=1.0, help="height over width of a pixel")
    add(
        "--kinematics",
        choices=(LAWS[0], LAWS[2]),
        default=LAWS[0],
        help="law of the push (default small-strain)",
    )


def _displacement(parser) -> None:
    add = parser.add_argument
    add("--mesh", required=True, metavar="MESH.vtu", help="of the command mesh")
    for kind, text in (
        ("field", "image of displacement vectors"),
        ("transform", "ITK transform file, rest to pushed"),
        ("points", "CSV with the columns x,y,z,u,v,w"),
    ):
        add(
            f"--{kind}",
            dest="sources",
            action="append",
            type=lambda path, kind=kind: (kind, path),
            metavar="FILE",
            help=f"{text}; one source per trial",
        )
    add("--noise", type=float, metavar="LENGTH", help="standard deviation of a component")
    _output(parser)
