"""THE table of options: everything that can be chosen on the way from images to the map.

One class per step. To add an option: declare it here, and give the step's function the parameter
of its name. Every host picks it up: command line, VTK filters, ParaView, 3D Slicer, the page of
options in the docs; Testing has one test per host that goes through the tables.
"""

import math

from .errors import InputError
from .options import Choice, File, Flag, Number, Picture, Rows, Table, Text

METHODS = ("auto", "sequential", "global", "regularized")
LAWS = ("small-strain", "st-venant-kirchhoff", "neo-hookean")


def check_material(young: float, poisson: float, where: str) -> tuple[float, float]:
    """Return E and ν as floats, or raise an InputError that names `where` they were given."""
    young, poisson = float(young), float(poisson)
    if not (math.isfinite(young) and young > 0):
        raise InputError(f"{where}: Young's modulus is {young:g}, it must be a positive number")
    if not -1 < poisson < 0.5:
        raise InputError(
            f"{where}: Poisson's ratio is {poisson:g}, it must lie between -1 and 0.5 (exclusive); "
            "for a nearly incompressible material take 0.49 or 0.495"
        )
    return young, poisson


def _check_known(label: int, young: float, poisson: float) -> None:
    check_material(young, poisson, f"known label {label}")


def _check_slip(first: int, second: int) -> None:
    if first == second:
        raise InputError(f"slip {first}:{second}: name two labels, which slide on each other")


def _boxes(row: str, doc: str, **more) -> Rows:
    return Rows(
        row,
        doc,
        ["x0", "x1", "y0", "y1", "z0", "z1"],
        lengths=[4, 6],
        unit="length",
        advanced=True,
        metavar="X0,X1,Y0,Y1[,Z0,Z1]",
        **more,
    )


def _slip(doc: str, **more) -> Rows:
    """The one option that all steps share: the mesh is split, and then no shear is passed on."""
    return Rows(
        "SlipPair",
        doc,
        ["first label", "second label"],
        kinds=[int, int],
        check_row=_check_slip,
        group="Contact",
        flags=["--slip"],
        metavar="LABEL:LABEL",
        **more,
    )


class MeshOptions(Table):
    """From a segmentation to a mesh."""

    segmentation = Picture("Labelmap; 0 is background.", group="Images", metavar="SEG")
    edge_length = Number(
        0.0,
        "Length of the cells' edges. 0: twelve times the smallest spacing of the image.",
        unit="length",
        minimum=0.0,
        group="Mesh",
        metavar="LENGTH",
        own_choice=0.0,
    )
    grading = Number(
        1.0,
        "How many times longer edges may be away from the borders of labels: 1, 2, 4 or 8. For one "
        "unknown per label; what no label shows is found by even cells.",
        minimum=1.0,
        maximum=8.0,
        group="Mesh",
        advanced=True,
        metavar="FACTOR",
    )
    slice_axis = Choice(
        "none",
        "Mesh one slice across this image axis instead of the whole volume.",
        ("none", "i", "j", "k"),
        group="Mesh",
        keyword="",
    )
    slice_index = Number(
        -1,
        "Number of that slice, from 0. -1: the middle one.",
        minimum=-1,
        kind=int,
        group="Mesh",
        keyword="",
    )
    rigid_labels = Rows(
        "RigidLabel",
        "Labels of rigid bodies (floor, indenter). They are not meshed, and may push where they "
        "touch the tissue.",
        ["label"],
        kinds=[int],
        group="Mesh",
        flags=["--rigid"],
        metavar="LABEL",
    )
    reaction_boxes = _boxes(
        "ReactionBox",
        "Boxes of the world in which an outside body may push.",
        group="Mesh",
        flags=["--reaction-box"],
    )
    sliding_labels = Rows(
        "SlidingLabel",
        "Rigid labels on which the tissue slides without friction: they push along their normal "
        "only.",
        ["label"],
        kinds=[int],
        group="Contact",
        advanced=True,
        flags=["--sliding"],
        metavar="LABEL",
    )
    sliding_boxes = _boxes(
        "SlidingBox",
        "Boxes of the world in which an outside body may push along the normal only.",
        group="Contact",
        flags=["--sliding-box"],
    )
    slip = _slip(
        "Pairs of labels that slide on each other without friction: each gets nodes of its own "
        "along their interface."
    )
    border_reactions = Flag(
        True,
        "An outside body may push at the image's border: no force balance there.",
        off_flag="--free-border",
        group="Mesh",
        advanced=True,
    )


