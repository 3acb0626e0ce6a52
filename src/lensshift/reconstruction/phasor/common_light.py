"""Phasors of frames whose light or whose distances drift, brought to what most of them show."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from lensshift.core.arrays import Array, Floats
from lensshift.core.defects import NO_CHANCE
from lensshift.core.errors import warn_quality
from lensshift.core.gaussian import MEDIAN_ERROR, MEDIAN_SIZE
from lensshift.core.types import Burst
from lensshift.core.units import distance_to_phase, unambiguous_range_m
from lensshift.forward.differences import image_slopes
from lensshift.reconstruction.displacement import ALLOWED_SHIFT_PX
from lensshift.reconstruction.method import Request
from lensshift.reconstruction.phasor.frames import phasors_of, polar_frames
from lensshift.reconstruction.photometry import LIT, LOW_PASS_PX, MOST_SIGMAS, lights, on_latest
from lensshift.reconstruction.quantiles import weighted_mad, weighted_median
from lensshift.registration.light import light_said

TINY = float(np.finfo(np.float32).eps)  # where there is no light


def phasors_in_common(burst: Burst, request: Request, *, stacklevel: int) -> tuple[Burst, Request]:
    """Return the burst with phasors as bright and as far as most of them, and the request.

    That has their gains and turns. All are as they are where nothing surely differs. Other light
    has no phase, and no bias; a camera that warms up turns the phases of all pixels alike.

    Warns
    -----
    QualityWarning
        If light or distances differ.
    """
    part, used = burst.select(request.frames), list(request.frames)
    every, hz = phasors_of(part)
    alone = replace(part, distance_m=None, phasors=None, modulation_hz=None)
    most = int(np.argmax(part.valid.sum(axis=(1, 2))))
    turn_rad = np.stack([phase_drift(replace(alone, amplitude=z), most) for z in every])
    every = every * np.exp(-1j * turn_rad[:, :, None, None])
    gain = 1 / np.stack([lights(replace(alone, amplitude=z), most) for z in every])
    gain /= np.median(gain, axis=1, keepdims=True)
    done = "the picture allows for it, by {} of each frame (in its notes)"
    if np.any(turn_rad):
        drift_m = turn_rad / distance_to_phase(1.0, 1.0) / np.array(hz)[:, None]
        most_m = drift_m[np.argmax(np.ptp(drift_m, axis=1))]
        near, far = (used[int(pick(most_m))] for pick in (np.argmin, np.argmax))
        warn_quality(
            f"the distances of the frames differ as a whole: those of frame {far} are "
            f"{1e3 * np.ptp(most_m):.2g} mm more than those of frame {near}, as of a camera that "
            f"warms up: {done.format('a distance')}",
            stacklevel + 1,
        )
        request = replace(request, turn_rad=turn_rad)
    if np.any(gain != 1):
        said = light_said(gain[np.argmax(np.ptp(gain, axis=1))], used)
        warn_quality(f"{said}: {done.format('a gain')}", stacklevel + 1)
        request = replace(request, gain=gain)
    if request.gain is None and request.turn_rad is None:
        return burst, request
    factor = np.ones((len(every), burst.frame_count, 1, 1), np.complex128)
    factor[:, used, 0, 0] = np.exp(1j * turn_rad) * gain
    return divided(burst, factor), request


def divided(burst: Burst, factor: Array) -> Burst:
    """Return a burst with phasors over complex factors [frequency frame row col], or 1 of each."""
    highest = 0 if burst.phasors is None else int(np.argmax(burst.frequencies_hz))
    phasors = None if burst.phasors is None else burst.phasors / factor
    if burst.amplitude.dtype.kind == "c":
        return replace(burst, amplitude=burst.amplitude / factor[highest], phasors=phasors)
    amplitude, distance_m = burst.amplitude / np.abs(factor[highest]), burst.distance_m
    if phasors is None and distance_m is not None:
        scale = polar_frames(burst).scale
        distance_m = distance_m - np.angle(factor[0]) / scale.rad_per_m
        if scale.circular:
            distance_m = np.mod(distance_m, unambiguous_range_m(scale.modulation_hz))
    return replace(burst, amplitude=amplitude, distance_m=distance_m, phasors=phasors)


def phase_drift(burst: Burst, latest: int) -> Floats:
    """Return by how much the phases of each frame [frame] are more than of most, in radians.

        t_k = median arg(y_k y*),   |t_k| > 5 s + 0.1 px |median grad arg y|

    Behind the low pass of `lights`, weighted as there; s is the standard error of the median. All
    are 0 unless one surely is not: it is no chance and no shift that is off, and all share it: what
    is far from it, as at edges, is so to both sides, unlike what moved.

    Parameters
    ----------
    burst : of complex frames
    latest : the one that others are compared with
    """
    turned, surely = np.zeros(burst.frame_count), False
    for k, now, then, used in on_latest(burst, latest):
        if 2 * np.sum(used) < max(np.sum(burst.valid[j]) for j in (k, latest)):
            continue
        product, size = (then * now.conj())[used], np.abs(now[used])
        light = np.minimum(size, np.median(size)) + TINY
        about = float(np.angle(np.sum(product)))
        apart = np.angle(product * np.exp(-1j * about))
        turned[k] = about + (middle := weighted_median(apart, light))
        apart = apart - middle
        spread = weighted_mad(apart, light) / MEDIAN_SIZE + TINY
        far = np.abs(apart) > MOST_SIGMAS * spread
        count = np.sum(light) ** 2 / np.sum(light**2) / (4 * math.pi * LOW_PASS_PX**2)
        least = NO_CHANCE * MEDIAN_ERROR * spread / math.sqrt(max(count, 1.0))
        along = ((g * now.conj()).imag[used] for g in image_slopes(now))
        steep = [np.median(g / (size**2 + TINY)) for g in along]
        least += ALLOWED_SHIFT_PX * float(np.linalg.norm(steep))
        even = abs(np.sum(light * np.sign(apart), where=far)) < (1 - LIT) * np.sum(light)
        surely |= bool(abs(turned[k]) > least and even)
    return turned - np.median(turned) if surely else np.zeros(burst.frame_count)
