"""Do the stated errors hold? How often the truth lies within two standard deviations, from images.

    python Testing/benchmarks/stated_errors.py --phantoms 60 --keep FOLDER --out coverage.json

Every phantom has a contrast (1.2 to 8), a noise (1 to 5 %), a lesion (radius 8 to 20 % of the
width) and a tissue of its own; its texture is by turns speckle, an axial and a coronal slice of the
MNI152 MR template. Neo-Hookean pushes of 5 %, straight and oblique, are solved on quadratic
quadrilaterals that no identification uses. Each is identified three times: the lesion hidden from a
mesh that does not follow it, an own unknown per cell; the same on a mesh that follows it; and per
label. Kept in the folder are meshes and registrations, so that another fit need not register again.

Printed are the shares of cells inside and outside of the lesion, of labels and of the ratio of the
two labels whose true μ lies within two stated standard deviations, the root mean square of the
errors in units of them (1: calibrated), the contrasts found, and beside them the error of the flat
guess, which gives all tissue the value of the pad. A cell is inside when its centre is. With
``--correlations`` it is printed how alike the errors of the displacements are, in units of what is
stated: of nodes at a distance in one trial, and of one node in the two trials.
"""

import argparse
import json
import pickle
from pathlib import Path

import numpy as np
from elastoidentify.imaging.io import read_image
from elastoidentify.imaging.phantom.planar import Inclusion, make_phantom
from elastoidentify.imaging.phantom.texture import mni152_path, slice_of
from elastoidentify.pipeline import make_mesh, measure, run
from elastoidentify.results import Status, to_matrices
from elastoidentify.study import Study
from elastoidentify.workers.elastix_client import ElastixProcess

PAD, TISSUE, LESION = 1, 2, 3
TEXTURES = {"speckle": None, "axial": (2, (70, 108)), "coronal": (1, (100, 140))}
PIXELS, EDGE = 120, 8.0  # across the block; of the mesh, in pixels
WAYS = ("hidden", "followed", "label")


def phantom_of(number: int):
    """Return the texture's name and the phantom of a number."""
    rng = np.random.default_rng([31, number])
    name = tuple(TEXTURES)[number % len(TEXTURES)]
    texture = None
    if TEXTURES[name]:
        axis, (low, high) = TEXTURES[name]
        texture = slice_of(read_image(mni152_path()), axis=axis, index=int(rng.integers(low, high)))
    lesion = Inclusion(
        rng.uniform(0.35, 0.65),
        rng.uniform(0.5, 0.65),
        rng.uniform(0.08, 0.2),
        float(np.exp(rng.uniform(np.log(1.2), np.log(8)))),
    )
    made = make_phantom(
        texture, inclusions=[lesion], noise=rng.uniform(0.01, 0.05), seed=number, pixels=PIXELS,
        tissue_young=rng.uniform(2000, 6000), kinematics="neo-hookean", elements=48,
    )  # fmt: skip
    return name, made


def study_of(phantom, way: str, **options) -> Study:
    """Return the study of a phantom, for one of the ways to identify it."""
    image, pad = phantom.segmentation, phantom.materials[PAD]
    if way == "hidden":
        labels = np.where(image.array == LESION, TISSUE, image.array)
        image = image.with_array(labels.astype(image.array.dtype))
    return Study(
        segmentation=image,
        rest=phantom.rest,
        pushed=phantom.pushed,
        edge_length=EDGE * float(phantom.rest.spacing[0]),
        rigid_labels=phantom.rigid_labels,
        known_materials=[(PAD, pad.young, pad.poisson)],
        method="regularized",
        kinematics="neo-hookean",
        grouping="label" if way == "label" else "cell",
        **options,
    )


def measured(phantom, way: str, file: Path | None, elastix):
    """Return the mesh and its registration, from the file where it is there."""
    if file and file.is_file():
        return pickle.loads(file.read_bytes())
    study = study_of(phantom, way)
    mesh = make_mesh(study)
    found = measure(
        study, mesh.points, mesh.cells, reaction_nodes=mesh.reaction_nodes, elastix=elastix
    )
    if file:
        file.write_bytes(pickle.dumps((mesh, found)))
    return mesh, found


def identified(phantom, way: str, mesh, registration, **options) -> dict:
    """Return what one map says, and what is true of it."""
    study = study_of(phantom, way, **options)
    result = run(study, mesh=mesh, registration=registration).result
    true = {
        label: material.young / (2 * (1 + material.poisson))
        for label, material in phantom.materials.items()
        if material.young
    }
    inside = _inside(phantom, mesh) if way == "hidden" else mesh.labels == LESION
    unknown = mesh.labels != PAD
    return {
        "inside": inside[unknown].tolist(),
        "mu": result.mu[unknown].tolist(),
        "std": result.mu_std[unknown].tolist(),
        "alone": (result.status == Status.SHEAR_ONLY)[unknown].tolist(),
        "true": np.where(inside, true[LESION], true[TISSUE])[unknown].tolist(),
        "flat": true[PAD],
        "labels": [_of_label(row, true) for row in result.statistics if row["label"] != PAD],
        "verdict": result.report["verdict"]["level"],
    }