class RegistrationOptions(Table):
    """From images to the displacements of the mesh's nodes."""

    rest = Picture(
        "Image at rest. Without it the first pushed image takes its place, on which the mesh must "
        "have been made then.",
        optional=True,
        group="Images",
        metavar="IMAGE",
    )
    pushed = Picture(
        "Pushed image of a trial.", repeatable=True, group="Images", metavar="IMAGE", required=True
    )
    mask = Picture(
        "Compare the images where it is not 0; leave room around the object.",
        optional=True,
        group="Registration",
        advanced=True,
        metavar="IMAGE",
    )
    slip = _slip(
        "Pairs of labels that slide on each other without friction: bodies that they separate are "
        "registered each by itself. The mesh must have been made with them.",
        keyword="",
    )
    reference = Choice(
        "rest",
        "What each pushed image is registered to: the rest image, or the pushed image before it, "
        "for a series of ever larger pushes.",
        ("rest", "previous"),
        group="Registration",
        advanced=True,
    )
    backward = Flag(
        True,
        "Also register from pushed to rest: takes twice the time and tells how far the "
        "displacements can be trusted.",
        off_flag="--no-backward",
        group="Registration",
        advanced=True,
    )
    correlation = Flag(
        True,
        "Correct the displacements by a step of image correlation on the mesh.",
        off_flag="--no-correlation",
        keyword="refine",
        group="Registration",
        advanced=True,
    )
    radiofrequency = Choice(
        "none",
        "The images are radiofrequency data of ultrasound, whose lines run along this image axis: "
        "elastix compares their envelopes, steps of image correlation the waves.",
        ("none", "i", "j", "k"),
        keyword="",
        group="Registration",
        advanced=True,
    )
    cache = Text(
        "",
        "Folder in which finished registrations are kept: a run that was killed and is repeated "
        "goes on where it was. Empty: none.",
        own_choice="",
        group="Registration",
        advanced=True,
        flags=["--cache", "--resume"],
        metavar="FOLDER",
    )
    workers = Number(
        0,
        "Registrations at once, each an elastix process of about 0.9 GB in a volume. 0: one per "
        "core for volumes, one for slices.",
        minimum=0,
        kind=int,
        own_choice=0,
        group="Registration",
        advanced=True,
        metavar="N",
    )
    parameter_file = File(
        "elastix parameter file instead of ours, or 'affine' or 'bspline'; several: one "
        "after the other.",
        extensions="txt",
        description="elastix parameter file",
        keyword="parameters",
        group="Registration",
        advanced=True,
        flags=["--parameters"],
        metavar="FILE",
    )


