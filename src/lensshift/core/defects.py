"""What frames of one still scene cannot show: stuck pixels, other exposures, a colour mosaic."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lensshift.core.arrays import Array, Mask
from lensshift.core.order import median_of_known

# A pixel is stuck if it stands out of its neighbours, in all frames, by this many times what they
# and it change by: a point of light that moves by a quarter pixel behind a lens of 0.2 px lends a
# neighbour a tenth of itself.
STANDS_OUT = 10.0
# And by this part of the standard deviation of the frames: less does little harm, and a flat hill
# whose top is one level of a converter higher does so, too. A phasor of no light beside some has no
# phase, however much brighter others are: there it is this part of the light beside it.
LEAST_CONTRAST = 0.5
# Of the pixels of a row that lives, so many at most are the same in all frames: noise changes all.
MOST_STILL = 0.5
# And of all pixels where noise shows: if more are still, it is below the levels of a converter. Of
# so many frames, as of noise of one level half of the frames read alike.
FEW_STILL, LEAST_STILL = 0.1, 16
# What enters and leaves a picture at its borders changes its mean by a few hundredths of the
# standard deviation of its pixels; half of that is another exposure or another light.
OTHER_LIGHT = 0.5
# Of the standard deviation of a frame: rows and columns of real frames, odd against even, differ by
# up to 0.03, those behind the filters of a colour camera by some 0.5.
MOSAIC = 0.1
# What shows by chance once in a million: five standard errors.
NO_CHANCE = 5.0
LEAST_BLOCKS = 16  # of 2 x 2 pixels; fewer say nothing of how they scatter
# Fewer frames show no change that noise would not.
LEAST_FRAMES = 3


def stuck_pixels(frames: Array, valid: Mask | None = None, *, phasors: bool = False) -> Mask | None:
    """Return the pixels [row col] that do not follow a scene that moves, None if there are none.

        min_k y - max_k of 8 neighbours > 10 max over the 9 of (max_k y - min_k y),   or below them

    Hot and dead pixels lie at one place in all frames: they hold shifts that are looked for at 0,
    and the picture shows them as squares. So do rows and columns that never change between others
    that do. The frames have to lie apart by a good part of a pixel.

    Parameters
    ----------
    frames : [frame row col] real
    valid : [frame row col], None: all pixels are; neighbours that are not count as alike
    phasors : whether the frames are of moduli
    """
    if len(frames) < LEAST_FRAMES or min(frames.shape[1:]) < 3:
        return None
    used = np.ones(frames.shape, np.bool_) if valid is None else valid
    highest = np.where(used, frames, -np.inf).max(axis=0)
    lowest = np.where(used, frames, np.inf).min(axis=0)
    most, least = _of_neighbours(highest, np.maximum), _of_neighbours(lowest, np.minimum)
    change = np.maximum(highest - lowest, 0.0)  # -inf where a pixel is never valid
    change = STANDS_OUT * np.maximum(change, _of_neighbours(change, np.maximum))
    contrast = LEAST_CONTRAST * float(np.std(frames[used]))
    below = np.minimum(contrast, LEAST_CONTRAST * least) if phasors else contrast
    stuck = np.isfinite(most) & (lowest - most > np.maximum(change, contrast))
    stuck |= np.isfinite(least) & (least - highest > np.maximum(change, below))
    still = highest == lowest
    stuck |= _still_rows(still)[:, None] | _still_rows(still.T)
    stuck &= used.all(axis=0)
    return stuck if stuck.any() else None


def still_pixels(frames: Array, valid: Mask) -> Mask:
    """Return the pixels [row col] that are the same bit by bit in 16 frames or more.

    Where noise changes nearly all pixels, what it does not change is no measurement: a dead pixel
    in the dark, too, which does not stand out.
    """
    known = np.asarray(valid.all(axis=0))
    still = known & (frames == frames[0]).all(axis=0)
    few = np.count_nonzero(still) <= FEW_STILL * np.count_nonzero(known)
    return np.asarray(still & (few and len(frames) >= LEAST_STILL))


def offset_columns(frames: Array, valid: Mask) -> Mask:
    """Return the columns [col] that stand out of both neighbours by as much in all frames.

        min_k |c_k| > 10 (max_k c_k - min_k c_k)

    with c the median over rows of what a column is more than the mean of its neighbours,
    of one sign and more than of the neighbours, which change no more. Such a column follows the
    scene, but with an offset. The frames have to lie apart along a row by a good part of a pixel,
    as for `stuck_pixels`.

    Parameters
    ----------
    frames, valid : [frame row col]
    """
    found = np.zeros(frames.shape[2], np.bool_)
    used = np.asarray(valid.all(axis=0))
    whole: Mask = used[:, 1:-1] & used[:, :-2] & used[:, 2:]
    if len(frames) < LEAST_FRAMES or frames.shape[2] < 5 or not used.any():
        return found
    y = np.where(valid, frames, 0.0)  # of floats, also where frames are of unsigned integers
    spread = LEAST_CONTRAST * float(np.std(y if valid.all() else frames[:, used]))
    told = whole.mean(axis=0) > MOST_STILL
    # Means come first: they are cheap, and near the medians of a column that has an offset.
    mean = y.sum(axis=(0, 1)) / np.maximum(valid.sum(axis=(0, 1)), 1)
    if not np.any(told & (np.abs(mean[1:-1] - 0.5 * (mean[:-2] + mean[2:])) > 0.5 * spread)):
        return found
    inner = y[:, :, 1:-1] - 0.5 * (y[:, :, :-2] + y[:, :, 2:])
    of_column = np.zeros((len(frames), inner.shape[2]))
    known = np.where(whole, inner, np.nan)[:, :, told]
    of_column[:, told] = median_of_known(known, axis=1)
    least = np.abs(of_column).min(axis=0) * (np.ptp(np.sign(of_column), axis=0) == 0)
    change, most = np.zeros((2, frames.shape[2]))
    change[1:-1], most[1:-1] = np.ptp(of_column, axis=0), np.abs(of_column).max(axis=0)
    change = np.maximum(np.maximum(change[:-2], change[2:]), change[1:-1])
    limit = np.maximum(STANDS_OUT * change, spread)
    found[1:-1] = told & (least > limit) & (least > np.maximum(most[:-2], most[2:]))
    return found


def not_measured(lights: Sequence[Array], valid: Mask) -> Mask:
    """Return where [frame row col] a phasor is 0, but another one there is not, or those around.

    The others are more than ten levels of a converter; of the values up to there, noise rounds
    one in 21^2 off to 0, as phasors fill a disc, and more of them are 0 than by chance.

    Parameters
    ----------
    lights : [frame row col] modulus, of each frequency
    """
    found = np.zeros(valid.shape, np.bool_)
    for light in (one for one in lights if np.any(valid & (one == 0))):
        nothing, levels = valid & (light == 0), np.unique(light[valid])[:3]
        shown = STANDS_OUT * float(np.diff(levels).min(initial=np.inf))
        chance = np.count_nonzero(light[valid] <= shown) / (2 * STANDS_OUT + 1) ** 2
        if nothing.sum() <= chance + NO_CHANCE * np.sqrt(chance):
            continue
        around = np.stack([_of_neighbours(y, np.minimum) for y in np.where(valid, light, np.inf)])
        amid = np.isfinite(around) & (around > shown)
        found |= nothing & (amid | (np.max(lights, axis=0) > shown))
    return found


def _still_rows(still: Mask) -> Mask:
    """Return the rows that are still between two of which most pixels are not."""
    share = still.mean(axis=1)
    found = share == 1.0
    found[1:-1] &= np.maximum(share[:-2], share[2:]) < MOST_STILL
    found[[0, -1]] = False
    return np.asarray(found)


def blank_frames(frames: Array, valid: Mask | None = None) -> Mask:
    """Return which frames [frame] show nothing, as of a shutter that stayed closed.

        max y = min y over the valid pixels, of which there are two or more

    Parameters
    ----------
    frames : [frame row col], real or complex
    valid : [frame row col], None: all pixels are
    """
    used = np.ones(frames.shape, np.bool_) if valid is None else valid
    shown = [one[seen] for one, seen in zip(frames, used, strict=True)]
    return np.array([one.size > 1 and bool(np.all(one == one[0])) for one in shown])


def copied_frames(frames: Array) -> dict[int, int]:
    """Return which frames [frame row col] are another one bit by bit, noise and all, and which."""
    first, found = dict[int, int](), dict[int, int]()
    for number, frame in enumerate(frames):
        before = first.setdefault(hash(frame.tobytes()), number)
        if before < number and np.ptp(frame.real) > 0:
            found[number] = before
    return found


def repeated_frame(frames: Array, names: Sequence[int] | None = None) -> str:
    """Say that a frame [frame row col] is a copy of another one; or "". Their names: as below."""
    names = range(len(frames)) if names is None else names
    for number, before in copied_frames(frames).items():
        return (
            f"frame {names[number]} is a copy of frame {names[before]}, noise and all: it tells "
            "nothing new, and its shift is that of the other one. Was it handed out twice?"
        )
    return ""


def unequal_brightness(
    frames: Array, valid: Mask | None = None, names: Sequence[int] | None = None
) -> str:
    """Say that the brightness of frames of one still scene differs, as by exposure; or "".

    Parameters
    ----------
    frames : [frame row col]; complex ones by their modulus
    valid : [frame row col], None: all pixels are
    """
    used = np.ones(frames.shape, np.bool_) if valid is None else valid
    count = used.sum(axis=(1, 2))
    numbers = np.flatnonzero(2 * count >= count.max())  # the others show too little to say
    common = used[numbers].all(axis=0)
    if len(numbers) < 2 or common.sum() < 4 * LEAST_BLOCKS:
        return ""
    light = [frames[k][common] for k in numbers]
    light = [np.abs(one) if one.dtype.kind == "c" else one for one in light]
    mean, spread = (
        np.array([of(one, dtype=np.float64) for one in light]) for of in (np.mean, np.std)
    )
    if not np.ptp(mean) > OTHER_LIGHT * np.median(spread):
        return ""
    names = range(len(frames)) if names is None else names
    dark, bright = (names[int(numbers[pick(mean)])] for pick in (np.argmin, np.argmax))
    said = (
        f"the brightness of the frames differs: {mean.min():.4g} on average in frame {dark}, "
        f"{mean.max():.4g} in frame {bright}. Divide them by their exposure"
    )
    if frames.dtype.kind == "c":  # of which no gain can be estimated
        return said
    return f"{said}, or have gain and bias estimated: photometric=True (--photometric)"


def colour_mosaic(frames: Array, valid: Mask | None = None) -> str:
    """Say that pixels lie behind a mosaic of filters, which does not move with the scene; or "".

    Parameters
    ----------
    frames : [frame row col] real
    valid : [frame row col], None: all pixels are
    """
    if len(frames) < LEAST_FRAMES or frames.dtype.kind == "c" or min(frames.shape[1:]) < 4:
        return ""
    everywhere = np.ones(frames.shape, np.bool_) if valid is None else valid
    used: Mask = np.all(everywhere, axis=0)
    whole = (used & (_of_neighbours(used.astype(np.float64), np.minimum) > 0))[1:-1, 1:-1]
    plain = np.where(used, frames, 0.0)
    # Of what is around, weighed 1 2 1, each place has a quarter: the rest shows no ramp.
    rest = plain[:, 1:-1, 1:-1] - _one_two_one(_one_two_one(plain, 1), 2)
    blocks = _blocks_of_four(rest)[:, :, _blocks_of_four(whole[None])[0].all(axis=0)]
    if blocks.shape[2] < LEAST_BLOCKS:
        return ""
    stays = np.abs(blocks.mean(axis=(0, 2)))
    error = blocks.mean(axis=0).std(axis=1, ddof=1) / np.sqrt(blocks.shape[2])
    chance = NO_CHANCE * np.hypot(error, blocks.mean(axis=2).std(axis=0, ddof=1))
    if not np.any(stays > np.maximum(chance, MOSAIC * np.std(plain[:, used], axis=1).mean())):
        return ""
    return (
        "even and odd rows and columns differ alike in all frames, as behind the colour filters of "
        "a Bayer camera, which do not move with the scene; take the pixels of one colour, such as "
        "frames[:, ::2, 1::2], with half the offset_px and twice the pitch_mm"
    )


def _one_two_one(values: Array, axis: int) -> Array:
    ends = [values.take(range(k, values.shape[axis] - 2 + k), axis) for k in range(3)]
    return np.asarray(0.25 * (ends[0] + ends[2]) + 0.5 * ends[1])


def _blocks_of_four(values: Array) -> Array:
    """Return [frame place block] of the four places in blocks of 2 x 2 pixels."""
    count, rows, cols = len(values), values.shape[1] // 2, values.shape[2] // 2
    whole = values[:, : 2 * rows, : 2 * cols].reshape(count, rows, 2, cols, 2)
    return whole.transpose(0, 2, 4, 1, 3).reshape(count, 4, rows * cols)


def _of_neighbours(values: Array, least_or_most: np.ufunc) -> Array:
    """Return the least or the most [row col] of the eight neighbours that there are."""
    beyond = np.inf if least_or_most is np.minimum else -np.inf
    wide = np.full(np.add(values.shape, 2), beyond)
    wide[1:-1, 1:-1] = values
    beside = least_or_most(wide[:, :-2], wide[:, 2:])
    across = least_or_most(beside, wide[:, 1:-1])
    return np.asarray(least_or_most(least_or_most(across[:-2], across[2:]), beside[1:-1]))
