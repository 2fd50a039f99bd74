"""Image volumes with a ball that no label shows, to a map of every cell; figures and picture.

    python Testing/benchmarks/volume_images.py --cache FOLDER            # some minutes
    python Testing/benchmarks/volume_images.py --edge 6 8 --exact --picture volume.png

A block with a texture stands on a floor; a pad of known stiffness pushes it three times, by 5 % of
its height straight and obliquely; 2 % Rician noise. A ball three times as stiff as the tissue is in
the push (quadratic bricks, which no identification uses) and in no label. Every cell has its own E,
ν is known. `--exact` adds the true displacements, with an error of `--error` voxels at every node,
in place of registered ones: what is left then is no error of images. A cell belongs to the ball if
its centre does; medians are over all of its cells, also those that the ball's surface cuts.
"""

import argparse
import time
from itertools import combinations
from pathlib import Path

import numpy as np
from elastoidentify.imaging.phantom import Ball, make_phantom_volume
from elastoidentify.pipeline import cell_blocks, make_mesh, run
from elastoidentify.report.picture import section
from elastoidentify.report.terminal import TerminalProgress
from elastoidentify.study import Study

PAD, TISSUE, CONTRAST = 1, 3000.0, 3.0
STIFF = np.sqrt(CONTRAST) * TISSUE  # cells above it are taken for the ball
COLUMNS = (
    "voxels across", "edge, voxels", "cells", "displacements", "unknowns", "ball (9 kPa)",
    "tissue (3 kPa)", "mean error", "flat guess", "within 2 std", "overlap with the ball (Dice)",
    "error of displacements, voxels", "noise", "seconds",
)  # fmt: skip
HEAD = f"\n| {' | '.join(COLUMNS)} |\n{'|---' * len(COLUMNS)}|"


def phantom_of(args, voxels):
    """Return the phantom and its ball."""
    ball = Ball(0.5, 0.5, 0.4, args.radius, CONTRAST)
    with TerminalProgress("phantom") as progress:
        made = make_phantom_volume(
            args.texture, balls=[ball], hidden=True, voxels=voxels, elements=args.elements,
            noise=args.noise, width=voxels, seed=args.seed, progress=progress,
        )  # fmt: skip
    return made, ball


def study_of(args, made, edge):
    material = made.materials[PAD]
    given = {"poisson_ratio": material.poisson} if args.unknowns == "young" else {}
    return Study(
        segmentation=made.segmentation, rest=made.rest, pushed=made.pushed,
        edge_length=edge * made.rest.spacing[0], rigid_labels=made.rigid_labels,
        known_materials={PAD: (material.young, material.poisson)},
        unknowns=args.unknowns, grouping="cell", method="regularized", cache=args.cache, **given,
    )  # fmt: skip


