"""The push that needs no scikit-fem agrees with the one that does."""

import numpy as np
from elastoidentify.imaging.phantom.push import solve_pushes
from elastoidentify.imaging.phantom.push_quads import solve_pushes_on_quads


def moduli(x, y):
    young = np.full(np.shape(x), 3000.0)
    young[np.hypot(x - 66, y - 72) < 18] = 9000.0
    young[np.asarray(y) < 30] = 5000.0
    return young, np.full(np.shape(x), 0.45)


def test_linear_quads_agree_with_quadratic_ones_to_one_percent_of_the_push():
    pushes = np.array([[0.0, 6.0], [4.2, 4.2]])
    quadratic = solve_pushes(120, 120, 14, moduli, pushes, elements=40)
    linear = solve_pushes_on_quads(120, 120, 14, moduli, pushes, elements=80)
    inside = np.stack(np.meshgrid(*[np.linspace(1, 119, 50)] * 2), -1).reshape(-1, 2)
    for one, other in zip(quadratic, linear, strict=True):
        assert np.abs(one(inside) - other(inside)).max() < 0.01 * np.abs(one(inside)).max()
