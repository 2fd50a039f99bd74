"""Where the time of registering volumes goes: `python Testing/benchmarks/registration_volume.py`.

Phantoms as docs/registration.md describes them, three pushes, one mesh of the same number of
tetrahedra in each. Elastix runs in a process of its own and is timed by the clock, all else by
processor time; everything is a ratio to the median way forth of the smallest volume. Some minutes.
"""

import argparse
import time
from collections import defaultdict

import numpy as np
from elastoidentify.imaging.meshing import mesh_segmentation
from elastoidentify.imaging.phantom import make_phantom_volume
from elastoidentify.imaging.registration import registration

CELLS_ACROSS = 8  # edges along the block
PARTS = {
    "way forth": ("_pair", time.perf_counter),
    "way back": ("_pair", time.perf_counter),
    "second step": ("_measured", time.process_time),
    "information and figures": ("_judge", time.process_time),
}


class Clock:
    """Times the parts of a registration by standing around the methods that do them."""

    def __init__(self):
        self.seconds = defaultdict(list)
        self.own = {name: getattr(registration._Work, name) for name, _ in PARTS.values()}

    def __enter__(self):
        for part, (name, clock) in PARTS.items():
            if part != "way back":
                setattr(registration._Work, name, self.timed(part, self.own[name], clock))
        return self

    def __exit__(self, *error):
        for name, method in self.own.items():
            setattr(registration._Work, name, method)

    def timed(self, part, method, clock):
        def around(work, *given, **more):
            start = clock()
            result = method(work, *given, **more)
            returns = part == "way forth" and given[-1] is False  # without a warped image
            self.seconds["way back" if returns else part].append(clock() - start)
            return result

        return around


def registered(voxels, workers):
    """Register the phantom. Returns the parts' median seconds, those of all, cells and error."""
    made = make_phantom_volume(voxels=voxels, elements=12, hidden=True, width=voxels)
    mesh = mesh_segmentation(
        made.segmentation, voxels / CELLS_ACROSS, rigid_labels=made.rigid_labels
    )
    with Clock() as clock:
        start = time.perf_counter()
        found = registration.register(
            made.rest, made.pushed, mesh.points, mesh.cells,
            reaction_nodes=mesh.reaction_nodes, workers=workers,
        )  # fmt: skip
        whole = time.perf_counter() - start
    error = found.displacements - made.displacements(mesh.points)
    parts = {part: float(np.median(clock.seconds[part])) for part in PARTS}
    parts["three trials"] = whole
    return parts, len(mesh.cells), float(np.sqrt((error**2).mean()))


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--voxels", type=int, nargs="*", default=[64, 128])
    parser.add_argument("--workers", type=int, nargs="*", default=[1, 2])
    args = parser.parse_args()
    unit = None
    print("| voxels, block | at once | cells | error, voxels | " + " | ".join(PARTS), end="")
    print(" | three trials |\n|" + "---|" * (5 + len(PARTS)))
    for voxels in args.voxels:
        for workers in args.workers:
            parts, cells, error = registered(voxels, workers)
            unit = unit or parts["way forth"]
            row = " | ".join(f"{seconds / unit:.2f}" for seconds in parts.values())
            print(f"| {voxels}³ | {workers} | {cells} | {error:.3f} | {row} |", flush=True)


if __name__ == "__main__":
    main()
