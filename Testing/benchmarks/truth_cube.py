"""Identify a real silicone cube from CT: `python Testing/benchmarks/truth_cube.py`.

The Truth Cube (Kerdok et al., Medical Image Analysis 7, 2003) is one silicone with 7 × 7 × 7 beads,
pushed along z. The beads are the nodes of 6 × 6 × 6 hexahedra. A layer of cells at one end is the
known pad, the others are identified: they must come out as stiff as the pad, and all alike. Every
bead on the lattice's outside bears forces of the silicone around it, so only the 125 inner beads
have a balance equation.

Reads `uniaxial_positions.csv` (see README.md beside it) from the folder given, by default
`../shared/data/truthcube` beside the repository.
"""

import argparse
import csv
import itertools
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from elastoidentify import InputError, identify
from elastoidentify.identification import IdentificationResult
from elastoidentify.imaging.displacement_sources import displacement_from_points
from elastoidentify.progress import silent

FOLDER = Path(__file__).resolve().parents[3] / "shared" / "data" / "truthcube"
YOUNG = 15.3  # kPa, according to the data's README
POISSON = 0.49  # the material's 0.499 locks cells that are linear: see docs/evidence.md
NOISE = np.array([0.10, 0.27, 0.10])  # mm, of a bead's displacement along x, y, z
KINEMATICS = ("small-strain", "st-venant-kirchhoff", "neo-hookean")
BEADS, LAYERS = 7, 6
PAD = 1  # label of the known layer
CORNERS = ((0, 0), (1, 0), (1, 1), (0, 1))


@dataclass(frozen=True)
class TruthCube:
    """The beads as nodes of hexahedra; lengths in mm.

    Attributes
    ----------
    points : (343, 3)
    displacements : (3, 343, 3)
        At 5, 12.5 and 18.25 % compression.
    cells : (216, 8) int
    index : (216, 3) int
        Place of each cell along x, y and the axis of the push, 0 to 5; the last counts from the
        top (largest z) down to the end that moves.
    outside : (343,) bool
        Beads on the outside of the lattice.
    """

    points: np.ndarray
    displacements: np.ndarray
    cells: np.ndarray
    index: np.ndarray
    outside: np.ndarray

    @property
    def deformation_gradients(self) -> np.ndarray:
        """Mean deformation gradient of every cell and trial from its edges, (3, 216, 3, 3)."""
        rest, *pushed = (self._edges(x) for x in (self.points, *(self.points + self.displacements)))
        return np.array([one @ np.linalg.inv(rest) for one in pushed])

    def _edges(self, points: np.ndarray) -> np.ndarray:
        """Mean edge vectors of the cells as columns, (216, 3, 3)."""
        corner = points[self.cells]
        pairs = (((0, 1), (3, 2), (4, 5), (7, 6)), ((0, 3), (1, 2), (4, 7), (5, 6)))
        pairs += (((0, 4), (1, 5), (2, 6), (3, 7)),)
        edges = [np.mean([corner[:, b] - corner[:, a] for a, b in four], axis=0) for four in pairs]
        return np.stack(edges, axis=-1)


def read_truth_cube(folder: str | Path = FOLDER) -> TruthCube:
    """Read the beads of the uniaxial compression."""
    with open(Path(folder) / "uniaxial_positions.csv", newline="", encoding="utf-8") as file:
        lines = list(csv.reader(file))
    start = next(n for n, line in enumerate(lines) if line[0] == "i") + 1
    numbers = np.array([[float(v) for v in line[:15]] for line in lines[start:] if line[0]])
    numbers = numbers[np.lexsort(numbers[:, 2::-1].T)]  # by i, then j, then k
    expected = np.array(list(itertools.product(range(1, BEADS + 1), repeat=3)))
    if not np.array_equal(numbers[:, :3], expected):
        raise InputError("the table does not hold every bead of the 7 × 7 × 7 lattice once")
    states = numbers[:, 3:].reshape(-1, 4, 3).transpose(1, 0, 2)
    rest = states[0]
    tables = [np.c_[rest, state - rest] for state in states[1:]]
    displacements = [displacement_from_points(table, rest).displacement for table in tables]

    bead = np.arange(BEADS**3).reshape(3 * (BEADS,))
    index = np.array(list(itertools.product(range(LAYERS), repeat=3)))
    i, j, k = index.T
    # k counts against z: the lower four corners of a cell have the larger k
    corners = [bead[i + a, j + b, k + down] for down in (1, 0) for a, b in CORNERS]
    place = expected - 1
    outside = ((place == 0) | (place == LAYERS)).any(axis=1)
    return TruthCube(rest, np.array(displacements), np.stack(corners, 1), index, outside)


def bead_noise(cube: TruthCube) -> np.ndarray:
    """Noise of the displacement (mm) along x, y, z from third differences over the lattice."""
    lattice = cube.displacements.reshape(-1, *3 * (BEADS,), 3)
    third = [np.diff(lattice, 3, axis=axis).reshape(-1, 3) for axis in (1, 2, 3)]
    third = np.concatenate(third) / np.sqrt(1 + 9 + 9 + 1)
    return 1.4826 * np.median(np.abs(third - np.median(third, axis=0)), axis=0)


def volume_ratios(cube: TruthCube) -> np.ndarray:
    """Volume of the lattice over that at rest, per trial."""
    rest = np.linalg.det(cube._edges(cube.points))
    return (np.linalg.det(cube.deformation_gradients) * rest).sum(1) / rest.sum()


def layers(cube: TruthCube, known: int) -> np.ndarray:
    """Label the known layer 1 and the other five 2 … 6."""
    return np.where(cube.index[:, 2] == known, PAD, _ranks(cube.index[:, 2] + 2, known + 2))