class Found:
    """A map beside its truth; `E` is the one that follows from μ with the true ν."""

    def __init__(self, made, ball, mesh, result):
        self.mesh, self.result, self.made = mesh, result, made
        self.centre = np.array([ball.x, ball.y, ball.z]) * made.frame.size
        self.radius = ball.radius * made.frame.size[0]
        self.points = made.frame.to_body(mesh.points)
        centres = self.points[mesh.cells].mean(axis=1)
        self.inside = np.linalg.norm(centres - self.centre, axis=1) < self.radius
        self.unknown = mesh.labels != PAD
        self.E = 2 * (1 + made.materials[PAD].poisson) * result.mu
        self.true = np.where(self.inside, CONTRAST * TISSUE, TISSUE)

    def row(self):
        tissue = self.unknown & ~self.inside
        error = np.nan_to_num(np.abs(self.E / self.true - 1), nan=1.0)[self.unknown].mean()
        flat = np.abs(self.made.materials[PAD].young / self.true - 1)[self.unknown].mean()
        off = np.abs(np.log(self.E / self.true)) * self.result.mu
        off[self.unknown] /= self.result.mu_std[self.unknown]
        stiff = self.unknown & (self.E > STIFF)
        dice = 2 * (stiff & self.inside).sum() / (stiff.sum() + self.inside.sum())
        return (
            f"{np.nanmedian(self.E[self.inside]) / 1e3:.2f} | "
            f"{np.nanmedian(self.E[tissue]) / 1e3:.2f} | {error:.3f} | {flat:.3f} | "
            f"{(off < 2)[self.unknown].mean():.1%} | {dice:.2f}"
        )


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("--voxels", type=int, nargs="*", default=[64], help="across the block")
    add("--edge", type=float, nargs="*", default=[8.0], help="edge length in voxels")
    add("--radius", type=float, default=0.25, help="of the ball, in widths of the block")
    add("--noise", type=float, default=0.02)
    add("--seed", type=int, default=0)
    add("--elements", type=int, default=16, help="bricks across the phantom")
    add("--image", help="texture: a volume, or mni; speckle by default")
    add("--unknowns", choices=("young", "lambda-mu"), default="young")
    add("--exact", action="store_true", help="true displacements, too")
    add("--error", type=float, default=0.05, help="added to true displacements, in voxels")
    add("--cache", help="folder that keeps registrations")
    add("--picture", type=Path, help="of the last map from images")
    args = parser.parse_args()
    args.texture = texture(args.image)
    print(HEAD, flush=True)
    for voxels in args.voxels:
        made, ball = phantom_of(args, voxels)
        for edge in args.edge:
            study = study_of(args, made, edge)
            mesh = make_mesh(study)
            exact = made.displacements(mesh.points)
            for source in ("images", "true")[: 1 + args.exact]:
                start, given = time.process_time(), {}
                if source == "true":
                    error = args.error * made.rest.spacing[0]
                    noise = np.random.default_rng(0).normal(0, error, exact.shape)
                    given = {"displacements": exact + noise}
                with TerminalProgress(source) as progress:
                    outcome = run(study, mesh=mesh, progress=progress, **given)
                found = Found(made, ball, mesh, outcome.result)
                miss = (outcome.displacements - exact) / made.rest.spacing[0]
                print(
                    f"| {voxels} | {edge:g} | {len(mesh.cells)} | {source} | {args.unknowns} | "
                    f"{found.row()} | {np.sqrt((miss**2).mean()):.3f} | "
                    f"{outcome.result.report['noise_scale']:.2f} | "
                    f"{time.process_time() - start:.0f} |",
                    flush=True,
                )
                print(outcome.result.report["verdict"]["sentence"], flush=True)
                if source == "images" and args.picture:
                    draw(args.picture, found)


def texture(name):
    if name is None:
        return None
    from elastoidentify.imaging.io import read_image
    from elastoidentify.imaging.phantom.texture import mni152_path

    return read_image(mni152_path() if name == "mni" else name)


# ---- the picture

NAMES = "xyz"


