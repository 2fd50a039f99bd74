"""What each subcommand does: files in, the pipeline or one of its steps, files out."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from ..errors import InputError
from ..options import Picture, Table, only_with
from ..report.terminal import TerminalProgress, figure
from ..study import (
    Identification,
    IdentificationOptions,
    ReadOptions,
    RegistrationOptions,
    ReportOptions,
    Study,
)
from . import exports
from . import parser as options


def demo(arguments) -> None:
    """Go from a real MR slice to its stiffness map, and compare it with the truth."""
    from ..examples.demo import run_demo

    run_demo(
        arguments.out,
        image=arguments.image,
        slice_index=arguments.slice,
        edge_pixels=arguments.edge_pixels,
        say=print,
    )


def phantom(arguments) -> None:
    """Make images of a pushed block whose stiffness is known."""
    from ..imaging.io import output_folder
    from ..imaging.phantom import write_phantom

    with output_folder(arguments.out), TerminalProgress("phantom") as progress:
        make = _volume_phantom if arguments.volume else _planar_phantom
        made = make(arguments, progress)
        files = write_phantom(arguments.out, made)
    names = ", ".join(file.name for file in files)
    print(f"{len(files)} files in {arguments.out}: {names}")
    print("try them with:\n  " + run_command(made, Path(arguments.out)))


PHANTOM = (
    *("pad", "poisson", "noise", "seed", "width", "height", "anisotropy", "tissue_young"),
    *("pad_young", "kinematics"),
)


def _phantom_options(arguments, dimension: int) -> dict:
    """Return what both kinds of phantom take; rows of numbers must be of its dimension."""
    wanted = {name: getattr(arguments, name) for name in PHANTOM}
    for name, length in (("inclusion", dimension + 2), ("push", dimension)):
        wrong = [row for row in getattr(arguments, name) or () if len(row) != length]
        if wrong:
            row = ",".join(f"{number:g}" for number in wrong[0])
            kind = "without" if dimension == 2 else "with"
            raise InputError(f"--{name} {row}: {kind} --3d it takes {length} numbers")
    if arguments.push:
        wanted["pushes"] = arguments.push
    return wanted


def _planar_phantom(arguments, progress):
    from ..imaging.io import read_image
    from ..imaging.phantom import Inclusion, make_phantom
    from ..imaging.phantom.texture import slice_of

    wanted = _phantom_options(arguments, 2)
    wanted |= {"pixels": arguments.pixels or 208, "slip": arguments.slipping}
    if arguments.hidden:
        raise InputError("--hidden is for --3d: in a slice, leave the inclusion's label out")
    inclusions = [Inclusion()]
    if arguments.inclusion is not None:
        inclusions = [Inclusion(*numbers) for numbers in arguments.inclusion]
    source, texture = _texture(arguments), None
    if source is not None:
        axis = None if arguments.slice_axis is None else "ijk".index(arguments.slice_axis)
        texture = slice_of(read_image(source), axis, arguments.slice)
    return make_phantom(texture, inclusions=inclusions, progress=progress, **wanted)


def _volume_phantom(arguments, progress):
    from ..imaging.io import read_image
    from ..imaging.phantom import Ball, make_phantom_volume

    if arguments.slipping:
        raise InputError("--slipping is for slices: leave out --3d")
    wanted = _phantom_options(arguments, 3)
    wanted |= {"voxels": arguments.pixels or 48, "hidden": arguments.hidden}
    if arguments.inclusion is not None:
        wanted["balls"] = [Ball(*numbers) for numbers in arguments.inclusion]
    source = _texture(arguments)
    texture = None if source is None else read_image(source)
    return make_phantom_volume(texture, progress=progress, **wanted)


def _texture(arguments):
    """Return the image that textures the tissue; None: speckle, where nilearn has no template."""
    from ..imaging.phantom.texture import mni152_path

    if arguments.image is not None:
        return None if arguments.image == "speckle" else arguments.image
    try:
        return mni152_path()
    except InputError:
        if arguments.slice is not None:
            raise
        print("note: without nilearn there is no MR template: the texture is speckle")
        return None


def run_command(phantom, folder: Path) -> str:
    """Return the command that identifies a phantom written to `folder`."""
    pad = phantom.label("pad")
    material = phantom.materials[pad]
    words = ["elastoidentify run", f"--rest {folder / 'rest.nrrd'}"]
    words += [f"--pushed {folder / f'pushed_{k + 1}.nrrd'}" for k in range(len(phantom.pushed))]
    words += [
        f"--segmentation {folder / 'segmentation.nrrd'}",
        f"--edge-length {_edge(phantom):.3g}",
        f"--known {pad}:E={material.young:g},nu={material.poisson:g}",
        *(f"--rigid {label}" for label in phantom.rigid_labels),
        *(["--slip 1:2"] if phantom.parameters.get("slip") else []),
        f"--kinematics {phantom.parameters['kinematics']}",
        f"-o {folder / 'map.vtu'} --picture {folder / 'map.png'} --table {folder / 'map.csv'}",
    ]
    return " ".join(words)


def _edge(phantom) -> float:
    """Return a sensible edge length: twelve pixels of a slice, six voxels of a volume."""
    return (12 if phantom.rest.planar_axis is not None else 6) * phantom.rest.spacing[:2].max()


def mesh(arguments) -> None:
    """Mesh a segmentation."""
    from ..pipeline import make_mesh
    from ..vtk_io.arrays import write_label_mesh

    _check_outputs({"--output": (arguments.output, options.MESH)}, _paths(arguments, Study))
    files = _read(arguments, Study)
    with TerminalProgress("mesh") as progress:
        made = make_mesh(files.chosen, progress)
    _say_mesh(made)
    _write_mesh(arguments.output, write_label_mesh(made))


def register(arguments) -> None:
    """Measure the displacement of a mesh's nodes in images."""
    from ..pipeline import check_images
    from ..vtk_io.arrays import read_report
    from ..vtk_io.steps import displaced
    from ..vtk_io.vtu import read_mesh
    from ..workers.elastix_client import find_interpreter

    _check_outputs(
        {"--output": (arguments.output, options.MESH)},
        _paths(arguments, RegistrationOptions) | {"--mesh": arguments.mesh},
    )
    chosen = _read(arguments, RegistrationOptions).chosen
    check_images(chosen)
    find_interpreter()
    grid = read_mesh(arguments.mesh)
    with TerminalProgress("registration") as progress:
        grid = displaced(grid, chosen, progress)
    _say_registration(read_report(grid, "registration"), chosen.rest is not None)
    _write_mesh(arguments.output, grid)