class IdentificationOptions(Table):
    """From displacements to the Lamé constants."""

    known_materials = Rows(
        "KnownMaterial",
        "Materials whose stiffness is known: label, Young's modulus (its unit is the unit of the "
        "result) and Poisson's ratio.",
        ["Label", "Young's modulus", "Poisson's ratio"],
        kinds=[int, float, float],
        check_row=_check_known,
        unique=True,
        keyword="",
        group="Materials",
        flags=["--known"],
        metavar="LABEL:E=5000,nu=0.43",
    )
    slip = _slip(
        "Pairs of labels that slide on each other without friction: only normal traction is "
        "passed on. The mesh must have been made with them."
    )
    unknowns = Choice(
        "lambda-mu",
        "What to find: both Lamé constants, which is right whatever Poisson's ratio is, or "
        "Young's modulus alone, for which Poisson's ratio must be known to about 0.01.",
        ("lambda-mu", "young"),
        group="Materials",
    )
    poisson_ratio = Number(
        None,
        "Poisson's ratio of the unknown cells where only Young's modulus is sought.",
        above=-1.0,
        below=0.5,
        needs=("unknowns", "young"),
        form_start=0.45,
        group="Materials",
        flags=["--poisson", "--poisson-ratio"],
        metavar="NU",
    )
    poisson_std = Number(
        0.0,
        "Standard deviation of that Poisson's ratio: it is then estimated together with the map, "
        "one per label (0.05 if in doubt). 0: it is exactly as given.",
        minimum=0.0,
        maximum=0.25,
        own_choice=0.0,
        needs=("unknowns", "young"),
        group="Materials",
        metavar="STD",
    )
    out_of_plane = Rows(
        "Stretch",
        "Stretch of each trial across the imaged plane, its length ratio less 1, in the trials' "
        "order, or one for all; none: plane strain. For planar meshes.",
        ["stretch"],
        group="Materials",
        advanced=True,
        metavar="STRETCH",
    )
    out_of_plane_std = Number(
        0.0,
        "Standard deviation of that stretch: it is then estimated together with the map, one per "
        "trial (0.01 if in doubt). 0: it is exactly as given.",
        minimum=0.0,
        maximum=0.1,
        own_choice=0.0,
        group="Materials",
        advanced=True,
        metavar="STD",
    )
    grouping = Choice(
        "cell",
        "One unknown material per cell, or one per label.",
        ("cell", "label"),
        group="Materials",
        flags=["--grouping", "--group"],
    )
    method = Choice(
        "auto",
        "sequential: node by node from the known cells, for clean displacements; global: all "
        "nodes at once; regularized: for measured displacements; auto: sequential, and regularized "
        "where its own error says that it cannot be trusted.",
        METHODS,
        group="Method",
    )
    kinematics = Choice(
        "small-strain",
        "Small strain for pushes of up to about two percent; the finite-strain laws for larger "
        "ones.",
        LAWS,
        group="Method",
    )
    plane = Choice(
        "strain",
        "Plane strain (thick bodies) or plane stress (thin ones; in finite strain neo-hookean with "
        "Poisson's ratio given). For planar meshes.",
        ("strain", "stress"),
        group="Method",
        advanced=True,
    )
    noise = Number(
        0.0,
        "Standard deviation of a displacement component. 0: estimated.",
        unit="length",
        minimum=0.0,
        own_choice=0.0,
        group="Method",
        advanced=True,
        metavar="LENGTH",
    )
    refine = Number(
        0,
        "Sub-cells per cell of the regularized method's forward problem: 1, 4 or 16. 0: the "
        "method's own choice.",
        minimum=0,
        maximum=16,
        kind=int,
        own_choice=0,
        group="Method",
        advanced=True,
        flags=["--refine", "--sub-cells"],
        metavar="N",
    )
    element = Choice(
        "locking-free",
        "Cells of the regularized method's forward problem: with the dilatation averaged over "
        "patches of neighbours, which is right near incompressibility, or plain linear ones.",
        ("locking-free", "linear"),
        group="Method",
        advanced=True,
    )
    reference_label = Number(
        0,
        "Label to which the ratios in the table of labels refer. 0: the largest unknown one.",
        minimum=0,
        kind=int,
        own_choice=0,
        group="Report",
        advanced=True,
        metavar="LABEL",
    )


class ReportOptions(Table):
    """How results are shown; the numbers stay as they are."""

    unit = Text(
        "Pa",
        "Unit of the known Young's moduli, and so of the map.",
        group="Report",
        keyword="",
        metavar="UNIT",
    )
    length_unit = Text(
        "mm", "Unit of lengths.", group="Report", keyword="", advanced=True, metavar="UNIT"
    )
    explore = Flag(
        False,
        "Identify anew under other assumptions, one at a time (Poisson's ratio free, slip at the "
        "pad, stretch across the plane, plane stress), and say which the displacements prefer. "
        "Takes as many times longer.",
        group="Report",
        keyword="",
    )


class ReadOptions(Table):
    """Which part of a file or folder is the image; for hosts that read files themselves."""

    series = Text(
        "",
        "Which series of a DICOM folder, by its number, description or identifier, or which array "
        "of a .mat file.",
        group="Images",
        advanced=True,
        keyword="",
        metavar="SERIES",
    )
    frame = Number(
        0,
        "Which frame of a cine, from 1. 0: files of one frame.",
        minimum=0,
        kind=int,
        own_choice=0,
        group="Images",
        advanced=True,
        keyword="",
        metavar="N",
    )


STEPS = {
    "mesh": MeshOptions,
    "register": RegistrationOptions,
    "identify": IdentificationOptions,
    "report": ReportOptions,
}
"""Step → its table, in the order of the work."""


class Identification(IdentificationOptions, ReportOptions):
    """What can be chosen where the displacements are there."""


class Study(MeshOptions, RegistrationOptions, IdentificationOptions, ReportOptions):
    """One study: images and every choice, from segmentation to report.

    ``Study(segmentation=…, rest=…, pushed=[…], known_materials={1: (5000, 0.45)}, …)``
    """

    @classmethod
    def options(cls):
        """Return all options by name, in the order of the work."""
        return {k: v for table in STEPS.values() for k, v in table.options().items()}
