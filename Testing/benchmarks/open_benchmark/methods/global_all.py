"""This product's method "global", with its defaults."""

from . import _ours

TITLE = "Global (this product)"
SOURCE = 'elastoidentify.identify(method="global"), all options at their defaults'


def estimate(case):
    return _ours.identify(case, "global")