def displacement(arguments) -> None:
    """Take the displacement of a mesh's nodes from fields, transforms or tables of points."""
    import numpy as np

    from ..imaging.registration import Registration, sources
    from ..vtk_io.arrays import write_registration
    from ..vtk_io.convert import mesh_points, set_array
    from ..vtk_io.vtu import read_mesh

    _check_outputs(
        {"--output": (arguments.output, options.MESH)},
        {"--mesh": arguments.mesh, "displacements": [path for _, path in arguments.sources or ()]},
    )
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
    from ..provenance import fingerprint
    from ..vtk_io.steps import identified
    from ..vtk_io.vtu import read_mesh

    _check_result_outputs(arguments, {"mesh": arguments.mesh, "--rest": arguments.rest})
    rest = _image(arguments, arguments.rest) if arguments.rest else None
    grid = read_mesh(arguments.mesh)
    chosen = Identification(**_identification(arguments))
    inputs = {"mesh": fingerprint(arguments.mesh)}
    with TerminalProgress("identification") as progress:
        grid = identified(grid, chosen, inputs=inputs, progress=progress)
    _deliver(arguments, chosen, grid, rest)


def run(arguments) -> None:
    """Mesh, register and identify."""
    from .. import pipeline
    from ..vtk_io.arrays import write_outcome
    from ..workers.elastix_client import find_interpreter

    _check_result_outputs(arguments, _paths(arguments, Study))
    files = _read(arguments, Study)
    study = files.chosen
    find_interpreter()
    with TerminalProgress("run") as progress:
        outcome = pipeline.run(study, names=files.names, inputs=files.inputs, progress=progress)
    _say_mesh(outcome.mesh)
    _say_registration(outcome.registration.report, study.rest is not None)
    rest = study.rest if study.rest is not None else study.pushed[0]
    _deliver(arguments, study, write_outcome(outcome), rest)


