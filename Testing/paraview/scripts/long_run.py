"""A run that takes long; says when it has begun."""

from elastoidentify.filters.base import Filter
from paraview.simple import *  # noqa: F403

phantom = PushingPhantom(Resolution=32, Noise=1e-6)  # noqa: F405
phantom.UpdatePipeline()
report = Filter._report


def told(self, fraction, text):
    if fraction > 0:
        print("under way", flush=True)
    report(self, fraction, text)


Filter._report = told
try:
    LameIdentification(Input=phantom, Method="regularized").UpdatePipeline()  # noqa: F405
except Exception as error:
    print("ended:", error)