def print_correlations(phantom, mesh, registration) -> None:
    """Print correlations of errors, whitened with the information, between nodes and trials."""
    information = to_matrices(registration.information)[..., :2, :2]
    values, vectors = np.linalg.eigh(information)
    root = np.einsum("tnik,tnk,tnjk->tnij", vectors, np.sqrt(np.maximum(values, 0)), vectors)
    error = (registration.displacements - phantom.displacements(mesh.points))[..., :2]
    inner = ~mesh.reaction_nodes.astype(bool)
    z = np.einsum("tnij,tnj->tni", root, error)[:, inner]
    z /= np.sqrt((z**2).mean())
    pixels = mesh.points[inner, :2] / phantom.rest.spacing[0]
    apart = np.linalg.norm(pixels[:, None] - pixels, axis=-1)
    alike = np.einsum("tik,tjk->ij", z, z) / (2 * len(z))
    for low, high in ((1, 10), (10, 20), (20, 40)):
        near = (apart >= low) & (apart < high)
        print(f"#   {low} to {high} pixels apart: correlation {alike[near].mean():+.2f}")
    print(f"#   one node in two trials: correlation {(z[0] * z[1]).mean():+.2f}", flush=True)


def _inside(phantom, mesh) -> np.ndarray:
    """Whether a cell's centre is in the lesion, (n_cells,)."""
    frame, lesion = phantom.frame, phantom.parameters["inclusions"][0]
    centres = frame.to_body(mesh.points[mesh.cells].mean(axis=1))
    away = centres - [lesion["x"] * frame.width, lesion["y"] * frame.height]
    return np.hypot(*away.T) < lesion["radius"] * frame.width


def _of_label(row: dict, true: dict) -> dict:
    """Mean and ratio to the tissue of one label: found, stated error, true."""
    mu = true[row["label"]]
    return {
        "label": row["label"],
        "mean": [row["Mu mean"], row["Mu standard error"], mu],
        "ratio": [row["Mu ratio"], row["Mu ratio standard error"], mu / true[row["reference"]]],
    }


def shares(errors) -> str:
    """Say how errors in units of their standard deviation are spread."""
    errors = np.abs(np.asarray(errors, float))
    known = np.isfinite(errors)
    if not known.any():
        return "– | – | –"
    within, rms = (errors[known] <= 2).mean(), np.sqrt((errors[known] ** 2).mean())
    return f"{within:.1%} | {rms:.2f} | {1 - known.mean():.1%}"


def report(cases: list[dict]) -> None:
    """Print the tables."""
    print("| map | of what | within 2 std | rms of error/std | undetermined | error | flat |")
    print("|---|---|---|---|---|---|---|")
    for way in WAYS[:2]:
        maps = [case[way] for case in cases if way in case]
        if not maps:
            continue
        for name, wanted in (("lesion", True), ("tissue", False)):
            mu, std, true, flat, alone = _cells(maps, wanted)
            off, none = np.nanmean(np.abs(np.log(mu / true))), np.abs(np.log(flat / true)).mean()
            print(f"| {way} | {name} | {shares((mu - true) / std)} | {off:.3f} | {none:.3f} |")
            if alone.any():
                here = shares(((mu - true) / std)[alone.astype(bool)])
                print(f"| {way} | {name}, of which μ alone: {alone.mean():.1%} | {here} | | |")
    rows = [row for case in cases for row in case.get("label", {"labels": []})["labels"]]
    for name, label, key in (
        ("lesion", LESION, "mean"), ("tissue", TISSUE, "mean"), ("ratio", LESION, "ratio"),
    ):  # fmt: skip
        found = np.array([row[key] for row in rows if row["label"] == label]).reshape(-1, 3)
        value, std, true = found.T
        off = np.nanmean(np.abs(np.log(value / true))) if len(found) else np.nan
        print(f"| label | {name} | {shares((value - true) / std)} | {off:.3f} | |")


def _cells(maps, wanted: bool):
    """Join values, deviations, truth, flat guess and μ alone of cells in or out of the lesion."""
    parts = []
    for one in maps:
        here = np.array(one["inside"], bool) == wanted
        parts.append([np.array(one[key], float)[here] for key in ("mu", "std", "true")])
        parts[-1] += [np.full(here.sum(), one["flat"]), np.array(one["alone"], float)[here]]
    return [np.concatenate(column) for column in zip(*parts, strict=True)]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--phantoms", type=int, default=60)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--ways", nargs="+", choices=WAYS, default=list(WAYS))
    parser.add_argument("--correlations", action="store_true", help="of the displacements' errors")
    parser.add_argument("--keep", type=Path, help="folder of meshes and registrations")
    parser.add_argument("--out", type=Path, help="JSON of all that was found")
    arguments = parser.parse_args()
    if arguments.keep:
        arguments.keep.mkdir(parents=True, exist_ok=True)
    cases = []
    with ElastixProcess() as elastix:
        for number in range(arguments.first, arguments.first + arguments.phantoms):
            texture, phantom = phantom_of(number)
            lesion = phantom.parameters["inclusions"][0]
            case = {"number": number, "texture": texture, "noise": phantom.parameters["noise"]}
            case |= lesion
            for way in arguments.ways:
                name = "hidden" if way == "hidden" else "followed"
                file = arguments.keep and arguments.keep / f"{number}_{name}.pickle"
                mesh, found = measured(phantom, way, file, elastix)
                if arguments.correlations:
                    print_correlations(phantom, mesh, found)
                case[way] = identified(phantom, way, mesh, found)
                print(f"# {number} {texture} {way} {lesion['contrast']:.2f} "
                      f"{case[way]['verdict']}", flush=True)  # fmt: skip
            cases.append(case)
            if arguments.out:
                arguments.out.write_text(json.dumps(cases), encoding="utf-8")
    report(cases)


if __name__ == "__main__":
    main()
