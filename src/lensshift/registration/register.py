"""One call: a burst goes in, the same burst with its shifts found from the frames comes out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from lensshift.core import defects
from lensshift.core.arrays import Array, Floats, Mask, Shifts
from lensshift.core.errors import warn_quality
from lensshift.core.phasors import has_phasors, phasor_frames
from lensshift.core.types import Burst, expect_burst
from lensshift.registration import blocks
from lensshift.registration.affine import AffineFit, affine_motion, turning
from lensshift.registration.gradient import gradient_shifts, texture_covariance
from lensshift.registration.light import light_allowed_for
from lensshift.registration.likelihood import UNKNOWN_PX, USUAL_SHIFT_PX, ShiftFit, with_given
from lensshift.registration.phase import phase_fit, phase_shifts, rival_shifts, unlike_frames
from lensshift.registration.picture import LEAST_FRAMES, better_shifts

Method = Literal["auto", "gradient", "phase"]
Motion = Literal["auto", "shift", "affine"]
METHODS: tuple[Method, ...] = ("auto", "gradient", "phase")
Channel = Literal["auto", "amplitude", "distance", "phasor"]
Run = Callable[..., ShiftFit]

POOR_SIGMA_PX = 0.05  # more than twice the budget of a calibration
# Phase correlation knows the shift to about this much; given offsets nearer to it are kept.
AGREES_PX = 0.5
UNLIKE = "shows nothing of the scene of most others"
_SEARCH: dict[Method, Run] = {
    "auto": blocks.likely_where_telling,
    "gradient": gradient_shifts,
}
_CLEARLY_BETTER = 0.7  # noise that one fit leaves over that of the other


def register(
    burst: Burst,
    *,
    method: Method = "auto",
    reference: int = 0,
    channel: Channel = "auto",
    motion: Motion = "auto",
    photometric: bool | None = None,
    use_given: bool = False,
    frames: Sequence[int] | None = None,
) -> Burst:
    """Return the burst with its offsets found from the frames themselves.

    Parameters
    ----------
    burst : frames of one scene, moved by up to a few pixels. Its own offsets are one of the
        starting points
    method : "auto": maximum likelihood with aliases and noise in the model (`likely_shifts`), or
        through the picture if that predicts six frames or more better (`better_shifts`);
        "gradient": least squares on low-passed frames (`gradient_shifts`), faster; "phase": phase
        correlation with one frame, roughest
    reference : number of the frame whose offset is kept; the others are relative to it, and so
        are the standard errors, which are 0 there. Where no offset is known, their mean is 0.
        A frame that shows less than half of what others do, or another scene than most, is none:
        the next one that does
    channel : "amplitude", "distance" or "phasor", which pixels average where they see two
        distances; "auto": phasor if distances of one modulation frequency, or the phasors
        themselves, are there, else amplitude (complex frames are used whole)
    motion : "affine": frames also turn, grow and shear against the reference, which `reconstruct`
        then allows for (method "auto", four frames and more); "auto": if they show that they do;
        "shift": never
    photometric : whether frames may differ by a factor and an additive constant; None: if they
        show that the light is another one
    use_given : whether the burst's own offsets count as measurements with `offset_sigma_px`
        (method "auto" only)
    frames : numbers of the frames whose shifts are found, by default all; the others are left out
        as those that show nothing are

    Returns
    -------
    Burst
        with `offset_px`, `offset_sigma_px`, offset_source "registered", and `affine` if asked for

    Raises
    ------
    ValueError
        If an argument is unknown or out of range, or the burst lacks what was asked for.

    Warns
    -----
    QualityWarning
        If a shift has a standard error above 0.05 px or may be another one (scenes that repeat,
        without planned offsets), the frames turn or grow though nobody said so, the search
        did not settle, the light of frames differs, or a frame has less than half of the valid
        pixels of others or shows another scene.
    """
    _check(burst, method, motion, reference, use_given)
    images = frames_of(burst, channel)
    everything, kept = burst, _seen(burst, images, frames)
    if len(kept) < burst.frame_count:
        burst, images = burst.select(kept.tolist()), images[kept]
        reference = int(np.searchsorted(kept, reference)) % len(kept)
    valid, images, whole = _scaled(burst, images)
    phase_px = phase_shifts(whole, reference)
    foreign = unlike_frames(whole, phase_px, reference)
    if foreign.any():
        say_left_out(kept[foreign], UNLIKE, burst)
        return register(
            everything, method=method, reference=int(kept[reference]), channel=channel,
            motion=motion, photometric=photometric, use_given=use_given,
            frames=kept[~foreign].tolist(),
        )  # fmt: skip
    asked = photometric if channel != "distance" else bool(photometric)
    gain, own_light = light_allowed_for(whole, phase_px, asked, kept)
    images, whole = images / gain, whole / gain
    _say_doubts(burst, channel, valid, kept, photometric=own_light)
    given_px = burst.offset_px - burst.offset_px[reference]
    known, affine, factor = bool(np.any(given_px)), None, 1.0
    if method == "phase":
        fit = phase_fit(whole, valid, phase_px, reference)
    else:
        if method == "gradient" and np.iscomplexobj(images):
            images = np.abs(images)
        run: Run = partial(_SEARCH[method], reference=reference, photometric=own_light)
        fit = _from_best_start(run, images, valid, given_px, phase_px, keep_given=use_given)
        if method == "gradient":
            fit = _widened(run, images, valid, fit)
        else:
            fit, affine, factor = _checked(fit, images, whole, valid, motion, reference, own_light)
            told_px = burst.offset_sigma_px if use_given else None
            told_px = None if told_px is None else np.hypot(told_px, told_px[reference])
            fit = with_given(fit, given_px, told_px, said=known)
    alone = method == "phase" or not known
    rivals_px = rival_shifts(whole, fit.offset_px, reference) if alone else np.zeros_like(given_px)
    sigma_px = np.hypot(fit.sigma_px, rivals_px)
    _warn_if_poor(sigma_px, rivals_px, kept, converged=fit.converged, apart=factor)
    offset_px = fit.offset_px + burst.offset_px[reference]
    if burst.offset_source == "unknown":
        offset_px -= offset_px.mean(axis=0)
    found = {"offset_px": offset_px, "offset_sigma_px": sigma_px, "affine": affine}
    return replace(everything, **_of_all(everything, kept, found), offset_source="registered")


def _seen(burst: Burst, images: Array, frames: Sequence[int] | None) -> NDArray[np.intp]:
    """Return the numbers of those frames whose valid pixels tell a shift; warn of others."""
    numbers = np.arange(burst.frame_count)
    asked = np.isin(numbers, numbers if frames is None else frames)
    if frames is not None and asked.sum() < len(frames):
        raise ValueError(f"expected frames from 0 to {numbers[-1]}, each once, got {list(frames)}")
    count = burst.valid.sum(axis=(1, 2)) * asked
    few = (count < max(1.0, blocks.LEAST_VALID * count.max())) & asked
    blank = defects.blank_frames(images, burst.valid) & asked
    kept = np.flatnonzero(asked & ~few & ~blank)
    if len(kept) < 2:
        said = f"expected valid pixels that differ in at least 2 frames, got {len(kept)}"
        raise ValueError(f"{said}; give the shifts")
    for lost, why in (
        (few, "less than half as many pixels as in others are valid"),
        (blank & ~few, "all valid pixels are alike"),
    ):
        if lost.any():
            say_left_out(np.flatnonzero(lost), f"{why}, which does not tell its shift", burst)
    return kept


def _scaled(burst: Burst, images: Array) -> tuple[Mask, Array, Array]:
    """Return which pixels count, the images up to 1, whose squares exist, and these filled."""
    light = np.abs(images) if np.iscomplexobj(images) else images
    stuck = defects.stuck_pixels(light, burst.valid)
    valid = burst.valid if stuck is None else burst.valid & ~stuck
    scaled = images / (np.max(np.abs(images), where=valid, initial=0.0) or 1.0)
    return valid, scaled, blocks.filled(scaled, valid)


def _say_doubts(
    burst: Burst, channel: Channel, valid: Mask, kept: NDArray[np.intp], *, photometric: bool
) -> None:
    images = frames_of(burst, channel)
    doubts = [defects.repeated_frame(images, kept.tolist())]
    if channel != "distance":
        doubts.append(defects.colour_mosaic(images, valid))
        names = kept.tolist()
        doubts.append("" if photometric else defects.unequal_brightness(images, valid, names))
    for said in filter(None, doubts):
        warn_quality(said, 3)


def say_left_out(numbers: NDArray[np.intp], why: str, burst: Burst | None) -> None:
    """Warn that frames do not count; None: of a scan, whose shifts are all found."""
    given = burst is not None and burst.offset_source != "unknown"
    done = "taken as given" if given else "left out"
    warn_quality(f"frame {', '.join(map(str, numbers[:9]))}: {why}; {done}", 4)


def _of_all(burst: Burst, kept: NDArray[np.intp], found: dict[str, Any]) -> dict[str, Any]:
    """Return fields of all frames from those of some of them.

    The others keep their shift, which is as good as unknown; where none was given they are not
    valid.
    """
    if len(kept) == burst.frame_count:
        return found
    shown = np.isin(np.arange(burst.frame_count), kept)
    whole: dict[str, Any] = {
        "offset_px": np.array(burst.offset_px),
        "offset_sigma_px": np.full(burst.offset_px.shape, USUAL_SHIFT_PX),
        "affine": None if found["affine"] is None else np.zeros((len(shown), 2, 2)),
    }
    for name, values in found.items():
        if values is not None:
            whole[name][shown] = values
    if burst.offset_source == "unknown":
        whole["valid"] = burst.valid & shown[:, None, None]
    return whole


def frames_of(burst: Burst, channel: str) -> Array:
    """Return the frames of a channel in double precision."""
    if channel not in get_args(Channel):
        raise ValueError(
            f"expected a channel among {', '.join(get_args(Channel))}, got {channel!r}"
        )
    frames: Array | None = burst.amplitude
    if channel == "distance":
        frames = burst.distance_m
    elif channel != "amplitude" and has_phasors(burst):
        frames = phasor_frames(burst)
    elif channel == "phasor":
        raise ValueError(
            "the burst has no phasors, nor distances of one modulation_hz with amplitudes of at "
            "least 0; expected channel amplitude"
        )
    if frames is None:
        raise ValueError("the burst has no distance_m; expected channel amplitude")
    return frames.astype(np.complex128 if frames.dtype.kind == "c" else np.float64)


def _checked(
    fit: ShiftFit, images: Array, whole: Array, valid: Mask, motion: Motion, reference: int,
    photometric: bool,
) -> tuple[ShiftFit, Floats | None, float]:  # fmt: skip
    """Return the fit with errors that parts and pictures bear out, or one that is better.

    How frames turn, if that is asked for or they show it, and by how much more than their errors
    say the parts disagree: turning explains it, and pictures have their own scatter.
    """
    alike = _alike(whole, fit, photometric)
    apart = blocks.scatter_of_parts(images, valid, fit, reference, photometric=photometric)
    likely = replace(fit, covariance_px2=apart.widened(fit.covariance_px2))
    better = better_shifts(likely, alike, valid, reference)
    kept = np.array_equal(better.offset_px, fit.offset_px)
    turns = _turns(better, alike, valid, motion, reference)
    if turns is None:
        return better, None, apart.factor if kept else 1.0
    own = np.diag(turns.sigma_px.ravel() ** 2)
    own[2 * reference : 2 * reference + 2] = 0.0
    before = fit if kept else better
    turned = replace(
        before, offset_px=turns.offset_px, covariance_px2=before.covariance_px2 + own,
        converged=before.converged and turns.settled,
    )  # fmt: skip
    return turned, turns.affine, 1.0


def _turns(
    fit: ShiftFit, frames: Array, valid: Mask, motion: Motion, reference: int
) -> AffineFit | None:
    """Return how frames turn, if that is asked for or they show it."""
    # Along a single edge frames may lie anywhere, and then turn as they like.
    if motion == "shift" or (motion == "auto" and np.any(fit.sigma_px > UNKNOWN_PX)):
        return None
    find = turning if motion == "auto" else affine_motion
    found = find(frames, valid, fit.offset_px, reference=reference)
    if found is not None and motion == "auto":
        warn_quality(
            f"the frames do not only shift but differ {found.said(frames.shape[1:])}, which is "
            'allowed for: motion="shift" of register (--motion shift) would not',
            4,
        )
    return found


def _check(burst: Burst, method: str, motion: str, reference: int, use_given: bool) -> None:
    expect_burst(burst)
    for word, given, known in (("method", method, METHODS), ("motion", motion, get_args(Motion))):
        if given not in known:
            raise ValueError(f"expected a {word} among {', '.join(known)}, got {given!r}")
    if motion == "affine" and method != "auto":
        raise ValueError(f'expected method "auto" with motion "affine", got {method!r}')
    count = burst.frame_count
    if motion == "affine" and count < LEAST_FRAMES:
        raise ValueError(f"expected at least {LEAST_FRAMES} frames to tell turns, got {count}")
    if count < 2:
        raise ValueError(f"expected at least 2 frames to register, got {count}")
    if not 0 <= reference < count:
        raise ValueError(f"expected a reference from 0 to {count - 1}, got {reference}")
    if use_given and burst.offset_sigma_px is None:
        raise ValueError("the burst has no offset_sigma_px that its offsets could be weighed by")
    if use_given and method != "auto":
        raise ValueError(f'expected method "auto" with use_given, got {method!r}')


def _from_best_start(
    run: Run, frames: Array, valid: Mask, given_px: Shifts, phase_px: Shifts, *, keep_given: bool
) -> ShiftFit:
    """Fit from the given offsets; where phase correlation says otherwise, from both.

    Patterns that repeat have several shifts that fit; the given ones win unless others fit
    clearly better.
    """
    said = bool(np.any(given_px != 0.0))
    if keep_given or (said and float(np.abs(phase_px - given_px).max()) < AGREES_PX):
        return run(frames, valid, given_px)
    if not said:
        return run(frames, valid, phase_px)
    first, second = run(frames, valid, given_px), run(frames, valid, phase_px)
    return second if second.noise_sigma < _CLEARLY_BETTER * first.noise_sigma else first


def _alike(frames: Array, fit: ShiftFit, photometric: bool) -> Array:
    """Return the frames without their own gain and level, where these may differ."""
    if not photometric:
        return frames
    level = frames.mean(axis=(1, 2), keepdims=True)
    return np.asarray((frames - level) / fit.gain[:, None, None])


def _widened(run: Run, frames: Array, valid: Mask, fit: ShiftFit) -> ShiftFit:
    """Return the fit with errors that the scatter over the sensor and the texture bear out."""

    def estimate(part: Array, part_valid: Mask) -> tuple[Shifts, Shifts]:
        found = run(part, part_valid, fit.offset_px, max_iterations=8)
        return found.offset_px, found.sigma_px

    factor = blocks.scatter_over_blocks(estimate, frames, valid, fit.offset_px).factor
    count = len(frames)
    texture = texture_covariance(frames, valid, fit.offset_px, fit.noise_sigma)
    apart = (fit.sigma_px > 0).astype(np.float64)
    floor = np.kron(np.eye(count), texture) * np.outer(apart.ravel(), apart.ravel())
    return replace(fit, covariance_px2=fit.covariance_px2 * factor**2 + floor)


def _warn_if_poor(
    sigma_px: Shifts, rivals_px: Shifts, kept: NDArray[np.intp], *, converged: bool, apart: float
) -> None:
    """Warn of shifts [frame 2] that are poorly known, of the frames with these numbers."""
    if not converged:
        cure = "are these frames of one still scene?"
        warn_quality(f"the search for the shifts did not settle; {cure}", 3)
    unsure = int(np.argmax(np.hypot(*rivals_px.T)))
    if np.any(rivals_px):
        down, right = rivals_px[unsure]
        warn_quality(
            f"the scene repeats or shows little: frame {kept[unsure]} may as well lie "
            f"({down:+.0f}, {right:+.0f}) px elsewhere; planned offset_px would tell",
            3,
        )
        return
    worst = np.unravel_index(int(np.argmax(sigma_px)), sigma_px.shape)
    worst_px, number = float(sigma_px[worst]), int(kept[worst[0]])
    if worst_px > POOR_SIGMA_PX and apart**2 > 2.0:  # the larger part of the variance
        warn_quality(
            f"parts of the frames disagree on shifts by {apart:.1f} times their errors: that of "
            f"frame {number} is known to {worst_px:.3g} px only (want {POOR_SIGMA_PX} px); does "
            "something move (then mark it as not valid), or is there little to see in a part? Take "
            "a scene with more edges, or give the shifts",
            3,
        )
    elif not worst_px <= POOR_SIGMA_PX:
        along = ("row", "col")[int(worst[1])]
        warn_quality(
            f"too little texture along {along}: the shift of frame {number} is known to "
            f"{worst_px:.3g} px only (want {POOR_SIGMA_PX} px); take more light or a scene with "
            "edges across it, or give the shifts",
            3,
        )
