"""Frames cut softly to the part of the scene that all of them see, and their spectra."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lensshift.core.arrays import Array, Floats, Shifts

# Share of the common length over which a whole taper rises at each end: nothing rises slower that
# leaves a plateau as long as its flanks.
WHOLE_SHARE = 0.25
# A flank is as short as borders let it be, since all that it covers is lost: light that leaks from
# low frequencies falls with the square of its length. Two pixels have no spectrum of their own.
SHORTEST_FLANK_PX = 2.0
_FINE_CPP = 1 / 3  # frequencies in which a leak shows first, as scenes have least power there
_LEAK_SIGMAS = 3.0
LEAST_COMMON_PX = 4.0  # less has no spectrum


@dataclass(frozen=True, slots=True, eq=False)
class Tapered:
    """Spectra of tapered frames."""

    spectra: Array  # [frequency frame] scaled so that white noise keeps its variance; without f = 0
    window: Floats  # [frame row col]
    inflation: float  # by how much the taper widens a variance


def taper_frames(
    frames: Array, offset_px: Shifts, *, own_mean: bool, flank_px: float = np.inf
) -> Tapered:
    """Taper the frames where the scene is, not where the pixels are, and transform them.

        w_k(u) = w(u - offset_k),   w: cosine flanks, zero outside what every frame sees

    The window moves with the content, so that a tapered frame is still a shifted copy of one
    tapered scene. ValueError if the frames have less than 4 pixels of the scene in common along an
    axis.

    Parameters
    ----------
    frames : [frame row col]
    own_mean : whether each frame has its own mean taken off, or all the same
    flank_px : over which the window rises at each end, at most a quarter of the common length
    """
    rows, cols = frames.shape[1:]
    down, across = (
        _axis_window(size, offset_px[:, axis], flank_px) for axis, size in enumerate((rows, cols))
    )
    window = down[:, :, None] * across[:, None, :]
    total = np.einsum("krc,krc->k", window, frames)
    weight = np.einsum("krc->k", window)
    if own_mean:
        mean = total / np.maximum(weight, 1e-12)
    else:
        mean = np.full(len(frames), total.sum() / max(weight.sum(), 1e-12))
    values = window * (frames - mean[:, None, None])
    energy = np.sum(down**2, axis=1) * np.sum(across**2, axis=1)
    transform = np.fft.fft2 if frames.dtype.kind == "c" else np.fft.rfft2
    spectra = transform(values) / np.sqrt(energy)[:, None, None]
    # Variance of an estimate from tapered data (Dahlhaus 1988).
    fourth = float(np.sum(down**4, axis=1) @ np.sum(across**4, axis=1))
    inflation = rows * cols * fourth / len(frames) / energy.mean() ** 2
    return Tapered(spectra.reshape(len(frames), -1).T[1:], window, float(inflation))


def quiet_flank_px(frames: Array, offset_px: Shifts, *, own_mean: bool) -> float:
    """Return the shortest flank that leaks nothing, of 2, 3, 4.5 ... px up to a whole taper.

    What a shorter flank adds to the finest frequencies, beyond a third of a cycle per pixel, is
    no more than chance: within 3 standard errors of the mean power that a whole taper leaves.

    Parameters
    ----------
    frames : [frame row col]
    offset_px : [frame 2]
    own_mean : as in `taper_frames`
    """
    rows, cols = frames.shape[1:]
    col_cpp = np.fft.fftfreq(cols) if frames.dtype.kind == "c" else np.fft.rfftfreq(cols)
    fine = np.maximum(np.abs(np.fft.fftfreq(rows))[:, None], np.abs(col_cpp)).ravel()[1:]

    def fine_power(flank_px: float) -> tuple[float, float]:
        tapered = taper_frames(frames, offset_px, own_mean=own_mean, flank_px=flank_px)
        power = np.abs(tapered.spectra[fine > _FINE_CPP]) ** 2
        inflation = max(tapered.inflation, 1.0)
        return float(power.mean()), float(inflation / power.size)

    power, variance = fine_power(np.inf)
    flank_px = SHORTEST_FLANK_PX
    while flank_px < WHOLE_SHARE * min(rows, cols):
        short, of_short = fine_power(flank_px)
        if short <= power * (1.0 + _LEAK_SIGMAS * float(np.sqrt(variance + of_short))):
            return flank_px
        flank_px *= 1.5
    return np.inf


def share_enough(shape: tuple[int, ...], offset_px: Floats, more_px: float) -> bool:
    """Return whether frames [row col] have so much more in common than a taper needs."""
    common_px = np.array(shape) - np.ptp(offset_px, axis=0)
    return bool(np.all(common_px >= LEAST_COMMON_PX + more_px))


def _axis_window(size: int, offset_px: Floats, flank_px: float) -> Floats:
    """Return the taper [frame size] of one axis."""
    low_px, high_px = float((-0.5 - offset_px).max()), float((size - 0.5 - offset_px).min())
    if high_px - low_px < LEAST_COMMON_PX:
        raise ValueError(
            f"expected frames that share at least {LEAST_COMMON_PX:g} px of the scene, got shifts "
            f"from {offset_px.min():.1f} to {offset_px.max():.1f} px on {size} px"
        )
    place_px = np.arange(size) - offset_px[:, None]
    inside_px = np.minimum(place_px - low_px, high_px - place_px)
    rise = np.clip(inside_px / min(flank_px, WHOLE_SHARE * (high_px - low_px)), 0.0, 1.0)
    return np.asarray(np.sin(0.5 * np.pi * rise) ** 2)
