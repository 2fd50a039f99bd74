"""The demo with other slices, other noise, and a mesh that does not know of the inclusion.

`python Testing/benchmarks/demo_variations.py` prints the table of docs/demo.md. The contrast is the
median μ of the cells whose centre lies in the true inclusion over that of the tissue's.
"""

import argparse

import numpy as np
from elastoidentify.examples.demo import _identify, _measure
from elastoidentify.filters.registration import write_registration
from elastoidentify.imaging.io import read_image
from elastoidentify.imaging.phantom.planar import Phantom, make_phantom
from elastoidentify.imaging.phantom.texture import mni152_path, slice_of
from elastoidentify.imaging.registration.registration import Registration
from elastoidentify.vtk_io.convert import get_array, mesh_points
from elastoidentify.vtk_io.convert import simplices as cells_of

VARIATIONS = ((92, 0, True), (75, 1, True), (110, 2, True), (92, 0, False))  # slice, seed, told
HEAD = """
| slice | segmentation | displacements | RMS error, px | contrast per cell | contrast per label |
|---|---|---|---|---|---|"""


def contrast(made: Phantom, grid) -> float:
    """Median μ in the true inclusion over that in the true tissue, by the cells' centres."""
    centres = mesh_points(grid)[cells_of(grid)].mean(axis=1)
    column, row, _ = np.rint(made.rest.world_to_index(centres)).astype(int).T
    true, mu = made.young.array[0][row, column], get_array(grid.GetCellData(), "Mu")
    young = [made.materials[made.label(name)].young for name in ("inclusion", "tissue")]
    inclusion, tissue = (np.nanmedian(mu[np.isclose(true, one)]) for one in young)
    return float(inclusion / tissue)


def main() -> None:
    argparse.ArgumentParser(description=__doc__.splitlines()[0]).parse_args()
    print(HEAD)
    for index, seed, told in VARIATIONS:
        texture = slice_of(read_image(mni152_path()), index=index)
        made = make_phantom(texture, kinematics="neo-hookean", seed=seed)
        if not told:
            labels = made.segmentation.array
            labels[labels == made.label("inclusion")] = made.label("tissue")
        grid = _measure(made, 12.0)
        names = "pad, tissue, inclusion" if told else "pad and tissue only"
        exact = made.displacements(mesh_points(grid))
        for source in ("images", "exact") if (index, told) == (92, True) else ("images",):
            if source == "exact":
                write_registration(grid, Registration(exact, (), None))
            number = range(1, len(exact) + 1)
            found = [get_array(grid.GetPointData(), f"Displacement_{n}") for n in number]
            error = np.sqrt(((found - exact) ** 2).sum(-1).mean()) / made.rest.spacing[0]
            groups = ("cell", "label") if told else ("cell",)
            values = [f"{contrast(made, _identify(made, grid, group)):.2f}" for group in groups]
            both = " | ".join([*values, "–"][:2])
            print(f"| {index} | {names} | {source} | {error:.2f} | {both} |", flush=True)


if __name__ == "__main__":
    main()
