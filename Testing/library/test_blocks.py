"""Matrices made of blocks again and again."""

import numpy as np
import scipy.sparse as sp
from elastoidentify.linalg.blocks import Blocks


def blocks(random, dense):
    """A symmetric matrix of 3 × 3 blocks, of which two are empty."""
    P, S, T = (sp.random_array((n, n), density=dense, rng=random) for n in (6, 4, 5))
    R, Q = (sp.random_array((n, 6), density=dense, rng=random).tocsr() for n in (4, 5))
    S, T = (sp.csc_matrix(one + one.T) for one in (S, T))
    return [[sp.csc_matrix(P + P.T), R.T, Q.T], [R, S, None], [Q, None, T]]


def test_blocks_are_put_where_bmat_puts_them_whether_their_patterns_stay_or_change():
    random, together = np.random.default_rng(0), Blocks()
    for dense in (0.5, 0.5, 0.3):
        rows = blocks(random, dense)
        for factor in (1.0, -2.0):
            rows = [[None if b is None else factor * b for b in row] for row in rows]
            whole = together(rows)
            assert whole.format == "csc"
            np.testing.assert_array_equal(whole.toarray(), sp.bmat(rows).toarray())


def test_what_is_returned_keeps_its_values_when_the_next_one_is_made():
    rows, together = blocks(np.random.default_rng(1), 0.5), Blocks()
    first = together(rows)
    before = first.toarray()
    together([[None if b is None else 2 * b for b in row] for row in rows])
    np.testing.assert_array_equal(first.toarray(), before)
