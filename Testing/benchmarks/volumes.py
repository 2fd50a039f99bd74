"""Volumes near incompressibility: bias, map, standard deviations, time.

    python Testing/benchmarks/volumes.py label cell other plane      # some minutes
    python Testing/benchmarks/volumes.py graded                      # some minutes
    python Testing/benchmarks/volumes.py label25 cell25              # half an hour
    python Testing/benchmarks/volumes.py large                       # 110 592 tetrahedra

A unit cube stands on its floor, its top quarter is the known pad (E = 1), an inclusion of 3 : 1 is
inside; four pushes. Truth: triquadratic bricks with discontinuous linear pressure on another mesh
(16³ bricks; `--truth 8` for 8³), which do not lock. Noise is 2 % of the largest displacement in
every component at every node. Time is processor time as a multiple of one forward solve of the
same mesh: stiffness, its factors, four solutions. Per label the segmentation shows the inclusion;
per cell it knows pad and tissue only.
"""

import argparse
import resource
import sys
import time
from pathlib import Path

import elastoidentify as ei
import numpy as np
from elastoidentify.fem.cells import LockingFreeCells
from elastoidentify.fem.constitutive import KINEMATICS
from elastoidentify.fem.elastic_constants import lame_from_young
from elastoidentify.fem.forward import box_mesh
from elastoidentify.fem.mesh import make_mesh
from elastoidentify.fem.patches import patches
from elastoidentify.imaging.image import Image
from elastoidentify.imaging.meshing import mesh_segmentation
from elastoidentify.linalg.factor import Factoriser

sys.path.insert(0, str(Path(__file__).parents[1]))
import forward
from cube import CONTRAST, PAD, inside, truth, unstructured

VOXELS = 96  # along the cube's sides, where its labels are meshed


def segmented(shape, n, grading):
    """Return points and tetrahedra of a mesh of the cube's labels, n edges along its sides."""
    centres = (np.indices((VOXELS,) * 3)[::-1].reshape(3, -1).T + 0.5) / VOXELS
    labels = np.where(centres[:, 2] > PAD, 3, np.where(inside(centres, shape), 2, 1))
    spacing = np.full(3, 1 / VOXELS)
    image = Image(labels.reshape((VOXELS,) * 3), origin=spacing / 2, spacing=spacing)
    mesh = mesh_segmentation(image, 1 / n, grading=grading)
    return mesh.points, mesh.cells


class Body:
    """One mesh of the cube with noisy displacements."""

    def __init__(
        self, args, kind, n, poisson, shape="box", slip=False, noise=0.02, seed=1, grading=1
    ):
        n = (n,) * 3 if isinstance(n, int) else n
        if kind == "unstructured":
            points, self.cells = unstructured(n[0])
        elif kind == "segmented":
            points, self.cells = segmented(shape, n[0], grading)
        else:
            points, self.cells = box_mesh(n, (1.0, 1.0, 1.0), kind)
        self.kind, self.points, self.poisson = kind, points, poisson
        u = truth(args.truth, poisson, shape, slip).at(points)
        random = np.random.default_rng(seed)
        self.noise = noise * np.abs(u).max()
        self.u = u + self.noise * random.standard_normal(u.shape)
        centre = points[self.cells].mean(axis=1)
        self.young, self.known = np.where(inside(centre, shape), CONTRAST, 1.0), centre[:, 2] > PAD
        self.labels = np.where(self.known, 3, np.where(self.young > 1, 2, 1))
        self.blocks = [("hexahedron" if kind == "hexahedron" else "tetra", self.cells)]
        self.reaction = (points[:, 2] < 1e-9) | (points[:, 2] > 1 - 1e-9)

    def forward_time(self):
        """Processor seconds of one forward solve: stiffness, factors, a column per push."""
        mesh, law = make_mesh(self.points, self.blocks), KINEMATICS["small-strain"]
        cells = LockingFreeCells(mesh, law, patches(mesh))
        lam, mu = lame_from_young(self.young, self.poisson)
        cells.tangent(0 * self.points, lam, mu)  # the pattern is made once for all solves
        start = time.process_time()
        K = cells.tangent(0 * self.points, lam, mu)
        free = np.repeat(~self.reaction, 3)
        factors = Factoriser(np.repeat(self.points, 3, axis=0)[free])(K[free][:, free])
        factors.solve(-(K[free] @ self.u.reshape(len(self.u), -1).T))
        return time.process_time() - start

    def identify(self, grouping, element="locking-free", poisson=None, unknowns="young"):
        given = {"poisson_ratio": poisson or self.poisson} if unknowns == "young" else {}
        start = time.process_time()
        result = ei.identify(
            self.points, self.blocks, self.u,
            np.where(self.known[:, None], [1.0, self.poisson], np.nan),
            # a map of cells is of use where the segmentation does not show the inclusion
            labels=self.labels if grouping == "label" else np.where(self.known, 3, 1),
            grouping=grouping, method="regularized", unknowns=unknowns,
            reaction_nodes=self.reaction, element=element, **given,
        )  # fmt: skip
        return result, time.process_time() - start

    def row(self, name, grouping, **settings):
        """Print one line of the table; the wanted is the modulus found, so NaN counts as wrong."""
        result, seconds = self.identify(grouping, **settings)
        mu = self.young / (2 * (1 + self.poisson))
        E = CONTRAST * result.mu / mu / np.where(self.young > 1, 1, CONTRAST)
        unknown, std = ~self.known, result.mu_std / result.mu
        ball, tissue = np.nanmedian(E[self.young > 1]), np.nanmedian(E[unknown & (self.young == 1)])
        error = np.nan_to_num(np.abs(result.mu / mu - 1)[unknown], nan=1.0).mean()
        within = (np.abs(np.log(result.mu / mu)) < 2 * std)[unknown].mean()
        report = result.report
        shift = report["mesh_shift"]
        print(
            f"| {name} | {len(self.cells)} | {grouping} | {ball:.2f} | {tissue:.3f} | {error:.3f} "
            f"| {within:.1%} | {np.nanmedian(std[unknown]):.3f} "
            f"| {'–' if shift is None else format(shift, '.1%')} "
            f"| {report['noise_found'] / self.noise:.2f} | {seconds / self.forward_time():.0f} "
            f"({seconds:.1f} s) | {report['factorisation']} |",
            flush=True,
        )
        return result


