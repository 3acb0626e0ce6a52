"""Stray light of a camera, from a scene without and with a bright object in it."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import binary_dilation
from scipy.optimize import minimize_scalar

from lensshift.core.arrays import Array, Floats, Mask
from lensshift.core.errors import DataError
from lensshift.core.phasors import has_phasors, phasor_frames
from lensshift.core.stray_light import StrayLight
from lensshift.core.types import Burst

# Of the largest change: what changed by more holds the object.
OBJECT = 0.05
# Pixels around the object that its own image may reach; of the rest so many must be left.
MARGIN_PX, LEAST_PIXELS = 3, 64
# The object is as bright as it is without its own stray light, each time to another order of s.
ROUNDS = 3
# The sensor is left out part by part, so many along each side, to see what hangs on each.
PARTS = 4


def measure_stray_light(with_object: Burst, without: Burst) -> StrayLight:
    """Return which share of the light goes astray, how far, and the standard deviation of it.

        d = y_with - y_without = (1 - s) u + s G u,   u = 0 but where the object is

    Away from the object nothing changed in the scene: what changed there is its stray light. The
    share is fitted to it, with its phase if the bursts have phasors, for the width that fits best;
    its standard deviation is that of a jackknife over parts of the sensor, which holds the shape of
    real stray light that no Gaussian has.

    Parameters
    ----------
    with_object, without : bursts of one scene that rests, at the same places of the lens; the
        object bright, near, in the middle and small: most of the sensor must see past it

    Raises
    ------
    DataError
        If the bursts do not belong together, or no object or not enough around it is seen.
    """
    change, seen = _change(with_object, without)
    largest = float(np.abs(change[seen]).max(initial=0.0))
    is_object = seen & (np.abs(change) > OBJECT * largest)
    away = seen & ~binary_dilation(is_object, iterations=MARGIN_PX)
    if largest == 0.0 or away.sum() < LEAST_PIXELS:
        problem = "it changes nearly everything" if largest else "it changes nothing"
        raise DataError(f"expected one bright object that is small: {problem}", field="with_object")

    def fitted(used: Mask, sigma_px: float) -> tuple[float, float]:
        share = 0.0
        for _ in range(ROUNDS):
            stray = StrayLight(min(max(share, 0.0), 0.5), sigma_px)
            around = stray.spread(np.where(is_object, stray.removed(change), 0.0))[used]
            power = float(np.sum(np.abs(around) ** 2)) or 1e-300
            share = float(np.sum((around.conj() * change[used]).real)) / power
        return share, float(np.sum(np.abs(change[used] - share * around) ** 2))

    def width_px(used: Mask) -> float:
        found = minimize_scalar(
            lambda log: fitted(used, float(np.exp(log)))[1],
            bounds=(np.log(MARGIN_PX), np.log(max(change.shape))), method="bounded",
        )  # fmt: skip
        return float(np.exp(found.x))

    sigma_px = width_px(away)
    share = fitted(away, sigma_px)[0]
    left_out = [
        fitted(away & ~part, sigma_px)[0] for part in _parts(change.shape) if np.any(away & part)
    ]
    apart = np.asarray(left_out) - np.mean(left_out)
    count = len(left_out)
    std = float(np.sqrt(max(count - 1, 1) / count * np.sum(apart**2)))
    return StrayLight(min(max(share, 0.0), 0.5), sigma_px, min(std, 0.5))


def _change(one: Burst, other: Burst) -> tuple[Array, Mask]:
    """Return what changed [row col] in the mean of the frames, and where all of them are valid."""
    if one.amplitude.shape != other.amplitude.shape or one.frequencies_hz != other.frequencies_hz:
        raise DataError("expected the camera and frames of the other burst", field="without")
    if not np.allclose(one.offset_px, other.offset_px, atol=0.1):
        raise DataError("expected the lens at the places of the other burst", field="offset_px")
    phasors = has_phasors(one) and has_phasors(other)
    both = [phasor_frames(burst) if phasors else burst.amplitude for burst in (one, other)]
    valid = np.all(one.valid & other.valid, axis=0)
    change: Floats = (both[0] - both[1]).mean(axis=0)
    return np.where(valid, change, 0.0), valid


def _parts(shape: tuple[int, ...]) -> list[Mask]:
    """Return masks [row col] of the parts of the sensor."""
    rows, cols = (np.arange(n) * PARTS // n for n in shape)
    number = rows[:, None] * PARTS + cols
    return [number == n for n in range(PARTS**2)]
