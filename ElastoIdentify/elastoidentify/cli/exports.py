"""Commands that bring results out of the box: maps for others, and figures over several maps."""

from pathlib import Path

from ..errors import InputError
from ..study import ReadOptions
from . import parser as options

FORMATS = ("dicom", "nifti", "html")


# ---- commands


def export(arguments) -> None:
    """Write a result as DICOM, as NIfTI or as a page, on the rest image's grid."""
    from ..vtk_io.arrays import read_report
    from ..vtk_io.vtu import read_mesh
    from .commands import _image

    if not any(getattr(arguments, name) for name in FORMATS):
        raise InputError("nothing to write: add --dicom FOLDER, --nifti PREFIX or --html FILE")
    grid = read_mesh(arguments.map)
    unit = (read_report(grid, "provenance") or {}).get("unit")
    check(arguments, arguments.rest, {"map": arguments.map, "--rest": arguments.rest}, unit)
    rest = _image(arguments, arguments.rest) if arguments.rest else None
    deliver(arguments, grid, rest, arguments.rest)


def convert(arguments) -> None:
    """Write an image or a segmentation in another format."""
    from ..export.convert import convert as convert_file

    image, names = convert_file(
        arguments.source,
        arguments.target,
        segmentation=arguments.is_segmentation,
        reference=arguments.reference,
        series=_read_option(arguments, "series"),
        frame=_read_option(arguments, "frame"),
        spacing=arguments.spacing,
    )
    for note in image.notes:
        print(f"note: {arguments.source}: {note}")
    for label, name in sorted(names.items()):
        print(f"label {label}: {name}")
    print(f"wrote {arguments.target}")


def to_fem(arguments) -> None:
    """Write a result's moduli and pushes for a finite element program."""
    from ..export.cell_map import read_cell_map
    from ..export.fem import write_fem
    from ..imaging.io import check_outputs

    check_outputs({"OUT": arguments.target}, {"map": arguments.map})
    notes = write_fem(
        arguments.target,
        read_cell_map(arguments.map),
        trial=arguments.trial,
        held=arguments.held,
        fill=arguments.fill,
    )
    for note in notes:
        print(f"note: {note}")
    print(f"wrote {arguments.target}")


def repeatability(arguments) -> None:
    """Tell how much the figures per label change when the same subject is measured again."""
    from ..export import repeatability as figures
    from .commands import _check_outputs

    subjects = ([arguments.results] if arguments.results else []) + (arguments.subjects or [])
    if not subjects:
        raise InputError(
            "no results given: name two or more of one subject, or --subject A1.csv A2.csv for each"
        )
    outputs = {
        "--table": (arguments.table, options.TABLE),
        "--picture": (arguments.picture, options.PICTURE),
    }
    _check_outputs(outputs, {"results": [path for one in subjects for path in one]})
    tables = [[figures.read_rows(path) for path in one] for one in subjects]
    column = arguments.column or figures.best_column(tables)
    found, values, notes = figures.repeatability_by_label(tables, column)
    print(figures.repeatability_text(found))
    for note in notes:
        print(f"note: {note}")
    if arguments.table:
        figures.write_repeatability(arguments.table, found)
        print(f"wrote {arguments.table}")
    if arguments.picture:
        figures.draw_bland_altman(arguments.picture, found, values)
        print(f"wrote {arguments.picture}")


def _read_option(arguments, name: str):
    return options.chosen(arguments, ReadOptions).get(name) or None


# ---- what a result is written as, beside its mesh


def check(arguments, rest: str | None, inputs, unit: str | None) -> None:
    """Refuse exports that could not be written, before any work is done.

    Parameters
    ----------
    arguments : has dicom, nifti, html
    rest : path or None
        The image whose grid the maps get.
    inputs : {name: path or paths}
        None of which may be overwritten.
    unit : str or None
        Of the moduli.
    """
    from ..imaging.io import check_outputs

    if (arguments.dicom or arguments.nifti) and rest is None:
        raise InputError("--dicom and --nifti need the grid of the rest image: add --rest IMAGE")
    if arguments.dicom:
        import highdicom  # noqa: F401  a missing extra is said now

        from ..export.cell_map import kilopascal

        kilopascal(unit or "Pa")
        folder = Path(arguments.dicom)
        if folder.exists() and not folder.is_dir():
            raise InputError(f"{folder}: is a file; name a folder for --dicom")
        first = folder / "mu.dcm" if folder.is_dir() else folder
        check_outputs({"--dicom": first}, inputs)
    if arguments.nifti:
        from ..export.nifti import nifti_files

        files = nifti_files(arguments.nifti)
        check_outputs({f"--nifti ({file.name})": file for file in files}, inputs)
    if arguments.html:
        if Path(arguments.html).suffix.lower() not in options.PAGE:
            raise InputError(f"{arguments.html}: name a file that ends in .html")
        check_outputs({"--html": arguments.html}, inputs)
        import matplotlib  # noqa: F401  a missing extra is said now


def deliver(arguments, grid, rest, source: str | None) -> None:
    """Write a mesh with results as asked for.

    Parameters
    ----------
    arguments : has dicom, nifti, html
    grid : vtkUnstructuredGrid
    rest : Image or None
    source : path or None
        What the image was read from; maps as DICOM refer to it where it is DICOM.
    """
    if not any(getattr(arguments, name) for name in FORMATS):
        return
    from ..export.cell_map import from_grid

    result = from_grid(grid)
    if arguments.nifti:
        from ..export.nifti import write_nifti

        _wrote(write_nifti(arguments.nifti, result, rest))
    if arguments.html:
        from ..export.html import write_html
        from ..vtk_io.arrays import read_report

        before = read_report(grid, "registration").get("warnings", [])
        informed = grid.GetPointData().GetArray("DisplacementInformation_1") is not None
        write_html(arguments.html, result, rest, warnings=before, informed=informed)
        print(f"wrote {arguments.html}")
    if arguments.dicom:
        _wrote(_write_dicom(arguments, result, rest, source))


def _write_dicom(arguments, result, rest, source):
    from ..export.delivery import write_dicom_of
    from ..export.dicom import Person

    person = Person(getattr(arguments, "patient_id", ""), getattr(arguments, "patient_name", ""))
    quantity = getattr(arguments, "quantity", "Mu")
    files, notes = write_dicom_of(arguments.dicom, result, rest, source, quantity, person)
    for note in notes:
        print(f"note: {note}")
    return files


def _wrote(files) -> None:
    names = ", ".join(file.name for file in files)
    print(f"wrote {len(files)} files in {files[0].parent}: {names}")