def draw(path: Path, found: Found):
    """Three cuts through the ball's centre, image and map, and the stiff cells in space."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(14, 7), layout="constrained", dpi=110)
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(2, 4)
    for column, normal in enumerate((2, 1, 0)):
        across = [axis for axis in range(3) if axis != normal]
        for row in range(2):
            axes = figure.add_subplot(grid[row, column])
            if row == 0:
                rest_cut(axes, found, normal, across)
            else:
                patches = map_cut(axes, found, found.E / 1e3, normal, across, "viridis", 12.0)
            circle(axes, found, across)
            x, y = (found.made.frame.size[axis] for axis in across)
            axes.set(xlim=(-0.05 * x, 1.05 * x), ylim=(-0.05 * y, 1.05 * y), aspect="equal")
            axes.set(xlabel=f"{NAMES[across[0]]} (mm)", ylabel=f"{NAMES[across[1]]} (mm)")
            axes.set_title(f"{('image at rest', 'E found')[row]}, cut across {NAMES[normal]}")
    figure.colorbar(patches, ax=axes, label="E (kPa); given in the pad", shrink=0.8)
    in_space(figure.add_subplot(grid[0, 3], projection="3d"), found)
    axes = figure.add_subplot(grid[1, 3])
    std = 100 * found.result.mu_std / found.result.mu
    patches = map_cut(axes, found, np.where(found.unknown, std, np.nan), 1, [0, 2], "magma_r", None)
    circle(axes, found, [0, 2])
    axes.set(aspect="equal", xlabel="x (mm)", ylabel="z (mm)", title="its standard deviation")
    figure.colorbar(patches, ax=axes, label="% of E", shrink=0.8)
    figure.savefig(path)


def rest_cut(axes, found, normal, across):
    frame, rest = found.made.frame, found.made.rest
    index = round(found.centre[normal] / frame.spacing[normal] + frame.margin[normal] - 0.5)
    array = rest.array.take(index, axis=2 - normal)
    ends = [
        (-m * s, (n + m) * s)
        for n, m, s in zip(frame.voxels, frame.margin, frame.spacing, strict=True)
    ]
    extent = (*ends[across[0]], *ends[across[1]])
    axes.imshow(array, cmap="gray", extent=extent, origin="lower", vmax=np.percentile(array, 99.5))


def map_cut(axes, found, values, normal, across, colours, high):
    from matplotlib.collections import PolyCollection

    blocks = cell_blocks(found.mesh.cells)
    points, corners, numbers = section(found.points, blocks, found.centre, np.eye(3)[normal])
    shown = np.isfinite(values[numbers])
    polygons = [points[c][:, across] for c, s in zip(corners, shown, strict=True) if s]
    values = values[numbers][shown]
    patches = PolyCollection(polygons, cmap=colours, edgecolors="face", linewidths=0.4)
    patches.set(array=values, clim=(0, np.percentile(values, 98) if high is None else high))
    axes.add_collection(patches)
    return patches


def circle(axes, found, across):
    from matplotlib.patches import Circle

    style = {"fill": False, "edgecolor": "white", "linestyle": "--"}
    axes.add_patch(Circle(found.centre[across], found.radius, **style))


def in_space(axes, found):
    """The surface of the cells that are stiffer than the mean of tissue and ball, and the ball."""
    import matplotlib
    from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection

    stiff = found.unknown & (found.E > STIFF)
    cells = found.mesh.cells[stiff]
    faces = np.vstack([cells[:, list(face)] for face in combinations(range(4), 3)])
    owner = np.tile(np.flatnonzero(stiff), 4)
    _, first, uses = np.unique(
        np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True
    )
    outer = first[uses == 1]
    corners = found.points[faces[outer]]
    colours = matplotlib.colormaps["viridis"](found.E[owner[outer]] / 12e3)
    axes.add_collection3d(
        Poly3DCollection(corners, facecolors=colours, edgecolors="0.3", linewidths=0.2)
    )
    turn = np.linspace(0, 2 * np.pi, 60)
    for normal in range(3):
        ring = np.zeros((60, 3))
        ring[:, [a for a in range(3) if a != normal]] = np.column_stack(
            [np.cos(turn), np.sin(turn)]
        )
        axes.plot(*(found.centre + found.radius * ring).T, "k--", linewidth=1)
    size = found.made.frame.size
    ends = np.array(np.meshgrid(*[(0, 1)] * 3)).reshape(3, -1).T
    pairs = [(a, b) for a, b in combinations(ends, 2) if np.abs(a - b).sum() == 1]
    axes.add_collection3d(Line3DCollection(np.array(pairs) * size, colors="0.6", linewidths=0.8))
    axes.set(xlim=(0, size[0]), ylim=(0, size[1]), zlim=(0, size[2]), aspect="equal")
    axes.set(xlabel="x", ylabel="y", zlabel="z", title="cells stiffer than √3 × tissue")


if __name__ == "__main__":
    main()