HEAD = """
| case | cells | unknowns | inclusion (3) | tissue (1) | mean error of μ | within 2 std | typical std | shift by the mesh, estimated | noise found / put in | forward solves | factors |
|---|---|---|---|---|---|---|---|---|---|---|---|"""  # noqa: E501


def label(args, n=8, ratios=(0.3, 0.45, 0.495, 0.499)):
    print(HEAD)
    for nu in ratios:
        Body(args, "tetra", n, nu).row(f"ν {nu}, box, clamped", "label")
        if nu == 0.495:
            Body(args, "tetra", n, nu).row(f"ν {nu}, plain linear cells", "label", element="linear")
            Body(args, "unstructured", n, nu).row(f"ν {nu}, unstructured", "label")
            Body(args, "hexahedron", n, nu).row(f"ν {nu}, hexahedra", "label")
            Body(args, "tetra", n, nu, slip=True).row(f"ν {nu}, friction-free floor", "label")
            Body(args, "tetra", n, nu, "ball").row(f"ν {nu}, ball", "label")


def cell(args, n=8, ratios=(0.45, 0.495, 0.499)):
    print(HEAD)
    for nu in ratios:
        Body(args, "tetra", n, nu).row(f"ν {nu}, box, clamped", "cell")
        Body(args, "hexahedron", n, nu).row(f"ν {nu}, hexahedra", "cell")
        if nu == 0.495:
            Body(args, "tetra", n, nu).row(f"ν {nu}, plain linear cells", "cell", element="linear")
            Body(args, "unstructured", n, nu).row(f"ν {nu}, unstructured", "cell")
            Body(args, "tetra", n, nu, slip=True).row(f"ν {nu}, friction-free floor", "cell")
            Body(args, "tetra", n, nu, "ball").row(f"ν {nu}, ball", "cell")
            one = Body(args, "tetra", n, nu, "ball", noise=0.005)
            one.row(f"ν {nu}, ball, 0.5 % noise", "cell")


def label25(args):
    print(HEAD)
    Body(args, "tetra", 16, 0.45).row("ν 0.45, box, clamped", "label")
    Body(args, "tetra", 16, 0.499).row("ν 0.499, box, clamped", "label")
    Body(args, "unstructured", 16, 0.495).row("ν 0.495, unstructured", "label")


def cell25(args):
    print(HEAD)
    for nu in (0.45, 0.499):
        Body(args, "tetra", 16, nu).row(f"ν {nu}, box, clamped", "cell")


def graded(args, n=16):
    """Cells that grow away from the borders, beside even ones of the same edge there."""
    print(HEAD)
    for shape in ("box", "ball"):
        for grading in (1, 2):
            one = Body(args, "segmented", n, 0.495, shape, grading=grading)
            one.row(f"ν 0.495, {shape}, edges up to {grading} times as long", "label")


def other(args):
    print(HEAD)
    for grouping in ("label", "cell"):
        Body(args, "tetra", 8, 0.4).row("ν 0.4, λ and μ unknown", grouping, unknowns="lambda-mu")
        for wrong in (0.43, 0.47):
            one = Body(args, "tetra", 8, 0.45)
            one.row(f"ν 0.45, {wrong} assumed", grouping, poisson=wrong)


def plane(args):
    """The plane's bias table: 512 triangles, 0.1 % noise."""
    print("\n| ν | cells | sub-cells | inclusion (3) | tissue (1) | mean error | seconds |")
    print("|---|---|---|---|---|---|---|")
    for nu in (0.43, 0.495):
        case = forward.squares(16, poisson=nu, radius=0.2)
        u = case.noisy(1e-3 * np.abs(case.displacements).max(), 0)
        inner, outer = case.from_edge < -1, (case.from_edge > 1) & ~case.known
        for element, refine in (("linear", 16), ("locking-free", 1), ("locking-free", 4)):
            start = time.process_time()
            found = ei.identify(
                case.points, case.cells, u, case.materials, method="regularized", refine=refine,
                reaction_nodes=case.reaction, unknowns="young", poisson_ratio=nu, element=element,
            )  # fmt: skip
            seconds = time.process_time() - start
            error = np.abs(found.young / case.young - 1)[~case.known]
            print(
                f"| {nu} | {element} | {refine} | {np.nanmedian(found.young[inner]):.3f} | "
                f"{np.nanmedian(found.young[outer]):.3f} | "
                f"{np.nan_to_num(error, nan=1).mean():.3f} | {seconds:.1f} |",
                flush=True,
            )


def large(args):
    print(HEAD)
    Body(args, "tetra", (24, 24, 32), 0.45).row("ν 0.45, box, clamped", "cell")
    print(f"peak memory {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20:.1f} GiB")


SECTIONS = {f.__name__: f for f in (label, cell, graded, other, plane, label25, cell25, large)}


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("section", nargs="*", default=["label", "cell", "other", "plane"])
    parser.add_argument("--truth", type=int, default=16, help="bricks per side of the truth")
    args = parser.parse_args()
    for name in args.section:
        print(f"\n### {name}")
        SECTIONS[name](args)


if __name__ == "__main__":
    main()