def columns(cube: TruthCube, known: int) -> np.ndarray:
    """Label the known layer 1 and nine columns of 2 × 2 × 5 cells below or above it 2 … 10."""
    column = 3 * (cube.index[:, 0] // 2) + cube.index[:, 1] // 2
    return np.where(cube.index[:, 2] == known, PAD, column + 2)


def rest_of_the_cube(cube: TruthCube, known: int) -> np.ndarray:
    """Label the known layer 1 and all other cells 2."""
    return np.where(cube.index[:, 2] == known, PAD, 2)


def _ranks(values, left_out):
    return values - (values > left_out)


def identify_cube(
    cube: TruthCube,
    labels: np.ndarray,
    *,
    kinematics: str = "neo-hookean",
    poisson: float = POISSON,
    grouping: str = "label",
    trials=(0, 1, 2),
    refine: int = 1,
    progress=silent,
) -> IdentificationResult:
    """Identify E (kPa) of all cells but those labelled 1, the noise of the beads as weight."""
    trials = list(trials)
    shape = (len(trials), len(cube.points), 3, 3)
    return identify(
        cube.points,
        [("hexahedron", cube.cells)],
        cube.displacements[trials],
        {PAD: (YOUNG, poisson)},
        labels=labels,
        reaction_nodes=cube.outside,
        method="regularized",
        kinematics=kinematics,
        unknowns="young",
        poisson_ratio=poisson,
        grouping=grouping,
        information=np.broadcast_to(np.diag(NOISE**-2.0), shape),
        refine=refine,
        progress=progress,
    )


def log_moduli(result: IdentificationResult, labels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return log(E / E of the pad) and its predicted std, one value per label but the pad."""
    first = np.unique(labels, return_index=True)[1][1:]
    return np.log(result.young[first] / YOUNG), result.mu_std[first] / result.mu[first]


def facts(cube: TruthCube) -> dict:
    """Return what the beads show without any identification."""
    mean = cube.deformation_gradients.mean(axis=1)
    axial = np.log(mean[:, 2, 2])
    lateral = np.log(mean[:, 0, 0] * mean[:, 1, 1]) / 2
    return {
        "noise_mm": bead_noise(cube).tolist(),
        "volume_ratios": volume_ratios(cube).tolist(),
        "axial_strain": (mean[:, 2, 2] - 1).tolist(),
        "poisson": (-lateral / axial).tolist(),
    }


def ratio_rows(cube: TruthCube, cases) -> list[str]:
    """Return table lines: pad / rest with its uncertainty for each case of keywords."""
    lines = []
    for known, options in cases:
        labels = rest_of_the_cube(cube, known)
        result = identify_cube(cube, labels, **options)
        (log,), (std,) = log_moduli(result, labels)
        lines.append(
            f"| {options['kinematics']:<20} | {options['poisson']:<5} | {_end(known):<6} "
            f"| {_trials(options):<5} | {options.get('refine', 1)} "
            f"| {np.exp(-log):5.2f} ×÷ {np.exp(std):.2f} | {abs(log) / std:4.1f} "
            f"| {result.report['noise_scale']:.2f} |"
        )
        print(lines[-1], flush=True)
    return lines


def flatness_rows(cube: TruthCube, cases) -> None:
    """Print table lines: spread of log E over groups or cells beside the predicted one."""
    for known, name, grouping, options in cases:
        labels = {"layers": layers, "columns": columns, "cells": rest_of_the_cube}[name](
            cube, known
        )
        result = identify_cube(cube, labels, grouping=grouping, **options)
        if grouping == "cell":
            unknown = labels != PAD
            log = np.log(result.young[unknown] / YOUNG)
            std = (result.mu_std / result.mu)[unknown]
        else:
            log, std = log_moduli(result, labels)
        print(
            f"| {options['kinematics']:<20} | {options['poisson']:<5} | {_end(known):<6} "
            f"| {len(log):>3} {name:<8} | {log.std():.3f} | {np.sqrt((std**2).mean()):.3f} "
            f"| {' '.join(f'{np.exp(v):.2f}' for v in log) if len(log) < 12 else ''} |",
            flush=True,
        )


def _end(known: int) -> str:
    return "top" if known == 0 else "bottom"


def _trials(options) -> str:
    return "".join(str(t + 1) for t in options.get("trials", (0, 1, 2)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", nargs="?", default=FOLDER, type=Path)
    parser.add_argument("--refined", action="store_true", help="also on eight sub-cells per cell")
    options = parser.parse_args()
    cube = read_truth_cube(options.folder)
    print(json.dumps(facts(cube), indent=1))
    print("\n| kinematics | ν | pad | trials | refine | E pad / E rest | off by std | noise |")
    last = {"trials": (2,)}
    cases = [
        (known, {"kinematics": kinematics, "poisson": POISSON})
        for known in (0, 5)
        for kinematics in KINEMATICS
    ]
    cases += [
        (known, {"kinematics": "neo-hookean", "poisson": poisson, **last})
        for known in (0, 5)
        for poisson in (0.45, 0.48, 0.49, 0.499)
    ]
    if options.refined:
        cases += [
            (known, {"kinematics": "neo-hookean", "poisson": POISSON, **last, "refine": 4})
            for known in (0, 5)
        ]
    ratio_rows(cube, cases)
    print("\n| kinematics | ν | pad | groups | std of log E | predicted | E / E of the pad |")
    flat = [
        (0, name, grouping, {"kinematics": kinematics, "poisson": POISSON})
        for kinematics in KINEMATICS
        for name, grouping in (("layers", "label"), ("columns", "label"), ("cells", "cell"))
    ]
    flatness_rows(cube, flat)


if __name__ == "__main__":
    main()
