"""Draw the pictures of meshing.md: `python docs/meshing_pictures.py` (needs matplotlib)."""

from itertools import combinations
from pathlib import Path

import matplotlib
import numpy as np

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from elastoidentify.imaging.image import Image
from elastoidentify.imaging.meshing import LabelMesh, mesh_segmentation
from matplotlib.colors import to_rgb
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

FOLDER = Path(__file__).parent / "pictures"
COLOURS = {1: "#e8c9a8", 2: "#c25b4e", 3: "#9dc3d9", 4: "#8d8d8d", 5: "#b7d3a8"}


def layered_block() -> Image:
    """A pad (3) on tissue (1) with an inclusion (2), on a rigid floor (4); voxels of 0.5 mm."""
    y, x = np.mgrid[:200, :160].astype(float)
    labels = np.zeros((200, 160), int)
    labels[20:60, 20:140] = 3
    labels[60:150, 20:140] = 1
    labels[150:170, 10:150] = 4
    labels[np.hypot(x - 80, y - 100) < 18] = 2
    return Image(labels, spacing=[0.5, 0.5, 1.0])


def layers() -> Image:
    """Layers of 1 and 2 mm that thin out towards the right, and an oblique border."""
    y, x = np.mgrid[:200, :160].astype(float)
    labels = np.where((x > 15) & (x < 145) & (y > 15) & (y < 185), 1, 0)
    inside = labels > 0
    labels[inside & (y > 60) & (y < 62)] = 2
    labels[inside & (np.abs(y - 100 - 8 * np.sin(x / 20)) < 2)] = 3
    labels[inside & (y > 140 + 0.25 * (x - 80))] = 5
    return Image(labels, spacing=[0.5, 0.5, 1.0])


def sectors() -> Image:
    """A disc of twelve sectors that meet in one point."""
    y, x = np.mgrid[:200, :160].astype(float)
    turn = (np.arctan2(y - 99.5, x - 79.5) / (2 * np.pi)) % 1
    inside = np.hypot(x - 79.5, y - 99.5) < 72
    return Image(np.where(inside, (turn * 12).astype(int) % 5 + 1, 0), spacing=[0.5, 0.5, 1.0])


def draw_plane(axes, mesh: LabelMesh, title: str):
    x, y = mesh.points[:, :2].T
    colours = matplotlib.colors.ListedColormap([COLOURS[k] for k in range(1, 6)])
    axes.tripcolor(x, y, mesh.cells, mesh.labels, cmap=colours, vmin=0.5, vmax=5.5)
    axes.triplot(x, y, mesh.cells, color="black", linewidth=0.4)
    held = mesh.reaction_nodes == 1
    axes.plot(x[held], y[held], "o", color="#1f3fd0", markersize=4)
    axes.set(title=title, xlabel="x (mm)", aspect="equal", xlim=(0, 80), ylim=(0, 100))
    axes.invert_yaxis()


def block_in_space() -> Image:
    """A volume: pad (3) on tissue (1) with a ball (2) in it, on a wider floor (4)."""
    z, y, x = np.mgrid[:56, :64, :72].astype(float)
    labels = np.zeros(z.shape, int)
    block = (np.abs(x - 36) < 26) & (np.abs(y - 32) < 22) & (z > 5) & (z < 52)
    labels[block] = 1
    labels[block & (z > 40)] = 3
    labels[(z > 1) & (z < 6) & (np.abs(x - 36) < 32) & (np.abs(y - 32) < 28)] = 4
    labels[np.sqrt((x - 36) ** 2 + (y - 32) ** 2 + (z - 22) ** 2) < 10] = 2
    return Image(labels)


def draw_half(axes, mesh: LabelMesh, title: str):
    """Draw the outer faces of the cells that lie behind the middle."""
    kept = mesh.points[mesh.cells].mean(axis=1)[:, 1] > 32
    cells, labels = mesh.cells[kept], mesh.labels[kept]
    faces = np.vstack([cells[:, list(face)] for face in combinations(range(4), 3)])
    owner = np.tile(labels, 4)
    _, first, uses = np.unique(
        np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True
    )
    rim = first[uses == 1]
    corners = mesh.points[faces[rim]]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    light = np.abs(normal @ [0.2, 0.9, 0.4]) / np.linalg.norm(normal, axis=1)
    colour = np.array([to_rgb(COLOURS[k]) for k in owner[rim]]) * (0.6 + 0.4 * light[:, None])
    axes.add_collection3d(
        Poly3DCollection(corners, facecolors=colour, edgecolors="black", linewidths=0.25)
    )
    low, high = mesh.points.min(axis=0), mesh.points.max(axis=0)
    axes.set(
        xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]),
        title=title, xlabel="x (mm)", ylabel="y (mm)", zlabel="z (mm)",
    )  # fmt: skip
    axes.set_box_aspect(high - low)
    axes.view_init(18, -70)


def small_disc() -> Image:
    """A pad (3) on tissue (1) with a small disc (2), as large as the image; voxels of 0.5 mm."""
    y, x = np.mgrid[:200, :160].astype(float)
    labels = np.where(y < 40, 3, 1)
    labels[np.hypot(x - 80, y - 120) < 12] = 2
    return Image(labels, spacing=[0.5, 0.5, 1.0])


def draw_graded():
    figure, axes = plt.subplots(1, 2, figsize=(9.5, 6.4), constrained_layout=True)
    for axis, grading in zip(axes, (1, 4), strict=True):
        mesh = mesh_segmentation(small_disc(), 2.0, grading=grading)
        draw_plane(axis, mesh, f"grading {grading}: {len(mesh.cells)} cells")
    axes[0].set_ylabel("y (mm)")
    figure.savefig(FOLDER / "meshing_graded.png", dpi=90)


def main():
    FOLDER.mkdir(exist_ok=True)
    figure, axes = plt.subplots(1, 3, figsize=(14, 6.6), constrained_layout=True)
    held = mesh_segmentation(layered_block(), 5.0, rigid_labels=[4])
    draw_plane(axes[0], held, "Edge 5 mm; the floor is rigid: reaction nodes (blue)")
    draw_plane(axes[1], mesh_segmentation(layers(), 5.0), "Edge 5 mm; layers of 0.5 and 2 mm")
    draw_plane(axes[2], mesh_segmentation(sectors(), 5.0), "Edge 5 mm; twelve sectors")
    axes[0].set_ylabel("y (mm)")
    figure.savefig(FOLDER / "meshing_planar.png", dpi=90)
    draw_graded()
    figure = plt.figure(figsize=(9, 7), constrained_layout=True)
    volume = mesh_segmentation(block_in_space(), 4.0)
    draw_half(figure.add_subplot(projection="3d"), volume, "Edge 4 mm, cut open")
    figure.savefig(FOLDER / "meshing_volume.png", dpi=90)


if __name__ == "__main__":
    main()
