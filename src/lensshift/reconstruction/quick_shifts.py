"""Shifts and turns of frames as they tell them themselves at a glance."""

from __future__ import annotations

import numpy as np

from lensshift.core.arrays import Array, Mask, Shifts

# A low pass against the aliases of the pixels, and Gauss-Newton, find the shifts of the frames.
LOW_PASS_PX, FINDING_ROUNDS, FOUND_PX, BORDER_PX = 0.8, 10, 0.01, 3
INNER = np.s_[..., BORDER_PX:-BORDER_PX, BORDER_PX:-BORDER_PX]
# Waves that each hold half of what there is, as of a square grating: first, third, fifth harmonic.
MOST_WAVES, LONE_SHARE, LEAST_CYCLES, FINER = 3, 0.5, 2.0, 4
# Directions whose gradients have a smaller part than this of the power of the others tell nothing.
LEAST_TOLD = 0.03
# Frames whose borders seem to move by less against their middle are not asked how they turn.
LEAST_TURN_PX = 0.15


def low_passed(values: Array, seen: Mask) -> Array | None:
    """Return the splines of frames [frame row col] without what is finer than their pixels.

    None where less is left than of white noise: the frames show little but aliases, which move in
    any direction.
    """
    from scipy.ndimage import gaussian_filter, spline_filter

    width = (0, LOW_PASS_PX, LOW_PASS_PX)
    smooth = gaussian_filter(values, width)
    smooth /= np.maximum(gaussian_filter(seen.astype(np.float64), width), 1e-3)
    if _power(smooth) * 4 * np.pi * LOW_PASS_PX**2 < 0.8 * _power(values):
        return None
    return np.stack([spline_filter(frame, output=smooth.dtype) for frame in smooth])


def without_lone_waves(values: Array, seen: Mask) -> Array | None:
    """Return frames [frame row col] without a wave that holds most of them, None if there is none.

    A lone wave beyond the Nyquist frequency of the frames is the same as its alias, which moves
    another way: it cannot say which of two readings of the shifts is wrong.
    """
    if np.iscomplexobj(values):
        parts = np.concatenate([values.real, values.imag])
        rest = without_lone_waves(parts, np.concatenate([seen, seen]))
        return None if rest is None else rest[: len(values)] + 1j * rest[len(values) :]
    left, found = np.where(seen, values, 0.0), False
    for _ in range(MOST_WAVES):
        rest = _without_wave(left, seen)
        if rest is None or np.sum(rest**2) > (1.0 - LONE_SHARE) * np.sum(left**2):
            break
        left, found = rest, True
    return left if found else None


def _without_wave(values: Array, seen: Mask) -> Array | None:
    """Return frames without their largest wave, None if the frames are no two periods of it."""
    shape = values.shape[1:]
    power = np.sum(np.abs(np.fft.rfft2(values, [FINER * n for n in shape])) ** 2, axis=0)
    at = np.unravel_index(int(np.argmax(power)), power.shape)
    cycles = np.array(at) / FINER  # over a frame
    cycles[0] -= shape[0] if cycles[0] > shape[0] / 2 else 0.0
    if np.hypot(*cycles) < LEAST_CYCLES:
        return None
    place = np.stack([axis / n - 0.5 for axis, n in zip(np.indices(shape), shape, strict=True)])
    terms = np.stack([np.ones(shape), *place])
    for last in (False, False, True):
        wave = np.exp(2j * np.pi * np.tensordot(cycles, place, 1))
        used = wave * (terms[:1] if last else terms)
        basis = np.concatenate([used.real, used.imag])
        size = np.stack([
            np.linalg.lstsq((basis * on).reshape(len(basis), -1).T, frame.ravel(), rcond=None)[0]
            for frame, on in zip(values, seen, strict=True)
        ])  # fmt: skip
        if not last:  # ramps tell what the frequency is off by
            real, imag = size.reshape(len(values), 2, -1).swapaxes(0, 1)
            z = real - 1j * imag
            off = np.conj(z[:, :1]) * z[:, 1:]
            cycles += np.imag(off.sum(axis=0)) / np.sum(np.abs(z[:, 0]) ** 2) / (2 * np.pi)
    return np.asarray(values - np.tensordot(size, basis, 1) * seen)


def alike_in_light(values: Array, seen: Mask, smooth: Array, offset_px: Shifts) -> Array:
    """Return the frames [frame row col] without gain and bias, in units of their spread.

    As they are where the shifts bring them onto each other: what a slope gains by its shift is no
    light, and a frame without it would not seem to have moved.
    """
    there = _moved(smooth, offset_px)[INNER]
    level, spread = (of(there, axis=(1, 2), keepdims=True) for of in (np.mean, np.std))
    return np.asarray(np.where(seen, (values - level) / np.maximum(spread, 1e-300), 0.0))


