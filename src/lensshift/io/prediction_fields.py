"""What a result file keeps so that its images can predict frames.

    seen_offset_row, seen_offset_col   [burst_frame]                 pixel, of every frame
    seen_shift_row, seen_shift_col     [burst_frame lr_row lr_col]   pixel, of a shift field
    seen_spot_row, seen_spot_col       [burst_frame lr_row lr_col]   pixel2, variance of the spot
    seen_spot_lean                     [burst_frame lr_row lr_col]   pixel2, its covariance, if any
    seen_skew_row, seen_skew_col       [burst_frame lr_row lr_col]   pixel3, its third moment
    c_gain, c_bias                     [burst_frame]                 of channel c
    attributes of the distance of phasors: modulation_hz, reference_m, circular

The pixel response and stray light are among the settings.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lensshift.core.errors import DataError, about
from lensshift.core.stray_light import StrayLight
from lensshift.core.types import Estimate
from lensshift.core.units import PhaseScale
from lensshift.forward.blur import ApertureBlur, Blur, GaussianBlur
from lensshift.forward.prediction import FramePredictor, PhasorPredictor, phasor_predictors
from lensshift.io.container_reader import Container
from lensshift.io.container_writer import Variable, measured

_FRAME = ("burst_frame",)
_PIXEL = (*_FRAME, "lr_row", "lr_col")
_ALONG = {"row": "along rows", "col": "along columns", "lean": "across both"}


def prediction_variables(channels: Mapping[str, Estimate]) -> dict[str, Variable]:
    """Return the variables for estimates by the names of their channels in the file."""
    variables: dict[str, Variable] = {}
    for name, estimate in channels.items():
        seen = estimate.predict
        plain = seen.phasor if isinstance(seen, PhasorPredictor) else seen
        if not isinstance(plain, FramePredictor):
            continue
        for what, dims, values, unit, meaning in (
            ("offset", _FRAME, plain.offset_px, "pixel", "image offset"),
            ("shift", _PIXEL, plain.shift_field_px, "pixel", "image offset"),
            ("spot", _PIXEL, plain.spot_px2, "pixel2", "variance of the spot"),
            ("skew", _PIXEL, plain.skew_px3, "pixel3", "third central moment of the spot"),
        ):
            parts: Any = [] if values is None else np.moveaxis(values, -1, 0)
            for (axis, along), one in zip(_ALONG.items(), parts, strict=False):
                variables[f"seen_{what}_{axis}"] = measured(dims, one, unit, f"{meaning} {along}")
        variables[f"{name}_gain"] = Variable(_FRAME, plain.gain, {"units": "1"})
        variables[f"{name}_bias"] = Variable(_FRAME, plain.bias)
    return variables


def phase_attributes(estimate: Estimate) -> dict[str, Any]:
    """Return the attributes of the distance of phasors; none for any other channel."""
    seen = estimate.predict
    if not isinstance(seen, PhasorPredictor) or seen.distance is None:
        return {}
    return {
        "modulation_hz": np.float64(seen.distance.modulation_hz),
        "reference_m": np.float64(seen.distance.reference_m),
        "circular": np.uint8(seen.distance.circular),
    }


def with_predictions(
    container: Container, channels: dict[str, Estimate], scale: int, settings: Mapping[str, Any]
) -> dict[str, Estimate]:
    """Return the estimates, by their names in the file, with what the file has for predictions."""
    if not container.has("seen_offset_row"):
        return channels
    phase = None
    if len(channels) == 2:
        names = ("modulation_hz", "reference_m", "circular")
        modulation_hz, reference_m, circular = (container.number(n, of="distance") for n in names)
        if modulation_hz is not None and reference_m is not None:
            phase = PhaseScale(modulation_hz, reference_m, bool(circular), "file")
    blur = _blur(settings.get("blur"))
    stray = StrayLight.told(settings.get("stray_light"), "settings.stray_light")
    finest = {name: one.image if one.fine is None else one.fine for name, one in channels.items()}

    def predictor(name: str) -> FramePredictor:
        image = finest[name]
        per_px = scale * (image.shape[0] // channels[name].image.shape[0])
        offset_px = container.pairs("seen_offset")
        gain, bias = (container.array(f"{name}_{what}", kinds="f") for what in ("gain", "bias"))
        shape = (len(offset_px), image.shape[0] // per_px, image.shape[1] // per_px)
        of_pixels = [_of_pixels(container, what, shape) for what in ("shift", "spot", "skew")]
        if gain.shape != shape[:1] or bias.shape != gain.shape:
            raise DataError("expected one number a frame", field=f"{name}_gain")
        told = None if phase is None and name == "distance" else stray
        return FramePredictor(
            image, per_px, blur, offset_px, gain, bias, *of_pixels, stray_light=told
        )

    if phase is None:
        return {name: replace(one, predict=predictor(name)) for name, one in channels.items()}
    if finest["amplitude"].shape != finest["distance"].shape:
        raise DataError("expected as many pixels as amplitude_fine", field="distance_fine")
    both = phasor_predictors(predictor("amplitude"), finest["distance"], phase)
    return {
        name: replace(channels[name], predict=one)
        for name, one in zip(("amplitude", "distance"), both, strict=True)
    }


def _of_pixels(
    container: Container, what: str, shape: tuple[int, ...]
) -> NDArray[np.float64] | None:
    """Return [frame row col part] of every LR pixel, or None if the file has none."""
    if not container.has(f"seen_{what}_row"):
        return None
    known = [axis for axis in _ALONG if axis != "lean" or container.has(f"seen_{what}_lean")]
    parts = [container.array(f"seen_{what}_{axis}", kinds="f") for axis in known]
    if any(part.shape != shape for part in parts):
        raise DataError("expected one for every LR pixel", field=f"seen_{what}_row")
    return np.stack(parts, axis=-1)


def _blur(settings: Any) -> Blur:
    for kind in (GaussianBlur, ApertureBlur):
        if isinstance(settings, Mapping) and set(settings) == set(kind.__dataclass_fields__):
            with about("settings.blur"):
                return kind(**settings)
    raise DataError(f"expected a pixel response, got {settings!r:.80}", field="settings.blur")
