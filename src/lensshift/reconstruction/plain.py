"""The plain methods: interpolation, deconvolution of one frame, and what drops samples."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import ClassVar, Literal

import numpy as np

from lensshift.core.arrays import Array
from lensshift.core.types import Estimate, Status
from lensshift.reconstruction.baselines.accumulate import drizzle_frames, shift_and_add
from lensshift.reconstruction.baselines.deconvolve import deconvolution
from lensshift.reconstruction.baselines.interpolate import bicubic, nearest_taps, resampled
from lensshift.reconstruction.baselines.result import Baseline
from lensshift.reconstruction.method import Method, Request
from lensshift.reconstruction.options import one_of, option, positive, whole
from lensshift.reconstruction.problem import Problem
from lensshift.reconstruction.uncertainty import PropagatedStd


@dataclass(frozen=True, slots=True)
class _Plain(Method):
    reads_response: ClassVar[bool] = False
    questions_shifts: ClassVar[bool] = False

    def __call__(self, problem: Problem, request: Request) -> Estimate:
        """Return the estimate, with the noise that comes through the method."""
        found = self._found(problem)
        image = np.maximum(found.image, 0.0) if request.non_negative else found.image
        gain, sigma, std = found.noise_gain, problem.noise_sigma, None
        if request.std:
            sigma = problem.shown_noise.sigma if sigma is None else sigma
            again = partial(self._image, replace(problem, noise_sigma=sigma))
            spread = PropagatedStd(again, problem.y, problem.weight, sigma, request.seed)
            std = spread if gain is None else gain * sigma
        return Estimate(image=image, uncertainty=std, status=Status.DIRECT, noise_sigma=sigma)

    def _image(self, problem: Problem, y: Array) -> Array:
        """Return the picture of other frames."""
        return self._found(replace(problem, y=y)).image

    def _found(self, problem: Problem) -> Baseline:
        raise NotImplementedError


def _frame_of(problem: Problem, frame: int | None) -> int:
    if frame is None:
        return int(np.argmax(problem.weight.any(axis=(1, 2))))
    if frame >= len(problem.y):
        raise ValueError(f"frame: expected a frame from 0 to {len(problem.y) - 1}, got {frame}")
    if not problem.weight[frame].any():
        raise ValueError(f"frame: frame {frame} has no valid pixel; choose another")
    return frame


@dataclass(frozen=True, slots=True)
class Nearest(_Plain):
    """Take one frame and repeat its pixels.

    Parameters
    ----------
    frame : which one; None: the first that has valid pixels
    """

    frame: int | None = option(None, whole(0))
    name: ClassVar[str] = "nearest"
    summary: ClassVar[str] = "one frame, each HR pixel from the nearest LR pixel"

    def _found(self, problem: Problem) -> Baseline:
        k = _frame_of(problem, self.frame)
        return resampled(
            problem.y[k], problem.weight[k], problem.offset_px[k], problem.scale, nearest_taps
        )


@dataclass(frozen=True, slots=True)
class Bicubic(_Plain):
    """Interpolate one frame, or combine the aligned frames by mean or median.

    Parameters
    ----------
    combine : "first", one frame; "mean" or "median" of all of them
    frame : which one; None: the first that has valid pixels

    Source: Keys 1981, doi 10.1109/TASSP.1981.1163711.
    """

    combine: Literal["first", "mean", "median"] = option("first", one_of("first", "mean", "median"))
    frame: int | None = option(None, whole(0))
    name: ClassVar[str] = "bicubic"
    summary: ClassVar[str] = (
        "Keys' cubic interpolation of one frame, or mean or median of the aligned frames"
    )

    def __post_init__(self) -> None:
        super(Bicubic, self).__post_init__()
        if self.frame is not None and self.combine != "first":
            raise ValueError(f"combine {self.combine!r} takes all frames, got frame {self.frame}")

    def _found(self, problem: Problem) -> Baseline:
        return bicubic(
            problem.y, problem.weight, problem.offset_px, problem.scale,
            combine=self.combine, frame=_frame_of(problem, self.frame),
        )  # fmt: skip


@dataclass(frozen=True, slots=True)
class Deconvolution(_Plain):
    """Interpolate one frame and undo the blur of its pixels.

    Parameters
    ----------
    frame : which one; None: the first that has valid pixels
    algorithm : of scikit-image: "wiener", "unsupervised" (Wiener and Hunt) or "richardson-lucy"
    """

    frame: int | None = option(None, whole(0))
    algorithm: Literal["wiener", "unsupervised", "richardson-lucy"] = option(
        "wiener", one_of("wiener", "unsupervised", "richardson-lucy")
    )
    name: ClassVar[str] = "deconvolution"
    summary: ClassVar[str] = "one frame, interpolated and deconvolved by scikit-image"
    reads_response: ClassVar[bool] = True
    take_level: ClassVar[bool] = False  # Richardson and Lucy want no negative values

    def _found(self, problem: Problem) -> Baseline:
        k = _frame_of(problem, self.frame)
        return deconvolution(
            problem.y[k], problem.weight[k], problem.offset_px[k], problem.scale,
            problem.blur_sigma_px, problem.told or problem.shown_noise.sigma, self.algorithm,
        )  # fmt: skip

    def _image(self, problem: Problem, y: Array) -> Array:
        if self.algorithm == "richardson-lucy":
            y = np.maximum(y, 0.0)
        return super(Deconvolution, self)._image(problem, y)


@dataclass(frozen=True, slots=True)
class ShiftAndAdd(_Plain):
    """Drop every LR sample into the nearest HR pixel.

    Parameters
    ----------
    combine : "mean" or "median" of the samples of one pixel

    Source: Farsiu et al. 2004, doi 10.1109/TIP.2004.834669.
    """

    combine: Literal["mean", "median"] = option("mean", one_of("mean", "median"))
    name: ClassVar[str] = "shift-and-add"
    summary: ClassVar[str] = "every LR sample dropped into the nearest HR pixel, holes filled"

    def _found(self, problem: Problem) -> Baseline:
        return shift_and_add(
            problem.y, problem.weight, problem.offset_px, problem.scale, combine=self.combine
        )


@dataclass(frozen=True, slots=True)
class Drizzle(_Plain):
    """Rain shrunken LR pixels onto the HR grid.

    Parameters
    ----------
    pixfrac : side of a drop in LR pixels, above 0 and up to 1
    kernel : shape of a drop, "square" or "point"

    Source: Fruchter and Hook 2002, doi 10.1086/338393.
    """

    pixfrac: float = option(0.5, positive(1.0))
    kernel: Literal["square", "point"] = option("square", one_of("square", "point"))
    name: ClassVar[str] = "drizzle"
    summary: ClassVar[str] = "STScI drizzle: LR pixels shrunk and rained onto the HR grid"

    def _found(self, problem: Problem) -> Baseline:
        return drizzle_frames(
            problem.y, problem.weight, problem.offset_px, problem.scale, self.pixfrac, self.kernel
        )