def found_shifts(smooth: Array, given_px: Shifts) -> Shifts:
    """Return the shifts [frame 2] about their mean as the frames tell them.

    Along edges that all run one way nothing tells the shift: there it is the given one.
    """
    offset_px = given_px.copy()
    told = np.eye(2)
    for _ in range(FINDING_ROUNDS):
        rest, slope = _rest_and_slope(smooth, offset_px)
        size, direction = np.linalg.eigh(slope.T @ slope)
        told = direction * (size > LEAST_TOLD * size[1]) @ direction.T
        inverse = direction / np.maximum(size, LEAST_TOLD * size[1] + 1e-300) @ direction.T
        step = np.clip(rest @ slope @ inverse @ told, -1.0, 1.0)
        offset_px += step - step.mean(axis=0)
        if np.abs(step).max() < FOUND_PX:
            break
    return np.asarray(given_px + (offset_px - given_px) @ told)


def found_variance_px2(smooth: Array, offset_px: Shifts) -> float:
    """Return the variance of `found_shifts` (both axes) by which the frames leave each other.

    Noise, and aliases, which are as good as noise to what takes them for the scene.
    """
    rest, slope = _rest_and_slope(smooth, offset_px)
    size = np.linalg.eigvalsh(slope.T @ slope)
    left = np.sum(rest**2) / (len(smooth) - 1)
    alike_px = 4 * np.pi * LOW_PASS_PX**2  # pixels that go together behind the low pass
    return float(left / len(slope) * alike_px * np.sum(1 / size[size > LEAST_TOLD * size[1]]))


def found_turns(smooth: Array, given_px: Shifts) -> Array | None:
    """Return the shift [frame row col 2] of every pixel, of frames that turn, grow or shear.

    None if they hardly do.
    """
    from scipy.ndimage import map_coordinates

    at = np.indices(smooth.shape[1:], np.float64)
    half = (np.array(smooth.shape[1:]) - 1) / 2
    row, col = at / half[:, None, None] - 1.0
    terms = np.stack([np.ones_like(row), row, col])
    place = np.zeros((len(smooth), 2, 3))
    place[..., 0] = given_px
    moved = _moved(smooth, given_px)
    for number in range(FINDING_ROUNDS):
        if number:
            field = np.einsum("kit,thw->kihw", place, terms)
            moved = np.stack([
                map_coordinates(frame, at + by, mode="mirror", prefilter=False)
                for frame, by in zip(smooth, field, strict=True)
            ])  # fmt: skip
        common = moved.mean(axis=0)
        known = _real((np.stack(np.gradient(common))[:, None] * terms)[INNER].reshape(6, -1))
        told = np.linalg.pinv(known @ known.T, rcond=LEAST_TOLD, hermitian=True)
        step = _real((common - moved)[INNER].reshape(len(smooth), -1)) @ known.T @ told
        step = np.clip(step - step.mean(axis=0), -1.0, 1.0).reshape(place.shape)
        if number == 0 and np.abs(step[..., 1:]).sum(axis=2).max() < LEAST_TURN_PX:
            return None
        place = place + step
        if np.abs(step).max() < FOUND_PX:
            break
    return np.asarray(np.einsum("kit,thw->khwi", place, terms))


def _rest_and_slope(smooth: Array, offset_px: Shifts) -> tuple[Array, Array]:
    """Return what frames at these shifts lack of their mean [frame pixel], its slopes [pixel 2]."""
    moved = _moved(smooth, offset_px)
    common = moved.mean(axis=0)
    slope = _real(np.stack([g[INNER].ravel() for g in np.gradient(common)]))
    return _real((common - moved)[INNER].reshape(len(smooth), -1)), slope.T


def _real(values: Array) -> Array:
    """Return numbers [... n]; of complex ones both parts as numbers of their own [... 2 n]."""
    return np.ascontiguousarray(values).view(np.float64)


def _power(values: Array) -> float:
    return float(np.vdot(values, values).real) / values.size


def _moved(smooth: Array, offset_px: Shifts) -> Array:
    """Return the frames where they would be without these shifts."""
    from scipy.ndimage import shift

    pairs = zip(smooth, -offset_px, strict=True)
    return np.stack([shift(frame, by, mode="mirror", prefilter=False) for frame, by in pairs])
