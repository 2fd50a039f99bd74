"""Quality of the meshes, beside gmsh where it is installed: `python Testing/benchmarks/meshing.py`.

gmsh (`pip install gmsh`; GPL) gets the same smooth borders, cut at the same places, so that the two
differ in what lies between the borders only. Times are processor times, the least of three, as
ratios to one Delaunay triangulation of as many random points: that takes the machine out of them.
"""

import argparse
import importlib.util
import sys
import time
from functools import partial
from pathlib import Path

import numpy as np
from elastoidentify.fem.assembly import tangent_stiffness
from elastoidentify.fem.constitutive import SmallStrain
from elastoidentify.fem.mesh import make_mesh
from elastoidentify.imaging.image import Image
from elastoidentify.imaging.meshing import mesh_segmentation
from elastoidentify.imaging.meshing.interfaces import build_network
from elastoidentify.imaging.meshing.quality import (
    dihedral_angles,
    tetrahedron_volumes,
    triangle_angles,
    triangle_areas,
)
from elastoidentify.imaging.meshing.tetrahedra import mesh_tetrahedra
from elastoidentify.imaging.meshing.triangles import mesh_triangles
from scipy.ndimage import gaussian_filter
from scipy.sparse.linalg import splu
from scipy.spatial import Delaunay

sys.path.insert(0, str(Path(__file__).parents[1] / "imaging"))
import test_meshing as planar
import test_meshing_volume as volume

PLANAR = {
    "nested blobs, 512²": (planar.nested_blobs(), 6.0),
    "twelve sectors": (planar.wheel(12), 8.0),
    "twelve cells": (planar.cells_of_voronoi(12), 8.0),
    "layered block": (planar.layered_block(), 8.0),
}
VOLUMES = {
    "nested blobs, 128³": (volume.nested_blobs(), 6.0),
    "layered block": (volume.layered_block(), 5.0),
    "twelve cells": (volume.seeds(12), 5.0),
}
ROW = "| {:<20} | {:<18} | {:>6} | {:>5.1f}° | {:>5.1f}° | {:>5.1f}° | {:>6.2f} % | {:>5} |"
HEAD = """
| image                | mesher             |  cells | least  | 1 %    | mean   | error    | time  |
|----------------------|--------------------|--------|--------|--------|--------|----------|-------|"""


def timed(work, times: int = 3):
    """Return what `work` returns, and the least processor time that it took, in seconds."""
    seconds = []
    for _ in range(times):
        start = time.process_time()
        result = work()
        seconds.append(time.process_time() - start)
    return result, min(seconds)


def unit_of_time(points: np.ndarray) -> float:
    """Return the seconds of one Delaunay triangulation of as many points."""
    random = np.random.default_rng(0).uniform(size=points.shape)
    return timed(lambda: Delaunay(random), 10)[1]


def row(image: str, mesher: str, labels, points, cells, cell_labels, seconds) -> str:
    """Return one line: cells, smallest angles per cell, largest error of a label's size, time."""
    flat = cells.shape[1] == 3
    angles, sizes = (
        (triangle_angles, triangle_areas) if flat else (dihedral_angles, tetrahedron_volumes)
    )
    least = angles(points, cells).min(axis=1)
    size = np.abs(sizes(points, cells))
    voxels = {k: (labels == k).sum() for k in np.unique(labels[labels > 0])}
    error = max(abs(size[cell_labels == k].sum() / n - 1) for k, n in voxels.items())
    ratio = f"{seconds / unit_of_time(points):.0f}"
    numbers = least.min(), np.percentile(least, 1), least.mean(), 100 * error
    return ROW.format(image, mesher, len(cells), *numbers, ratio)


