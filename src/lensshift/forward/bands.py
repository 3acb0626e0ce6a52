"""Separable sampling of large pictures, a band of rows on each core.

Every number is computed as by `sampling` from the same numbers in the same order: pictures do not
depend on the cores.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from lensshift.core.arrays import Array
from lensshift.core.threads import bands, core_count, on_threads
from lensshift.forward.sampling import (
    Starts,
    adjoint_separable,
    forward_separable,
    sample_frame,
    spread_frame,
)

WORTH_THREADS = 2**16  # LR pixels of all frames: below, waking a thread takes as long as the work


def forward_banded(
    x: Array,
    row_start: Starts,
    row_weight: Array,
    col_start: Starts,
    col_weight: Array,
    col_run: Starts,
    out: Array,
) -> None:
    """Do what `forward_separable` does."""
    if out.size < WORTH_THREADS or core_count() < 2:
        forward_separable(x, row_start, row_weight, col_start, col_weight, col_run, out)
        return

    def sample(first: int, last: int) -> None:
        for k in range(len(out)):
            rows = slice(first, last)
            sample_frame(
                x, row_start[k, rows], row_weight[k, rows], col_start[k], col_weight[k],
                col_run[k], out[k, rows],
            )  # fmt: skip

    on_threads([partial(sample, *band) for band in bands(out.shape[1], core_count())])


def adjoint_banded(
    y: Array,
    row_start: Starts,
    row_weight: Array,
    col_start: Starts,
    col_weight: Array,
    col_run: Starts,
    out: Array,
) -> None:
    """Do what `adjoint_separable` does."""
    if y.size < WORTH_THREADS or core_count() < 2:
        adjoint_separable(y, row_start, row_weight, col_start, col_weight, col_run, out)
        return

    def spread(first: int, last: int) -> None:
        band = out[first:last]
        band[:] = 0
        for k in range(len(y)):
            touching = np.flatnonzero(
                (row_start[k] < last) & (row_start[k] + row_weight.shape[2] > first)
            )
            if touching.size:
                rows = slice(int(touching[0]), int(touching[-1]) + 1)
                starts = row_start[k, rows] - first
                starts.flags.writeable = False  # always: the kernels are compiled for one kind
                spread_frame(
                    y[k, rows], starts, row_weight[k, rows], col_start[k], col_weight[k],
                    col_run[k], band,
                )  # fmt: skip

    on_threads([partial(spread, *band) for band in bands(len(out), core_count())])
