"""What goes into a toolbox run, checked at the door, and what is written down on the way."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lensshift.reconstruction.options import check_settings, option, positive, weight, whole

Vector = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class ToolboxSettings:
    """Settings of the toolbox; the defaults are those of the published benchmark.

    Parameters
    ----------
    prior_weight : lambda, or None for cross-validation
    window, alpha : half-width P of the BTV window and its decay
    sparsity : exponent p of the prior weights, in (0, 1]
    seed : of the cross-validation split

    Raises
    ------
    ValueError
        If a setting is out of its range.
    """

    psf_sigma_px: float = option(0.3, positive())
    prior_weight: float | None = option(None, weight())
    window: int = option(1, whole(1))
    alpha: float = option(0.5, positive(1.0))
    sparsity: float = option(0.5, positive(1.0))
    seed: int = option(0, whole(0))
    iterations: int = option(10, whole(1))
    inner_iterations: int = option(5, whole(1))

    def __post_init__(self) -> None:
        check_settings(self)


@dataclass(frozen=True, slots=True, eq=False)
class ToolboxData:
    """Frames and what is known about them.

    Parameters
    ----------
    frames, confidence, usable : [frame row col]; unusable pixels are 0 in `frames`
    offset_px : [frame 2]
    gain, bias : one entry per LR pixel of all frames, or a number
    """

    frames: NDArray[np.float64]
    offset_px: NDArray[np.float64]
    confidence: NDArray[np.float64]
    usable: NDArray[np.bool_]
    gain: Vector | float
    bias: Vector | float

    @property
    def frame_shape(self) -> tuple[int, int]:
        """(rows, cols) of a frame."""
        return self.frames.shape[1], self.frames.shape[2]


@dataclass(frozen=True, slots=True)
class StepRecord:
    """What one majorisation step found.

    Parameters
    ----------
    prior_weight : lambda
    noise_sigma, prior_sigma : scales of the residual and of the sparse transform
    objective : after the step
    """

    prior_weight: float
    noise_sigma: float
    prior_sigma: float
    objective: float


def check_data(
    frames: ArrayLike,
    offset_px: ArrayLike,
    gain: ArrayLike | None = None,
    bias: ArrayLike | None = None,
    confidence: ArrayLike | None = None,
) -> ToolboxData:
    """Check the arrays of `irwsr_toolbox` and bring them into the toolbox's form.

    Raises
    ------
    ValueError
        If shapes disagree, or a pixel or number is not finite and not excluded.
    """
    values = np.asarray(frames)
    if values.dtype.kind not in "uif":
        raise ValueError(f"the toolbox works on real frames only, got dtype {values.dtype}")
    if values.ndim != 3 or values.size == 0:
        raise ValueError(f"expected frames [frame row col], got shape {values.shape}")
    values = values.astype(np.float64)
    offset = np.asarray(offset_px, dtype=np.float64)
    if offset.shape != (len(values), 2) or not np.isfinite(offset).all():
        raise ValueError(
            f"expected one finite (row, col) in offset_px for each of the {len(values)} frames, "
            f"got shape {offset.shape}"
        )
    weight = np.ones(values.shape)
    if confidence is not None:
        weight = np.array(confidence, dtype=np.float64)
        if weight.shape != values.shape:
            raise ValueError(f"expected confidence of shape {values.shape}, got {weight.shape}")
        if not (np.isfinite(weight).all() and (weight >= 0).all()):
            raise ValueError("expected a finite confidence of at least 0 everywhere")
    usable = np.isfinite(values)
    if (weight[~usable] > 0).any():
        raise ValueError("some pixels are NaN or infinite; give them a confidence of 0")
    return ToolboxData(
        frames=np.where(usable, values, 0.0),
        offset_px=offset,
        confidence=weight,
        usable=usable,
        gain=_photometric(gain, 1.0, values.shape, "gain"),
        bias=_photometric(bias, 0.0, values.shape, "bias"),
    )


def _photometric(
    values: ArrayLike | None, neutral: float, shape: tuple[int, ...], name: str
) -> Vector | float:
    """Return a parameter of each LR pixel from one per frame or one per pixel."""
    if values is None:
        return neutral
    parameter = np.asarray(values, dtype=np.float64)
    if parameter.shape == shape[:1]:
        parameter = parameter[:, None, None]
    elif parameter.shape != shape:
        raise ValueError(f"expected {name} of shape {shape[:1]} or {shape}, got {parameter.shape}")
    if not np.isfinite(parameter).all():
        raise ValueError(f"expected a finite {name}")
    return np.array(np.broadcast_to(parameter, shape), dtype=np.float64).ravel()