def info(arguments) -> None:
    """Print how a result was made, and what was found."""
    from ..report.sentences import provenance_lines
    from ..vtk_io.arrays import read_report
    from ..vtk_io.vtu import read_mesh

    grid = read_mesh(arguments.map)
    made = read_report(grid, "provenance")
    if not made:
        raise InputError(f"{arguments.map}: it does not say how it was made; no result of ours?")
    for line in provenance_lines(made):
        print(line)
    _say_result(grid, made)


def table2(arguments) -> None:
    """Print the source paper's table beside ours."""
    from ..examples.paper import table2 as rows
    from ..examples.paper import table2_text

    with TerminalProgress("table") as progress:
        lines = rows(progress=progress)
    print(table2_text(lines))


# ---- files in


def _paths(arguments, table: type[Table]) -> dict:
    """Return {option: path or paths} of all images that were named."""
    said = options.chosen(arguments, table)
    return {f"--{k}": v for k, v in said.items() if isinstance(table.options()[k], Picture)}


@dataclass
class _Files:
    """The options of a step with its images read, and what is to be told of the files."""

    chosen: Table
    inputs: dict  # name → fingerprint
    names: dict  # label → name, of a segmentation that has names


def _read(arguments, table: type[Table]) -> _Files:
    """Read every image that was named."""
    from ..provenance import fingerprint

    said, inputs, names = _said(arguments, table), {}, {}
    values = {k: v for k, v in said.items() if not isinstance(table.options()[k], Picture)}
    for name in said.keys() - values.keys():
        paths = said[name]
        if isinstance(paths, list):
            values[name] = [_image(arguments, path) for path in paths]
            inputs[name] = [fingerprint(path) for path in paths]
        elif name != "segmentation":
            values[name], inputs[name] = _image(arguments, paths), fingerprint(paths)
    if "segmentation" in said:
        from ..imaging.io import read_segmentation

        reference = values.get("rest") or next(iter(values.get("pushed", ())), None)
        values["segmentation"], names = read_segmentation(
            said["segmentation"], reference=reference, **_series(arguments)
        )
        _say_notes(said["segmentation"], values["segmentation"])
        inputs["segmentation"] = fingerprint(said["segmentation"])
    return _Files(table(**values), inputs, names)


def _image(arguments, path: str):
    from ..imaging.io import read_image

    frame = options.chosen(arguments, ReadOptions).get("frame") or None
    image = read_image(path, frame=frame, **_series(arguments))
    _say_notes(path, image)
    return image


def _series(arguments) -> dict:
    return {"series": options.chosen(arguments, ReadOptions).get("series") or None}


def _say_notes(path: str, image) -> None:
    for note in image.notes:
        print(f"note: {path}: {note}")


def _identification(arguments) -> dict:
    """Return what was said of identification and report, by name."""
    return _said(arguments, IdentificationOptions) | _said(arguments, ReportOptions)


def _said(arguments, table: type[Table]) -> dict:
    """Return the options of a table that were said; one that says nothing alone is refused."""
    said = options.chosen(arguments, table)
    for name in said:
        needs = table.options()[name].needs
        if needs and said.get(needs[0], table.options()[needs[0]].default) != needs[1]:
            flag, other = (table.options()[one].flags[0] for one in (name, needs[0]))
            raise InputError(f"{only_with(flag, other, needs[1])}: add it")
    return said


# ---- files out


def _check_outputs(outputs: Mapping[str, tuple[str, tuple[str, ...]]], inputs) -> None:
    """Refuse outputs that cannot be written, before any work is done.

    Parameters
    ----------
    outputs : {option: (path or None, allowed suffixes)}
    inputs : {option: path or paths}
        None of which may be overwritten.
    """
    from ..imaging.io import check_outputs

    named = {name: path for name, (path, _) in outputs.items() if path}
    for name, path in named.items():
        allowed = outputs[name][1]
        if Path(path).suffix.lower() not in allowed:
            raise InputError(f"{path}: name a file that ends in {' or '.join(allowed)}")
    check_outputs(named, inputs)


