"""Frames that a finished HR image predicts: plain data, which pickle and fit into a file."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike

from lensshift.core.arrays import Array, Floats
from lensshift.core.stray_light import StrayLight
from lensshift.core.units import PhaseScale, unambiguous_range_m
from lensshift.forward.blur import Blur
from lensshift.forward.model import ForwardModel, forward_model


@dataclass(frozen=True, slots=True, eq=False)
class FramePredictor:
    """LR frames of one HR image; a call takes the number of a frame or an offset (row, col)."""

    image: Array  # [row col] on the HR grid
    scale: int  # HR pixels per LR pixel
    blur: Blur  # the pixel response
    offset_px: Floats  # [frame 2] of every frame of the burst, used or held out
    # [frame]
    gain: Floats
    bias: Floats
    shift_field_px: Floats | None = None  # [frame row col 2] instead of `offset_px`, or None
    # [frame row col 3] variances and covariance of the spot beyond that of `blur`, or None
    spot_px2: Floats | None = None
    skew_px3: Floats | None = None  # [frame row col 2] third central moment of that spot, or None
    # What is in the frames and not in the image, or None.
    stray_light: StrayLight | None = field(default=None, kw_only=True)

    @property
    def lr_shape(self) -> tuple[int, int]:
        """(rows, cols) of a frame."""
        rows, cols = self.image.shape
        return rows // self.scale, cols // self.scale

    def __call__(self, frame: int | ArrayLike) -> Array:
        """Return the frame [row col] of that number, or with gain 1 at that offset.

        The spot at an offset is the mean of those of all frames.
        """
        seen = np.asarray(self.model_of(frame).predict(self.image)[0])
        return seen if self.stray_light is None else self.stray_light.added(seen)

    def model_of(self, frame: int | ArrayLike) -> ForwardModel:
        """Return the model of that frame alone."""
        per_pixel = (self.shift_field_px, self.spot_px2, self.skew_px3)
        if np.ndim(frame) == 1:
            offset, gain, bias = np.asarray(frame, dtype=np.float64)[None], None, None
            spot, skew = (None if of is None else of.mean(axis=0)[None] for of in per_pixel[1:])
            field = None
            if spot is not None and offset.shape == (1, 2):
                field = np.broadcast_to(offset, (1, *self.lr_shape, 2))
        else:
            number = int(np.asarray(frame))
            if not 0 <= number < len(self.offset_px):
                raise ValueError(
                    f"expected a frame from 0 to {len(self.offset_px) - 1} or an offset (row, col),"
                    f" got {frame!r}"
                )
            one = slice(number, number + 1)
            offset, gain, bias = self.offset_px[one], self.gain[one], self.bias[one]
            field, spot, skew = (None if of is None else of[one] for of in per_pixel)
        return forward_model(
            self.lr_shape, self.scale, offset if field is None else None, shift_field_px=field,
            spot_px2=spot, skew_px3=skew, blur=self.blur, gain=gain, bias=bias,
        )  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class PhasorPredictor:
    """One channel of frames of phasors."""

    phasor: FramePredictor  # of an HR image of phasors
    distance: PhaseScale | None = None  # how phases stand for distances, or None for the amplitude
    # of an HR image of distances beyond c / 2f, which says how often a phase has turned
    turns_m: FramePredictor | None = None

    def __call__(self, frame: int | ArrayLike) -> Array:
        """Return the frame [row col] of that number or at that offset, as `FramePredictor`."""
        seen = self.phasor(frame)
        if self.distance is None:
            return np.abs(seen)
        found_m = self.distance.distance_m(np.angle(seen))
        if self.turns_m is None:
            return found_m
        return in_turn_of(found_m, self.turns_m(frame), self.distance.modulation_hz)


def phasor_predictors(
    frame: FramePredictor, distance_m: Array, scale: PhaseScale
) -> tuple[PhasorPredictor, PhasorPredictor]:
    """Return what predicts amplitudes and distances, from HR images of both.

    Parameters
    ----------
    frame : of the amplitude, complex or not
    distance_m : [row col] like its image
    scale : how phases stand for distances
    """
    turned = np.exp(1j * scale.rad_per_m * (distance_m - scale.reference_m))
    phasor = replace(frame, image=np.abs(frame.image) * turned)
    beyond = scale.circular and bool(distance_m.max() >= unambiguous_range_m(scale.modulation_hz))
    even = replace(
        frame, image=distance_m, gain=np.ones_like(frame.gain), bias=np.zeros_like(frame.bias),
        stray_light=None,
    )  # fmt: skip
    return PhasorPredictor(phasor), PhasorPredictor(phasor, scale, even if beyond else None)


def in_turn_of(distance_m: Array, near_m: Array, modulation_hz: float) -> Array:
    """Return distances that are known but for turns of c / 2f, as near to others as these allow."""
    turn_m = unambiguous_range_m(modulation_hz)
    return np.asarray(distance_m + turn_m * np.rint((near_m - distance_m) / turn_m))
