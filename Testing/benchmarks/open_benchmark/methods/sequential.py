"""This product's method "sequential", with its defaults."""

from . import _ours

TITLE = "Sequential (this product)"
SOURCE = 'elastoidentify.identify(method="sequential"), all options at their defaults'


def estimate(case):
    return _ours.identify(case, "sequential")
