"""This product's method "regularized", with its defaults."""

from . import _ours

TITLE = "Regularized (this product)"
SOURCE = 'elastoidentify.identify(method="regularized"), all options at their defaults'


def estimate(case):
    return _ours.identify(case, "regularized")
