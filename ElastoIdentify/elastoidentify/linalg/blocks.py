"""A sparse matrix made of blocks, over and over: where the entries go is found once."""

import numpy as np
import scipy.sparse as sp


class Blocks:
    """Puts blocks together, for as long as their patterns stay without looking for places again."""

    def __init__(self):
        self.patterns = []

    def __call__(self, rows: list[list]) -> sp.csc_matrix:
        """Return the matrix of rows of blocks (by columns or rows, None: empty), by columns.

        What is returned shares its pattern with the next one: its values may be changed only.
        """
        blocks = [block for row in rows for block in row if block is not None]
        if not self._alike(blocks):
            self._find_places(rows, blocks)
        data = np.concatenate([block.data for block in blocks])[self.places]
        return sp.csc_matrix((data, self.indices, self.indptr), self.shape)

    def _alike(self, blocks):
        return len(blocks) == len(self.patterns) and all(
            block.format == kind
            and np.array_equal(block.indptr, indptr)
            and np.array_equal(block.indices, indices)
            for block, (kind, indptr, indices) in zip(blocks, self.patterns, strict=True)
        )

    def _find_places(self, rows, blocks):
        ends = np.cumsum([block.nnz for block in blocks]).tolist()
        numbers = iter([np.arange(e - b.nnz, e) for e, b in zip(ends, blocks, strict=True)])

        def numbered(block):
            if block is None:
                return None
            return type(block)((next(numbers) + 1, block.indices, block.indptr), block.shape)

        whole = sp.bmat([[numbered(block) for block in row] for row in rows], format="csc")
        self.places, self.indices, self.indptr = whole.data - 1, whole.indices, whole.indptr
        self.shape = whole.shape
        self.patterns = [(b.format, b.indptr.copy(), b.indices.copy()) for b in blocks]
