"""How IRW-SR applies the forward model: by one convolution if the shifts allow it, else by taps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from lensshift.forward.model import ForwardModel
from lensshift.forward.sampling import (
    adjoint_field,
    adjoint_separable,
    forward_field,
    forward_separable,
)
from lensshift.reconstruction import irwsr_solvers as solvers
from lensshift.reconstruction.differences import Directions

Array = NDArray[Any]
Single = NDArray[np.float32]


class System(Protocol):
    """The forward model A of a burst, gain included, in single precision."""

    def residual(self, x: Single, y: Single, out: Single) -> None:
        """Write y - A x [frame row col] into out, for an HR image x [row col]."""
        ...

    def adjoint(self, y: Single, weight: Single, out: Single) -> None:
        """Write A^T W y [row col] into out, for frames and weights [frame row col]."""
        ...

    def solve(
        self, x: Single, r: Single, weight: Single, a: Single, directions: Directions,
        iterations: int,
    ) -> None:  # fmt: skip
        """Run conjugate gradients on (A^T W A + sum D^T a D) dx = r; x += dx."""
        ...


def fastest_system(model: ForwardModel) -> System:
    """Return the fastest way to apply a forward model.

    Shifts that put every LR pixel on an HR pixel make the burst one small convolution.
    """
    if model.on_hr_grid and bool(model.inside.all()) and bool(np.all(model.gain == 1.0)):
        return _interlaced(model)
    return _sampled(model)


def start_image(system: System, y: Single, weight: Single, hr_shape: tuple[int, int]) -> Single:
    """Return A^T W y / A^T w, and the mean of the frames where an HR pixel is hardly seen."""
    seen, total = np.empty(hr_shape, np.float32), np.empty(hr_shape, np.float32)
    system.adjoint(np.ones_like(weight), weight, seen)
    system.adjoint(y, weight, total)
    known = seen > 1e-3 * seen.max()
    mean = total.sum() / max(float(seen.sum()), 1e-30)
    return np.where(known, total / np.where(known, seen, 1), mean).astype(np.float32)


@dataclass(frozen=True, slots=True, eq=False)
class _Sampled:
    """Any shifts: taps for every frame, or for every LR pixel of a shift field.

    Parameters
    ----------
    taps : row start and weight, col start and weight; with one more axis for a shift field
    column_square : mean of the squares of the taps of an LR pixel
    work, frames : [3 row col] and [frame row col] work space
    """

    taps: tuple[Array, Single, Array, Single]
    column_square: float
    work: Single
    frames: Single
    ones: Single

    def residual(self, x: Single, y: Single, out: Single) -> None:
        """Write y - A x into out."""
        take = forward_field if self.taps[0].ndim == 3 else forward_separable
        take(x, *self.taps, out)
        np.subtract(y, out, out=out)

    def adjoint(self, y: Single, weight: Single, out: Single) -> None:
        """Write A^T W y into out."""
        spread = adjoint_field if self.taps[0].ndim == 3 else adjoint_separable
        spread(np.multiply(y, weight, out=self.frames), *self.taps, out)

    def solve(
        self, x: Single, r: Single, weight: Single, a: Single, directions: Directions,
        iterations: int,
    ) -> None:  # fmt: skip
        """Run conjugate gradients on (A^T W A + sum D^T a D) dx = r; x += dx."""
        seen = self.work[3]
        self.adjoint(self.ones, weight, seen)
        solvers.solve_sampled(
            x, r, weight, *self.taps, seen, self.column_square, a, directions, iterations,
            self.work, self.frames,
        )  # fmt: skip


def _sampled(model: ForwardModel) -> _Sampled:
    gain = model.gain.reshape(-1, *(1,) * (model.rows.weight.ndim - 1))
    row, col = model.rows.weight, model.cols.weight
    square = float((row**2).sum(axis=-1).mean() * (col**2).sum(axis=-1).mean())
    shape = (model.frames, *model.lr_shape)
    return _Sampled(
        taps=(
            model.rows.start, (row * gain).astype(np.float32),
            model.cols.start, col.astype(np.float32),
        ),
        column_square=square * float(np.abs(model.gain).mean()),
        work=np.empty((4, *model.hr_shape), np.float32),
        frames=np.empty(shape, np.float32),
        ones=np.ones(shape, np.float32),
    )  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class _Interlaced:
    """Shifts that put every LR pixel on an HR pixel.

    With K the convolution with zeros outside and n = K 1, A x is K x / n at these HR pixels.

    Parameters
    ----------
    row_index, col_index : [frame row] and [frame col]
    kernel : [tap], symmetric
    column_square : sum of the squares of its outer product
    norm : [row col], 1 / n
    ones : [frame row col]
    work : [5 row col] work space
    """

    row_index: NDArray[np.int64]
    col_index: NDArray[np.int64]
    kernel: Single
    column_square: float
    norm: Single
    ones: Single
    work: Single

    def residual(self, x: Single, y: Single, out: Single) -> None:
        """Write y - A x into out."""
        solvers.interlaced_residual(
            x, self.kernel, self.norm, self.row_index, self.col_index, y, self.work[4], out
        )

    def adjoint(self, y: Single, weight: Single, out: Single) -> None:
        """Write A^T W y into out."""
        solvers.interlaced_adjoint(
            y, weight, self.kernel, self.norm, self.row_index, self.col_index, self.work[4], out
        )

    def solve(
        self, x: Single, r: Single, weight: Single, a: Single, directions: Directions,
        iterations: int,
    ) -> None:  # fmt: skip
        """Run conjugate gradients on (A^T W A + sum D^T a D) dx = r; x += dx."""
        solvers.solve_interlaced(
            x, r, self.ones, weight, self.kernel, self.norm, self.row_index, self.col_index,
            self.column_square, a, directions, iterations, self.work,
        )  # fmt: skip


def _interlaced(model: ForwardModel) -> _Interlaced:
    lattice = model.interlace
    kernel = lattice.kernel.astype(np.float32)
    norm = np.empty(model.hr_shape, np.float32)
    solvers.convolve(np.ones(model.hr_shape, np.float32), kernel, norm)
    return _Interlaced(
        row_index=np.ascontiguousarray(lattice.row_index),
        col_index=np.ascontiguousarray(lattice.col_index),
        kernel=kernel,
        column_square=float((kernel**2).sum() ** 2),
        norm=np.reciprocal(norm, out=norm),
        ones=np.ones((model.frames, *model.lr_shape), np.float32),
        work=np.empty((5, *model.hr_shape), np.float32),
    )
