"""What cannot say what is before it: pixels at an end of the range, stuck, blank, and copies."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.ndimage import maximum_filter, minimum_filter, uniform_filter

from lensshift.core import defects
from lensshift.core.arrays import Array, Floats, Mask
from lensshift.core.errors import warn_quality
from lensshift.core.phasors import has_phasors
from lensshift.core.types import Burst
from lensshift.forward.operator import LinearOperator

# An end of the range is one where the outermost value is more frequent than the next by so many
# standard errors; of noise it is the rarest.
SURE = 3.0
# So few are never surely more than one.
FEW = 11
# Ends of the ranges of cameras: of numbers up to 1, and of 8 to 16 bits. More than so many pixels
# there are no glints.
ENDS, TELLING_SHARE = (1.0, *(2.0**bits - 1 for bits in range(8, 17))), 0.05
# Around a pixel whose noise is looked for; a tenth cut off leaves 0.84 of the variance of noise.
AROUND_PX, CUT_SHARE = 3, 0.1
# Of the range, by the converters of cameras with 16 bits.
FINEST_STEP = 2.0**-16
# Of the frames at a place; and of what a pixel sees, so that it is near one.
MOST, SEEN_SHARE = 0.5, 1e-3
SAME = 1e-6  # what single precision leaves of a frame without noise that is moved
# Frames that lie less apart than a square of four does leave a point of light where it is.
TELLING_MOVE_PX = 0.4


def clipped_pixels(values: Array, used: Mask) -> Mask | None:
    """Return the pixels [frame row col] that were cut off at an end of the range, None if none.

        y = min(max(A x + n, low), high):   c(high) > c(next) + 3 sqrt(c(high) + c(next)),
        c how many pixels have a value

    Also those of surfaces whose noise is less than the step between two values, if they are the
    darkest or the brightest: they tell no noise either.

    Parameters
    ----------
    values : [frame row col] real
    used : [frame row col] where values count
    """
    seen = values[used]
    if not seen.size:
        return None
    found: Mask | None = None
    for end, outermost in ((seen.max(), np.max), (seen.min(), np.min)):
        at_end = seen == end
        count = np.count_nonzero(at_end)
        if count <= FEW:
            continue
        if count == seen.size:  # one value is no range
            return None
        others = seen[~at_end]
        beside = np.count_nonzero(others == outermost(others))
        if count - beside > SURE * np.sqrt(count + beside):
            clipped = used & (values == end)
            found = clipped if found is None else found | clipped
    return found


def silent_pixels(values: Array, clipped: Mask | None) -> Mask:
    """Return the pixels [frame row col] that tell no noise: many around are clipped, or all alike.

    Lone ones, as of salt and pepper, are outliers. Alike are those that differ by less than the
    finest converter would tell apart, as where simulated light and its shot noise are nothing.
    """
    highest, lowest = values.max(axis=0), values.min(axis=0)
    step = FINEST_STEP * float(highest.max() - lowest.min())
    around = maximum_filter(highest, AROUND_PX) - minimum_filter(lowest, AROUND_PX)
    silent = around <= step
    if clipped is not None:
        silent |= uniform_filter(clipped.mean(axis=0), AROUND_PX) > CUT_SHARE
    return np.broadcast_to(silent, values.shape)


def beside(A: LinearOperator, clipped: Mask, scale: int) -> Mask:
    """Return the pixels [frame row col] within a pixel of what most frames show clipped.

    What is brighter than the camera can say is no mean of anything there. Where few frames are
    clipped, something moved, and they may say so.
    """
    one = np.ones(clipped.shape, np.float32)
    most = A.adjoint(clipped * one) > MOST * A.adjoint(one)
    near = maximum_filter(most, 2 * scale + 1).astype(np.float32)
    return np.asarray(A.forward(near) > SEEN_SHARE)


def overexposed(values: Array, clipped: Mask | None) -> str | None:
    """Say how much of the frames is at the bright end of a range, and what to do, if much is.

    Parameters
    ----------
    values : [frame row col] the frames as the camera gave them
    clipped : as from `clipped_pixels`
    """
    if clipped is None or not clipped.any():
        return None
    end = float(values[clipped].max())
    share = float(np.mean(values[clipped] == end)) * float(np.mean(clipped))
    if end not in ENDS or share < TELLING_SHARE:
        return None
    return (
        f"{100 * share:.0f} % of the pixels are at {end:g}, the end of their range: what is "
        "brighter is lost there, also in the picture (expose for a shorter time)"
    )


def without_blank(burst: Burst, used: Sequence[int]) -> tuple[Burst, list[str]]:
    """Return the burst without those used frames that show nothing, where others show something.

    And what is to be said of them.
    """
    blank = defects.blank_frames(burst.amplitude, burst.valid)
    blank &= np.isin(np.arange(burst.frame_count), used)
    if blank.sum() in (0, len(used)):
        return burst, []
    return replace(burst, valid=burst.valid & ~blank[:, None, None]), [
        f"frame {', '.join(map(str, np.flatnonzero(blank)))}: all valid pixels are alike, as where "
        "a shutter stayed closed; left out"
    ]


def without_copies(burst: Burst, used: Sequence[int]) -> tuple[Burst, list[str]]:
    """Return the burst without those used frames that are copies of an earlier one.

    And what is to be said of them. Their noise is that of the other one: it would seem to be less.
    One that was told to lie elsewhere is a copy if the move would show.
    """
    copies = defects.copied_frames(burst.amplitude[list(used)])
    places = [(used[k], used[of]) for k, of in copies.items()]
    apart_px = {k: burst.offset_px[k] - burst.offset_px[of] for k, of in places}
    copied = [
        (k, of)
        for k, of in places
        if not apart_px[k].any() or _shows(burst.amplitude[k], burst.valid[k], apart_px[k])
    ]
    if not copied or burst.affine is not None:
        return burst, []
    said = ", ".join(f"{k} (of {of})" for k, of in copied[:3]) + (" ..." if copied[3:] else "")
    valid = np.array(burst.valid)
    valid[[k for k, _ in copied]] = False
    elsewhere = any(apart_px[k].any() for k, _ in copied)
    why = "they are told to lie elsewhere" if elsewhere else "noise would seem to be less"
    return replace(burst, valid=valid), [
        f"copies of frames, noise and all, are left out: frame {said}. They tell nothing new, and "
        f"{why}. Were they handed out twice?"
    ]


def _shows(frame: Array, valid: Mask, move_px: Floats) -> bool:
    """Return whether a frame [row col] would be another one if what it shows had moved so far."""
    from scipy.ndimage import shift

    moved = shift(np.where(valid, frame, 0), move_px, order=1, cval=np.nan)
    beyond = ~np.isfinite(moved) | ~valid
    same = np.isclose(moved, frame, rtol=SAME, atol=SAME * float(np.abs(frame[valid]).max()))
    return not np.all(same | beyond)


def measured(burst: Burst) -> tuple[Burst, list[str]]:
    """Return the burst without pixels that stay, or have no phasor, while the scene moves.

    And what is to be said of them; what they are ends at the colon.
    """
    valid, waves = burst.valid, has_phasors(burst)
    across = np.ptp(burst.offset_px, axis=0) >= TELLING_MOVE_PX
    stuck = np.zeros(valid.shape[1:], np.bool_)
    lights = [burst.amplitude, *(() if burst.phasors is None else burst.phasors)]
    lights = [np.abs(one) if one.dtype.kind == "c" else one for one in lights]
    for y in lights if across.any() else ():
        if (found := defects.stuck_pixels(y, valid, phasors=waves)) is not None:
            stuck |= found
        if across[1]:
            stuck |= defects.offset_columns(y, valid) & valid.all(axis=0)
        if across[0]:
            rows = defects.offset_columns(y.swapaxes(1, 2), valid.swapaxes(1, 2))
            stuck |= rows[:, None] & valid.all(axis=0)
    nothing = defects.not_measured(lights, valid & ~stuck) if waves else stuck[None] & False
    said: list[str] = []
    for bad, what in (
        (stuck, "pixels that do not follow the scene are left out as defective"),
        (nothing.any(axis=0), "phasors of 0 in the midst of light are left out as not measured"),
    ):
        if bad.any():
            at = [f"({row}, {col})" for row, col in np.argwhere(bad)]
            shown = f"{len(at)}, at (row, col) " + ", ".join(at[:3]) + (" ..." if at[3:] else "")
            said.append(f"{what}: {shown} (mark such pixels False in valid)")
    left = valid & ~(stuck | nothing)
    return (burst if np.array_equal(left, valid) else replace(burst, valid=left)), said


def warn_of_blind_frames(burst: Burst, used: tuple[int, ...], *, stacklevel: int) -> None:
    """Warn of frames that lie as far away as the sensor is large, and so tell nothing."""
    away_px = np.abs(burst.offset_px[list(used)])
    blind = np.any(away_px >= burst.grid.shape, axis=1)
    if np.any(blind) and not np.all(blind):  # of which none would see the scene
        numbers = ", ".join(str(used[k]) for k in np.flatnonzero(blind))
        warn_quality(
            f"of frame {numbers} nothing is used: offset_px moves content out of the picture, by "
            f"{away_px[blind].max():.4g} px; it is in LR pixels",
            stacklevel + 1,
        )
