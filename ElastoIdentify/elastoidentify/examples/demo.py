"""The main job on a real MR slice whose stiffness is known, and how well it was found.

A slice of the MNI152 T1 template becomes the tissue of a phantom with an inclusion, a pad, a floor
and an indenter (:mod:`elastoidentify.imaging.phantom`). From its images alone: mesh, registration,
identification cell by cell and label by label.
"""

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from .. import pipeline
from ..report.table import with_truth, write_table
from ..report.terminal import TerminalProgress, figure, peak_memory, seconds, table
from ..study import Study

SLICE = 92  # of the MNI152 template: ventricles, cortex and white matter


def run_demo(
    folder: str | Path,
    *,
    image: str | None = None,
    slice_index: int | None = None,
    edge_pixels: float = 12.0,
    say: Callable[[str], None] = print,
) -> dict:
    """Run the demo and write its phantom, meshes, tables and picture to `folder`.

    Parameters
    ----------
    folder : path
    image : path, optional
        Texture of the tissue. Default: the MNI152 T1 template that the nilearn package ships.
    slice_index : int, optional
        Axial slice of a volume.
    edge_pixels : float
        Edge length of the cells in pixels.
    say : callable
        Gets every line for people.

    Returns
    -------
    dict
        ``contrast`` and ``contrast_by_label`` of the inclusion over the tissue, ``true_contrast``,
        ``rows`` and ``rows_by_label`` (figures per label), ``seconds``, ``peak_memory`` (bytes).
    """
    from ..imaging.io import output_folder

    start = time.monotonic()
    with output_folder(folder) as folder:  # nothing is written before all is done
        made = _make_phantom(image, slice_index, say)
        report = _deliver(folder, made, *_map(made, edge_pixels), say)
    report["seconds"], report["peak_memory"] = time.monotonic() - start, peak_memory()
    memory = report["peak_memory"]
    used = "" if memory is None else f", {memory / 2**30:.2f} GiB of memory at the most"
    say(f"\ntotal: {seconds(report['seconds'])}{used}")
    return report


def _make_phantom(image: str | None, slice_index: int | None, say):
    from ..imaging.io import read_image
    from ..imaging.phantom import make_phantom
    from ..imaging.phantom.texture import mni152_path, slice_of

    if image is None and slice_index is None:
        slice_index = SLICE
    texture = slice_of(read_image(image or mni152_path()), index=slice_index)
    with TerminalProgress("phantom") as progress:
        made = make_phantom(texture, kinematics="neo-hookean", progress=progress)
    pushes = " and ".join(f"({x:.2f}, {y:.2f})" for x, y, _ in made.pushes)
    tissue, inclusion, pad = (made.materials[made.label(n)] for n in ("tissue", "inclusion", "pad"))
    say(
        f"phantom: {made.rest.size[0]} × {made.rest.size[1]} pixels of "
        f"{made.rest.spacing[0]:.2f} mm, block {made.frame.width:.0f} × {made.frame.height:.0f} mm,"
        f" E {pad.young:g} Pa in the pad (known), {tissue.young:g} Pa in the tissue, "
        f"{inclusion.young:g} Pa in the inclusion, pushed by {pushes} mm, "
        f"{100 * made.parameters['noise']:g} % noise"
    )
    return made


def _study(made, edge_pixels: float, grouping: str) -> Study:
    """Return what is asked: λ and μ per cell or label, of images and segmentation alone."""
    pad = made.label("pad")
    material = made.materials[pad]
    return Study(
        segmentation=made.segmentation,
        rest=made.rest,
        pushed=made.pushed,
        edge_length=edge_pixels * made.rest.spacing[0],
        rigid_labels=made.rigid_labels,
        known_materials={pad: (material.young, material.poisson)},
        method="regularized",
        grouping=grouping,
        kinematics=made.parameters["kinematics"],
    )


