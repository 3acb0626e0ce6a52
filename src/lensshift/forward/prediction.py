"""Frames that a finished HR image predicts: plain data, which pickle and fit into a file."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lensshift.core.arrays import Array
from lensshift.core.units import PhaseScale
from lensshift.forward.blur import Blur
from lensshift.forward.model import forward_model


@dataclass(frozen=True, slots=True, eq=False)
class FramePredictor:
    """LR frames of one HR image; a call takes the number of a frame or an offset (row, col).

    Parameters
    ----------
    image : [row col] on the HR grid
    scale : HR pixels per LR pixel
    blur : the pixel response
    offset_px : [frame 2] of every frame of the burst, used or held out
    gain, bias : [frame]
    shift_field_px : [frame row col 2] instead of `offset_px`, or None
    spot_px2 : [frame row col 2] variance of the spot beyond that of `blur`, or None
    """

    image: Array
    scale: int
    blur: Blur
    offset_px: NDArray[np.float64]
    gain: NDArray[np.float64]
    bias: NDArray[np.float64]
    shift_field_px: NDArray[np.float64] | None = None
    spot_px2: NDArray[np.float64] | None = None

    @property
    def lr_shape(self) -> tuple[int, int]:
        """(rows, cols) of a frame."""
        rows, cols = self.image.shape
        return rows // self.scale, cols // self.scale

    def __call__(self, frame: int | ArrayLike) -> Array:
        """Return the frame [row col] of that number, or with gain 1 at that offset."""
        if np.ndim(frame) == 1:
            return self._at(np.asarray(frame, dtype=np.float64))
        number = int(np.asarray(frame))
        if not 0 <= number < len(self.offset_px):
            raise ValueError(
                f"expected a frame from 0 to {len(self.offset_px) - 1} or an offset (row, col), "
                f"got {frame!r}"
            )
        one, field, spot = slice(number, number + 1), self.shift_field_px, self.spot_px2
        model = forward_model(
            self.lr_shape, self.scale, self.offset_px[one] if field is None else None,
            shift_field_px=None if field is None else field[one],
            spot_px2=None if spot is None else spot[one],
            blur=self.blur, gain=self.gain[one], bias=self.bias[one],
        )  # fmt: skip
        return np.asarray(model.predict(self.image)[0])

    def _at(self, offset_px: NDArray[np.float64]) -> Array:
        """Return the frame at an offset (row, col); the spot is the mean of those of all frames."""
        if self.spot_px2 is None or offset_px.shape != (2,):
            model = forward_model(self.lr_shape, self.scale, offset_px[None], blur=self.blur)
            return np.asarray(model.predict(self.image)[0])
        model = forward_model(
            self.lr_shape, self.scale,
            shift_field_px=np.broadcast_to(offset_px, (1, *self.lr_shape, 2)),
            spot_px2=self.spot_px2.mean(axis=0)[None], blur=self.blur,
        )  # fmt: skip
        return np.asarray(model.predict(self.image)[0])


@dataclass(frozen=True, slots=True, eq=False)
class PhasorPredictor:
    """One channel of frames of phasors.

    Parameters
    ----------
    phasor : of an HR image of phasors
    distance : how phases stand for distances, or None for the amplitude
    """

    phasor: FramePredictor
    distance: PhaseScale | None = None

    def __call__(self, frame: int | ArrayLike) -> Array:
        """Return the frame [row col] of that number or at that offset, as `FramePredictor`."""
        seen = self.phasor(frame)
        return np.abs(seen) if self.distance is None else self.distance.distance_m(np.angle(seen))