def gmsh_triangles(labels: np.ndarray, edge: float):
    """Mesh the same borders with gmsh's frontal Delaunay method; label cells by the voxel under."""
    import gmsh

    network = build_network(labels, np.ones(2), edge)
    points, segments, _ = network.sample()
    gmsh.initialize(interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.option.setNumber("Mesh.Algorithm", 6)
    low, high = points.min(axis=0) - 2 * edge, points.max(axis=0) + 2 * edge
    frame = np.array([low, [high[0], low[1]], high, [low[0], high[1]]])
    corners = np.vstack([points, frame])
    tags = [gmsh.model.geo.addPoint(x, y, 0, edge) for x, y in corners]
    lines = [gmsh.model.geo.addLine(tags[a], tags[b]) for a, b in segments]
    rim = [gmsh.model.geo.addLine(tags[-4 + k], tags[-4 + (k + 1) % 4]) for k in range(4)]
    for line in lines:
        gmsh.model.geo.mesh.setTransfiniteCurve(line, 2)
    surface = gmsh.model.geo.addPlaneSurface([gmsh.model.geo.addCurveLoop(rim)])
    gmsh.model.geo.synchronize()
    gmsh.model.mesh.embed(1, lines, 2, surface)
    gmsh.model.mesh.generate(2)
    nodes, places, _ = gmsh.model.mesh.getNodes()
    number = np.zeros(int(nodes.max()) + 1, int)
    number[nodes.astype(int)] = np.arange(len(nodes))
    cells = number[gmsh.model.mesh.getElementsByType(2)[1].astype(int)].reshape(-1, 3)
    gmsh.finalize()
    points = places.reshape(-1, 3)[:, :2]
    column, row_ = np.rint(points[cells].mean(axis=1)).astype(int).T
    inside = (column >= 0) & (row_ >= 0) & (column < labels.shape[1]) & (row_ < labels.shape[0])
    found = np.zeros(len(cells), int)
    found[inside] = labels[row_[inside], column[inside]]
    return points, cells[found > 0], found[found > 0]


def ragged_labels(noise: float, count: int = 5) -> np.ndarray:
    """Return 128³ voxels of random smooth labels, their borders torn by noise."""
    random = np.random.default_rng(0)
    fields = np.stack(
        [gaussian_filter(random.standard_normal((128,) * 3), 6.0) for _ in range(count)]
    )
    fields = fields / fields.std() + noise * random.standard_normal(fields.shape)
    return fields.argmax(axis=0) + 1


def forward_seconds(points: np.ndarray, cells: np.ndarray) -> float:
    """Return the processor time of one linear forward solution, top and bottom held."""
    mesh, ones = make_mesh(points, cells), np.ones(len(cells))
    held = np.isin(points[:, 2], [points[:, 2].min(), points[:, 2].max()])
    free = np.flatnonzero(~np.repeat(held, 3))

    def solve():
        stiffness = tangent_stiffness(mesh, SmallStrain(), np.zeros_like(points), ones, ones)
        inner = stiffness[free][:, free].tocsc()
        options = {"permc_spec": "MMD_AT_PLUS_A", "options": {"SymmetricMode": True}}
        return splu(inner, **options).solve(np.ones(len(free)))

    return timed(solve, 1)[1]


def against_forward_solutions():
    """Print the time of meshing a volume of five labels over that of a forward solution."""
    for noise in (0.0, 0.3):
        image = Image(ragged_labels(noise))
        mesh, seconds = timed(partial(mesh_segmentation, image, 9.0), 1)
        ratio = seconds / forward_seconds(mesh.points, mesh.cells)
        print(f"noise {noise:g}: {len(mesh.cells)} tetrahedra in {ratio:.2g} forward solutions")


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--ragged", action="store_true", help="volumes over forward solutions only")
    if parser.parse_args().ragged:
        return against_forward_solutions()
    meshers = {"ElastoIdentify": lambda labels, edge: mesh_triangles(labels, np.ones(2), edge)}
    if importlib.util.find_spec("gmsh"):
        meshers["gmsh"] = gmsh_triangles
    print("Triangles: angles of the cells, largest error of a label's area" + HEAD)
    for image, (labels, edge) in PLANAR.items():
        for mesher, mesh in meshers.items():
            result, seconds = timed(partial(mesh, labels, edge))
            print(row(image, mesher, labels, *result, seconds), flush=True)
    print("\nTetrahedra: dihedral angles, largest error of a label's volume" + HEAD)
    for image, (labels, edge) in VOLUMES.items():
        result, seconds = timed(partial(mesh_tetrahedra, labels, np.ones(3), edge))
        print(row(image, "ElastoIdentify", labels, *result, seconds), flush=True)


if __name__ == "__main__":
    main()