def _map(made, edge_pixels: float):
    """Return the map per cell and per label; one registration serves both."""
    names = {label: material.name for label, material in made.materials.items()}
    with TerminalProgress("map per cell") as progress:
        by_cell = pipeline.run(_study(made, edge_pixels, "cell"), names=names, progress=progress)
    with TerminalProgress("map per label") as progress:
        by_label = pipeline.run(
            _study(made, edge_pixels, "label"),
            mesh=by_cell.mesh,
            registration=by_cell.registration,
            names=names,
            progress=progress,
        )
    return by_cell, by_label


def _deliver(folder: Path, made, by_cell, by_label, say) -> dict:
    """Write everything, print the figures, and return them."""
    from ..imaging.phantom import write_phantom
    from ..vtk_io.arrays import write_outcome
    from ..vtk_io.picture import draw
    from ..vtk_io.vtu import write_mesh

    write_phantom(folder / "phantom", made)
    truth = {
        label: {"Mu": m.young / (2 * (1 + m.poisson)), "YoungModulus": m.young}
        for label, m in made.materials.items()
        if m.young is not None
    }
    rows = {}
    for name, outcome in (("map", by_cell), ("map_by_label", by_label)):
        grid = write_outcome(outcome)
        rows[name] = with_truth(outcome.result.statistics, truth)
        write_mesh(folder / f"{name}.vtu", grid)
        write_table(folder / f"{name}.csv", rows[name], outcome.provenance)
        draw(folder / f"{name}.png", grid, made.rest)

    exact = made.displacements(by_cell.mesh.points)
    miss = (by_cell.displacements - exact) / made.rest.spacing[0]
    rms = np.sqrt((miss**2).sum(-1).mean(-1))
    say("registration: RMS error of the nodes " + ", ".join(f"{e:.2f}" for e in rms) + " pixels")
    say("")
    say(_comparison(made, rows, truth))
    inclusion, tissue = made.label("inclusion"), made.label("tissue")
    true = made.materials[inclusion].young / made.materials[tissue].young
    found = [_contrast(rows[name], inclusion, tissue) for name in ("map", "map_by_label")]
    say("")
    for name, value in zip(("per cell", "per label"), found, strict=True):
        say(f"contrast of the inclusion {name}: {figure(value)} (true {true:g})")
    for name, outcome in (("per cell", by_cell), ("per label", by_label)):
        for warning in outcome.result.report["warnings"]:
            say(f"warning ({name}): {warning}")
    say(f"\npicture, meshes and tables are in {folder}")
    return {
        "contrast": found[0],
        "contrast_by_label": found[1],
        "true_contrast": true,
        "rows": rows["map"],
        "rows_by_label": rows["map_by_label"],
        "registration_error_pixels": rms.tolist(),
    }


def _contrast(rows: list[dict], inclusion: int, tissue: int) -> float:
    """Return the median μ of the inclusion's cells over the median of the tissue's."""
    median = {row["label"]: row["Mu median"] for row in rows}
    return median[inclusion] / median[tissue]


def _comparison(made, rows: dict, truth: dict) -> str:
    """Return μ of every label: true, found both ways, and the guess that all is like the pad."""
    flat = truth[made.label("pad")]["Mu"]
    by_label = {row["label"]: row for row in rows["map_by_label"]}
    header = ["μ (Pa)", "cells", "true", "per cell (mean)", "found", "per label", "flat guess"]
    lines = []
    for row in rows["map"]:
        label = row["label"]
        given = row["given"]
        lines.append(
            [
                f"{label} {made.materials[label].name}",
                str(row["cells"]),
                figure(truth[label]["Mu"]),
                "given" if given else _with_error(row),
                "" if given else f"{100 * row['determined']:.0f} %",
                "given" if given else _with_error(by_label[label]),
                figure(flat),
            ]
        )
    return table(header, lines)


def _with_error(row: dict) -> str:
    return f"{figure(row['Mu mean'])} ± {figure(row['Mu standard error'], 2)}"
