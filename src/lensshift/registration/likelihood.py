"""Shifts of all frames at once by maximum likelihood: aliasing and noise are in the model."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from lensshift.core.arrays import Array, Floats, Mask, Shifts
from lensshift.registration.curvature import LEAST_SHARE, Curvature, newton
from lensshift.registration.reference_image import shown_everywhere
from lensshift.registration.score import Score, State
from lensshift.registration.spectrum import Frequencies, first_spectrum
from lensshift.registration.taper import Tapered, quiet_flank_px, share_enough, taper_frames

_LARGEST_LOG = 7.0  # of a gain, a thousand times: frames without contrast have any
MAX_STEP_PX = 0.2  # the likelihood is a parabola nearby only
CONVERGED_PX, CONVERGED_SIGMAS = 1e-3, 0.03
# The image power is freed from the power law in this many rounds, once the shifts are near.
_FREE_ROUNDS = 6
_FREE_BELOW_PX, _FREE_BELOW_SIGMAS = 0.02, 1.0
# A burst moves by some pixels; where the frames tell nothing, this is what is known of a shift.
USUAL_SHIFT_PX = 2.0
# A shift that is known to a pixel is not known.
UNKNOWN_PX = 1.0
# A search that starts off by a quarter of the finest period in the model returns to within 3 % of
# that where a shift is known (from farther it ends in other maxima), of 35 frames at times from one
# side only; along an edge it stays on both (at half and more, 80 searches of 3x3 and 4x4). Where
# the likelihood bends as it should (`Curvature`) it need not be asked: edges leave up to 0.84 of
# the information, at SNR 1000, where aliases dwarf the noise and nine frames or more have several
# of them in the model.
_RETURNS, _SURE_SHARE = 0.1, 0.9
LEAST_TELLING = 3  # frames that tell what stays at the pixels from what moves
_GROWS = 0.1  # logarithm of the power of a pattern, in a round
_FILLINGS = 2  # of pixels that see nothing
# What is not known at all, beside what may be known.
_BLIND_PX = 1e3


@dataclass(frozen=True, slots=True, eq=False)
class ShiftFit:
    """Offsets of a burst and what is known of them.

    Parameters
    ----------
    offset_px : [frame 2] (row, col)
    covariance_px2 : [2 frame, 2 frame] of the offsets, frame by frame; zero at the reference
    gain : [frame] amplitude against the reference
    noise_sigma : of an LR pixel, as far as the model does not explain the frames
    converged : whether the last step was small
    pattern_sigma : of what stays at the pixels while the scene moves, as far as that was asked
    """

    offset_px: Shifts
    covariance_px2: Floats
    gain: Floats
    noise_sigma: float
    converged: bool
    pattern_sigma: float = 0.0

    @property
    def sigma_px(self) -> Shifts:
        """Standard errors [frame 2], against the reference."""
        variance = np.diag(self.covariance_px2)
        return np.sqrt(np.maximum(variance, 0.0)).reshape(-1, 2)


def against_reference(own: Array, reference: int) -> Floats:
    """Return the covariance of differences from the reference, from [frame 2 2] of each alone."""
    count, at = len(own), slice(2 * reference, 2 * reference + 2)
    covariance = np.kron(np.ones((count, count)), own[reference])
    for k in range(count):
        covariance[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] += own[k]
    covariance[at] = covariance[:, at] = 0.0
    return covariance


def likely_shifts(
    frames: Array,
    valid: Mask,
    start_px: Shifts,
    *,
    reference: int = 0,
    photometric: bool = False,
    max_iterations: int = 40,
) -> ShiftFit:
    """Estimate the offsets of all frames by maximum likelihood.

        Y_k(f) = g_k sum_m X(f + m) exp(-2 pi i (f + m) . d_k) + N_k(f) + F(f),  m in {-r ... r}^2
        S(f) = sum_m P(f + m) a_m a_m^H + sigma^2 I + tau^2 1 1^T,  a_m = g exp(-2 pi i (f + m) . d)
        maximise  - sum_f [ log det S(f) + Y^H S^-1 Y ]

    X is a random image of power P: a power law behind the blur of a pixel at first, then
    whatever power the frames show. The aliases m != 0, the noise and the fixed pattern F of the
    pixels are part of the model, so none biases the shifts; that the same scene is behind all
    frames, and where it is in each, is what tells them apart. Fisher
    scoring; standard errors from the curvature with the taper in tow (`Curvature`).
    A search that leaves what the frames share knows nothing.
    Invalid pixels are what other frames show there (`shown_everywhere`), by the start and again by
    what is found from there; a share of pixels tells that share of the information.

    Parameters
    ----------
    frames, valid : [frame row col]
    start_px : [frame 2], right to about half a pixel
    reference : frame whose offset stays as it is
    photometric : whether the frames may differ by a factor and an additive constant

    Source: Whittle (1953); Gaussian Fisher scoring as in Kay, Estimation Theory (1993) ch. 3.
    """
    for _ in range(1 if valid.all() else _FILLINGS):
        search = partial(
            _search, shown_everywhere(frames, valid, start_px), reference=reference,
            photometric=photometric, max_iterations=max_iterations,
        )  # fmt: skip
        fit, share, along = search(start_px)
        start_px = fit.offset_px
    fit = replace(fit, covariance_px2=fit.covariance_px2 / max(float(valid.mean()), 1e-12))
    reach = Frequencies.of(frames.shape, whole_plane=frames.dtype.kind == "c").reach
    if not (reach > 1 and LEAST_SHARE < share < _SURE_SHARE):
        return fit
    # Where aliases dwarf the noise the likelihood bends along an edge as well, into many maxima.
    other = np.arange(len(frames)) != reference
    quarter_px = 0.25 / (reach + 0.5)  # the aliases end at reach + 1/2 cycles per pixel
    away_px = quarter_px * np.where(other, np.where(np.arange(len(frames)) % 2, -1.0, 1.0), 0.0)
    for side in (1.0, -1.0):  # one of many frames may be caught on its way back
        again, _, _ = search(fit.offset_px + side * away_px[:, None] * along)
        left_px = ((again.offset_px - fit.offset_px) @ along)[other]
        if np.mean(left_px**2) < (_RETURNS * quarter_px) ** 2:
            return fit
    blind_px2 = np.kron(np.diag(other * _BLIND_PX**2), np.outer(along, along))
    return replace(fit, covariance_px2=fit.covariance_px2 + blind_px2)


def _search(
    frames: Array,
    start_px: Shifts,
    *,
    reference: int,
    photometric: bool,
    max_iterations: int,
) -> tuple[ShiftFit, float, Floats]:
    """Return the likeliest shifts near a start.

    And the share of the information that is left where least is, and the direction [2] in which
    the frames have least detail.
    """
    at = Frequencies.of(frames.shape, whole_plane=frames.dtype.kind == "c")
    flank_px = quiet_flank_px(frames, start_px, own_mean=photometric)
    taper = partial(taper_frames, frames, own_mean=photometric, flank_px=flank_px)
    tapered = taper(start_px)
    state = _first(at, tapered.spectra, start_px, np.ones(len(frames)))
    kinds = 3 if photometric else 2
    free = _free(len(frames), kinds, reference)
    freed, converged, lost, step = 0, False, False, np.zeros((len(frames), kinds))
    curvature: Curvature | None = None
    damping = 1.0
    for _ in range(max_iterations):
        tapered = taper(state.offset_px)
        now = state.score(tapered.spectra, kinds, whole=freed == 0)
        grows = now.learned.spectrum.pattern_over(state.spectrum) > _GROWS
        state.spectrum = now.learned.spectrum
        if freed == _FREE_ROUNDS and curvature is None:
            curvature = _bent(taper, state, tapered, now, reference)
        before, step = step, np.zeros((len(frames), kinds))
        change, spread = newton(*now.of(0, free), curvature, kinds)
        step.ravel()[free] = change
        largest_px = float(np.abs(step[:, :2]).max())
        # Where the frames say little, a step means little.
        told = float(np.max(np.abs(change) / np.sqrt(np.maximum(np.diag(spread), 1e-30))))
        # To and fro: the frames are surer than the model. By half each time, as at a quarter of
        # their curvature half a step swings for ever.
        damping = 0.5 * damping if np.sum(step * before) < 0.0 else min(1.0, 2.0 * damping)
        step *= damping * min(1.0, MAX_STEP_PX / max(damping * largest_px, 1e-300))
        # 1 px more than a taper needs: curvatures, and searches from elsewhere, begin beside it.
        lost = not share_enough(frames.shape[1:], state.offset_px + step[:, :2], 1.0)
        if lost:
            break
        state.offset_px = state.offset_px + step[:, :2]
        if photometric:
            state.log_gain = np.clip(state.log_gain + step[:, 2], -_LARGEST_LOG, _LARGEST_LOG)
        near = largest_px < _FREE_BELOW_PX or told < _FREE_BELOW_SIGMAS
        unasked = not state.spectrum.pattern_asked and len(frames) >= LEAST_TELLING
        if freed == 0 and unasked and largest_px < _FREE_BELOW_PX:
            # Not before: where shifts are not known, a pattern may be all that rests.
            state.spectrum = state.spectrum.asking_pattern()
        elif near and freed < _FREE_ROUNDS and not (freed == 0 and grows):
            state.spectrum = state.spectrum.freed(now.learned.power)
            freed += 1
        elif freed == _FREE_ROUNDS and (largest_px < CONVERGED_PX or told < CONVERGED_SIGMAS):
            converged = True
            break
    if curvature is None:
        curvature = _bent(taper, state, tapered, now, reference)
        _, spread = newton(*now.of(0, free), curvature, kinds)
    spread = spread + lost * _BLIND_PX**2 * np.eye(len(spread))
    fit = _fit_of(state, spread * tapered.inflation, reference, converged=converged)
    return fit, curvature.least_share, _least_detail(tapered, at)


def _bent(
    taper: Callable[..., Tapered], state: State, tapered: Tapered, now: Score, reference: int
) -> Curvature:
    def seen(offset_px: Shifts) -> Array:
        return taper(offset_px).spectra

    return state.curvatures(tapered.spectra, seen, now.information, reference)[0]


def _first(
    at: Frequencies, spectra: Array, offset_px: Shifts, gain: Floats, pattern: float = -np.inf
) -> State:
    """Return where a search begins, beside a pattern with this logarithm of its power."""
    spectrum = first_spectrum(at, spectra, at.steering(offset_px, gain), pattern)
    return State(offset_px.copy(), np.log(gain), spectrum)


def _free(count: int, kinds: int, reference: int) -> NDArray[np.intp]:
    """Return the numbers of the parameters of all frames but the reference."""
    return np.delete(np.arange(kinds * count), kinds * reference + np.arange(kinds))


def likely_steps(
    frames: Array,
    valid: Mask,
    fit: ShiftFit,
    parts: list[tuple[slice, slice]],
    *,
    reference: int,
    photometric: bool,
) -> list[tuple[Shifts, Shifts]]:
    """Return how far from a fit of the whole parts of the sensor take the frames to lie.

    Each part, all of one size, with its own spectrum, freed at the shifts of the whole, and one
    step of Newton from these: beside them the likelihood is a parabola. Steps and standard errors
    [frame 2] of each.
    """
    count, kinds = len(frames), 3 if photometric else 2
    tapers = []
    frames = shown_everywhere(frames, valid, fit.offset_px)
    for rows, cols in parts:
        part = frames[:, rows, cols]
        flank_px = quiet_flank_px(part, fit.offset_px, own_mean=photometric)
        tapers.append(partial(taper_frames, part, own_mean=photometric, flank_px=flank_px))
    tapered = [taper(fit.offset_px) for taper in tapers]

    def seen(offset_px: Shifts) -> Array:
        return np.concatenate([taper(offset_px).spectra for taper in tapers])

    shape = (count, *tapered[0].window.shape[1:])
    at = Frequencies.of(shape, whole_plane=frames.dtype.kind == "c", sets=len(parts))
    y = np.concatenate([one.spectra for one in tapered])
    # What moves in a part would pass for a pattern of its own.
    log_pattern = 2.0 * float(np.log(fit.pattern_sigma)) if fit.pattern_sigma > 0 else -np.inf
    state = _first(at, y, fit.offset_px, fit.gain, log_pattern)
    for _ in range(_FREE_ROUNDS):
        learned = state.spectrum.learned(y, state.steering, whole=False)
        state.spectrum = learned.spectrum.freed(learned.power)
    now = state.score(y, kinds, whole=False)
    bent = state.curvatures(y, seen, now.information, reference)
    free = _free(count, kinds, reference)
    found = []
    for number, (curvature, one) in enumerate(zip(bent, tapered, strict=True)):
        step = np.zeros((count, kinds))
        step.ravel()[free], spread = newton(*now.of(number, free), curvature, kinds)
        spread *= one.inflation / max(float(valid[:, *parts[number]].mean()), 1e-12)
        own = _fit_of(state, spread, reference, converged=True)
        found.append((step[:, :2], own.sigma_px))
    return found


def _least_detail(tapered: Tapered, at: Frequencies) -> Floats:
    """Return the direction [2] in which the frames have least detail: along an edge."""
    power = at.weight * np.sum(np.abs(tapered.spectra) ** 2, axis=1)
    return np.asarray(np.linalg.eigh((at.own * power) @ at.own.T)[1][:, 0])


def with_given(fit: ShiftFit, given_px: Shifts, sigma_px: Shifts | None, *, said: bool) -> ShiftFit:
    """Return the fit with what is known beside the frames.

    Measured offsets count by their errors; planned ones, or that there are none, say at least that
    no shift is larger than some pixels.
    """
    told = np.full(given_px.shape, USUAL_SHIFT_PX) if sigma_px is None else sigma_px
    covariance = fit.covariance_px2
    gain = np.linalg.solve(covariance + np.diag(told.ravel() ** 2), covariance).T
    away_px = (gain @ (fit.offset_px - given_px).ravel()).reshape(-1, 2)
    return replace(
        fit,
        offset_px=fit.offset_px - away_px if said else fit.offset_px,
        covariance_px2=covariance - gain @ covariance,
    )


def _fit_of(state: State, spread: Array, reference: int, *, converged: bool) -> ShiftFit:
    """Return the shifts, with the covariance of the parameters of all frames but the reference."""
    count = len(state.offset_px)
    kinds = len(spread) // (count - 1)
    covariance = np.zeros((2 * count, 2 * count))
    places = np.delete(np.arange(2 * count), [2 * reference, 2 * reference + 1])
    shifts = np.arange(len(spread)) % kinds < 2
    covariance[np.ix_(places, places)] = spread[np.ix_(shifts, shifts)]
    return ShiftFit(
        offset_px=state.offset_px, covariance_px2=covariance, gain=np.exp(state.log_gain),
        noise_sigma=float(np.sqrt(state.spectrum.noise_power[0])), converged=converged,
        pattern_sigma=float(np.exp(0.5 * state.spectrum.log_pattern[0])),
    )  # fmt: skip
