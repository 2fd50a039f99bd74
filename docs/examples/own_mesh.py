"""Your own mesh and displacements, with numpy and scipy only

The square of the source paper: 32 triangles, the upper half known, two large pushes. With exact
displacements the Lamé constants come out to round-off; with noise of 0.02 % of the push every
value comes with its standard deviation.
"""

import numpy as np
from elastoidentify import identify
from elastoidentify.examples.paper import POISSON, YOUNG, example, pushed
from matplotlib import pyplot as plt

square = example()
exact = pushed(square, row=0, kinematics="neo-hookean")
noisy = exact + np.random.default_rng(1).normal(0, 5e-6, exact.shape)  # m

options = {
    "known": {2: (YOUNG, POISSON)},
    "labels": square.labels,
    "reaction_nodes": square.floor | square.top,
    "kinematics": "neo-hookean",
}
unknown = square.labels == 1

found = identify(square.points, square.cells, exact, method="global", **options)
off = np.abs(found.mu / square.mu - 1)[unknown].max()
print(f"exact displacements: all {unknown.sum()} values of μ right to 1e-6: {off < 1e-6}")

options |= {"method": "regularized", "element": "linear", "refine": 1}  # as the data were made
found = identify(square.points, square.cells, noisy, **options)
off = (found.mu - square.mu)[unknown]
print(f"noise of 0.005 mm: error of μ {100 * np.std(off / square.mu[unknown]):.1f} %")
share = np.mean(np.abs(off) < 2 * found.mu_std[unknown])
print(f"the truth lies within two standard deviations in {100 * share:.0f} % of the cells")

shown = plt.tripcolor(*square.points.T, square.cells, facecolors=found.mu, edgecolor="k")
plt.colorbar(shown, label="μ (Pa), truth 1748")
plt.axis("equal")
plt.savefig("own_mesh.png")
