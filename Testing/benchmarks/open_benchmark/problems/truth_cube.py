"""The Truth Cube: real silicone on CT, one layer known, the rest to be found alike."""

import hashlib
import os

import numpy as np

from ..problem import Case, Skip, Truth

TITLE = "Truth Cube"
SOURCE = (
    "Kerdok et al., Medical Image Analysis 7, 2003 (file of the OpenSurgSim repository, "
    "Apache-2.0; not in this repository): 343 beads in a cube of one silicone, 216 hexahedra, "
    "the uppermost layer known, last trial (18.25 %), ν = 0.48, neo-Hookean. Truth: E is that "
    "of the pad everywhere; so the flat guess is exact here, and the score is what a method "
    "makes of it."
)
LEVELS = ("as measured",)
QUICK = None
SHA256 = "046207017370b11e910fffc5a83a85901a1392ca45510dbcbf54f4a6be89efab"


def make(level):
    import truth_cube as cube_of  # of Testing/benchmarks

    folder = os.environ.get("ELASTOIDENTIFY_TRUTH_CUBE", cube_of.FOLDER)
    file = os.path.join(folder, "uniaxial_positions.csv")
    if not os.path.exists(file):
        raise Skip("uniaxial_positions.csv is in no folder named by ELASTOIDENTIFY_TRUTH_CUBE")
    with open(file, "rb") as one:
        if hashlib.sha256(one.read()).hexdigest() != SHA256:
            raise Skip("uniaxial_positions.csv is another file than the one this was written for")
    cube = cube_of.read_truth_cube(folder)
    pad = cube.index[:, 2] == 0
    known = np.where(pad[:, None], [cube_of.YOUNG, 0.48], np.nan)
    information = np.broadcast_to(np.diag(cube_of.NOISE**-2.0), (1, len(cube.points), 3, 3))
    case = Case(
        cube.points, "hexahedron", cube.cells, cube.displacements[2:], cube.outside, known, 0.48,
        kinematics="neo-hookean", information=np.array(information),
    )  # fmt: skip
    return case, Truth(np.full(len(pad), cube_of.YOUNG), np.full(len(pad), 0.48))
