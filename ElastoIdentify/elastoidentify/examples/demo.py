"""The main job on a real MR slice whose stiffness is known, and how well it was found.

A slice of the MNI152 T1 template becomes the tissue of a phantom with an inclusion, a pad, a floor
and an indenter (:mod:`elastoidentify.imaging.phantom`). From its images alone: mesh, registration,
identification cell by cell and label by label.
"""

import json
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from ..report.terminal import TerminalProgress, figure, peak_memory, seconds, table

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
        grid = _measure(made, edge_pixels)
        grid_by_cell = _identify(made, grid, "cell")
        grid_by_label = _identify(made, grid, "label")
        report = _deliver(folder, made, grid_by_cell, grid_by_label, say)
    report["seconds"], report["peak_memory"] = time.monotonic() - start, peak_memory()
    memory = report["peak_memory"]
    used = "" if memory is None else f", {memory / 2**30:.2f} GiB of memory at the most"
    say(f"\ntotal: {seconds(report['seconds'])}{used}")
    return report


def _make_phantom(image: str | None, slice_index: int | None, say):
    from ..imaging.io import read_image
    from ..imaging.phantom.planar import make_phantom
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


def _measure(made, edge_pixels: float):
    """Return the mesh of the segmentation with the displacements that the images show."""
    from ..filters import ElastixNodalDisplacement, SegmentationToTriangleMesh
    from ..filters.direct import apply
    from ..vtk_io.convert import image_to_vtk

    mesher = SegmentationToTriangleMesh(
        edge_length=edge_pixels * made.rest.spacing[0], rigid_labels=made.rigid_labels
    )
    with TerminalProgress("mesh") as progress:
        grid = apply(mesher, image_to_vtk(made.segmentation, "Label"), progress=progress)
    rest, *pushed = (image_to_vtk(image) for image in (made.rest, *made.pushed))
    with TerminalProgress("registration") as progress:
        return apply(ElastixNodalDisplacement(), grid, rest, pushed, progress=progress)


def _identify(made, grid, grouping: str):
    """Return the mesh with Young's modulus per cell or label, Poisson's ratio given."""
    from ..filters import LameIdentification
    from ..filters.direct import apply

    pad = made.label("pad")
    material = made.materials[pad]
    identification = LameIdentification(
        known_materials={pad: (material.young, material.poisson)},
        method="regularized",
        unknowns="young",
        poisson_ratio=material.poisson,
        grouping=grouping,
        kinematics=made.parameters["kinematics"],
    )
    with TerminalProgress(f"identification per {grouping}") as progress:
        return apply(identification, grid, progress=progress)


def _deliver(folder: Path, made, by_cell, by_label, say) -> dict:
    """Write everything, print the figures, and return them."""
    from ..imaging.phantom.planar import write_phantom
    from ..report.picture import draw
    from ..report.table import RESULT_ARRAYS, label_rows, write_table
    from ..vtk_io.convert import displacement_names, get_array, get_text, mesh_points
    from ..vtk_io.vtu import write_mesh

    write_phantom(folder / "phantom", made)
    truth = {
        label: {"Mu": m.young / (2 * (1 + m.poisson)), "YoungModulus": m.young}
        for label, m in made.materials.items()
        if m.young is not None
    }
    rows = {}
    for name, grid in (("map", by_cell), ("map_by_label", by_label)):
        arrays = {array: get_array(grid.GetCellData(), array) for array in RESULT_ARRAYS}
        rows[name] = label_rows(arrays, truth)
        write_mesh(folder / f"{name}.vtu", grid)
        write_table(folder / f"{name}.csv", rows[name])
        draw(folder / f"{name}.png", grid, made.rest)

    measured = [get_array(by_cell.GetPointData(), name) for name in displacement_names(by_cell)]
    miss = (np.array(measured) - made.displacements(mesh_points(by_cell))) / made.rest.spacing[0]
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
    for name, grid in (("per cell", by_cell), ("per label", by_label)):
        report = json.loads(get_text(grid, "IdentificationReport"))
        for warning in report.get("warnings", []):
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
    header = ["μ (Pa)", "cells", "true", "per cell (median)", "found", "per label", "flat guess"]
    lines = []
    for row in rows["map"]:
        label = row["label"]
        given = row["known"]
        lines.append(
            [
                f"{label} {made.materials[label].name}",
                str(row["cells"]),
                figure(truth[label]["Mu"]),
                "given" if given else f"{figure(row['Mu median'])} ± {figure(row['Mu std'], 2)}",
                "" if given else f"{100 * row['identified']:.0f} %",
                "given" if given else figure(by_label[label]["Mu median"]),
                figure(flat),
            ]
        )
    return table(header, lines)
