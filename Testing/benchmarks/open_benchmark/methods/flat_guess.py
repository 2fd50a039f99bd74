"""No identification: everything is as stiff as the known cells are on average."""

import numpy as np

from ..problem import Estimate

TITLE = "Flat guess"
SOURCE = "the mean of the known cells' E"


def estimate(case):
    return Estimate(np.full(len(case.cells), np.nanmean(case.known[:, 0])))