def _check_result_outputs(arguments, inputs) -> None:
    outputs = {
        "--output": (arguments.output, options.MESH),
        "--picture": (arguments.picture, options.PICTURE),
        "--table": (arguments.table, options.TABLE),
        "--report": (arguments.report, options.REPORT),
    }
    if getattr(arguments, "explore", False):
        outputs["--explore, picture"] = (_explored(arguments.picture), options.PICTURE)
        outputs["--explore, table"] = (_explored(arguments.table), options.TABLE)
    _check_outputs(outputs, inputs)
    if arguments.picture is not None:
        import matplotlib  # noqa: F401  a missing extra is said now
    exports.check(arguments, _rest_path(arguments), inputs, getattr(arguments, "unit", None))


def _explored(path: str | None) -> str | None:
    """Return the file beside another one that compares the assumptions tried."""
    return path and str(Path(path).with_stem(f"{Path(path).stem}_explored"))


def _rest_path(arguments) -> str | None:
    """Return the file of the image on whose grid maps are written."""
    pushed = getattr(arguments, "pushed", None) or [None]
    return getattr(arguments, "rest", None) or pushed[0]


def _deliver(arguments, study, grid, rest) -> None:
    """Print what was found and write the files asked for."""
    from ..vtk_io.arrays import REPORTS, read_report

    made = read_report(grid, "provenance")
    rows, explored = _say_result(grid, made)
    _write_mesh(arguments.output, grid)
    if arguments.table:
        from ..report.table import write_table

        write_table(arguments.table, rows, made)
        print(f"wrote {arguments.table}")
        if explored:
            write_table(_explored(arguments.table), explored["rows"], made)
            print(f"wrote {_explored(arguments.table)}")
    if arguments.picture:
        from ..vtk_io.picture import draw, draw_explored

        units = {"unit": study.unit, "length": study.length_unit}
        draw(arguments.picture, grid, rest, **units)
        print(f"wrote {arguments.picture}")
        if explored:
            draw_explored(_explored(arguments.picture), grid, **units)
            print(f"wrote {_explored(arguments.picture)}")
    if arguments.report:
        from ..imaging.io import write_whole

        text = json.dumps({about: read_report(grid, about) for about in REPORTS}, indent=1)
        write_whole(Path(arguments.report), lambda part: part.write_text(text, encoding="utf-8"))
        print(f"wrote {arguments.report}")
    exports.deliver(arguments, grid, rest, _rest_path(arguments))


def _write_mesh(path: str, grid) -> None:
    from ..vtk_io.vtu import write_mesh

    write_mesh(path, grid)
    print(f"wrote {path}")


# ---- lines for people


def _say_mesh(made) -> None:
    print(f"mesh: {len(made.cells)} cells, {len(made.points)} nodes")
    for note in made.notes:
        print(f"note: {note}")


def _say_registration(report: dict, has_rest: bool) -> None:
    for number, trial in enumerate(report["trials"], 1):
        name = f"trial {number}" if has_rest else f"from push 1 to push {number + 1}"
        back = trial.get("disagreement_median")
        agree = (
            ""
            if back is None
            else (f", forward and backward agree to {figure(back, 2)} pixels (median)")
        )
        print(
            f"{name}: similarity {trial['similarity_before']:.3f} → "
            f"{trial['similarity_after']:.3f}{agree}"
        )
    if not has_rest:
        print(
            "note: without a rest image the displacements lead from the first push to the others, "
            "which balance on their own in small strain only"
        )
    _warn(report.get("warnings", []))


def _say_result(grid, made: dict) -> tuple[list[dict], dict | None]:
    """Print how it was found, and the figures per label; return those, and what was explored."""
    from ..report.sentences import report_lines
    from ..report.table import table_text
    from ..vtk_io.arrays import read_report

    report = read_report(grid, "identification")
    informed = grid.GetPointData().GetArray("DisplacementInformation_1") is not None
    for line in report_lines(report, informed, made.get("length_unit") or "mm"):
        print(line)
    rows = report.get("labels", [])
    if rows:
        print(table_text(rows, made.get("unit") or ""))
    _warn(report.get("warnings", []))
    return rows, report.get("explored")


def _warn(sentences) -> None:
    for sentence in sentences:
        print(f"warning: {sentence}")
