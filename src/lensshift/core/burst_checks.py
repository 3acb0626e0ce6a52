"""What the arrays of a burst must be like; a `DataError` names the field that is not."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lensshift.core import units
from lensshift.core.arrays import Array, Floats, Mask
from lensshift.core.errors import DataError
from lensshift.core.intrinsics import Intrinsics, Pinhole, PixelDirections

LEAST_SIZE = 1e-100  # of frames: squares of smaller values, and of its inverse, are no doubles
# Of the usual distance; numbers that stand for none lie farther from all that were measured.
APART = 0.1
_FAR = 100.0  # times the largest of all others: its light would be 10^4 times less
_MOST_CODES = 3  # at either end, as for too little, too much and scattered light
_CODES_MM = (4095, 8191, 16383, 32767, 65535)  # where counters of millimetres end
_CODE_MM = 0.01  # of metres in single precision
# Frames of one scene vary 2 to 20 times less from one to the next than columns do.
_ALIKE = 0.5
_BLOCK_PX = 8  # of which means hardly change when pictures move by a pixel
_ODD, _WAVE = 0.1, 0.1  # most of d0 + d2 - d1 - d3 / waves, least waves / light; root mean squares
_FEWEST_PX = (0, 10, 32)  # of cameras along rows and columns: shorter axes are none of pictures
# What SciPy filters in place of half and extended precision, which are formats of files.
_COMMON: dict[np.dtype[Any], type[np.generic]] = {
    np.dtype(np.float16): np.float32,
    np.dtype(np.longdouble): np.float64,
    np.dtype(np.clongdouble): np.complex128,
}


def as_array(values: ArrayLike, name: str) -> Array:
    """Return an array, of a list of images too if they are of one size."""
    try:
        return np.asarray(values)
    except ValueError as error:
        raise DataError("expected images of one size", field=name) from error


def as_frames(values: ArrayLike, name: str, shape: tuple[int, ...] | None = None) -> Array:
    """Return images [frame row col] of numbers, of this shape if one is given."""
    frames = as_array(values, name)
    if frames.dtype.kind not in "uifc":
        cure = "; load_image_stack reads files" if frames.dtype.kind == "U" else ""
        raise DataError(f"expected numbers, got dtype {frames.dtype}{cure}", field=name)
    if frames.ndim != 3:
        expected = f"expected [frame row col], got shape {frames.shape}"
        raise DataError(f"{expected}{cure_of_axes(frames.shape)}", field=name)
    if frames.size == 0:
        raise DataError(f"expected at least one pixel, got shape {frames.shape}", field=name)
    if shape is not None and frames.shape != shape:
        raise DataError(f"expected shape {shape} like amplitude, got {frames.shape}", field=name)
    native = frames.dtype.newbyteorder("=")
    return frames.astype(_COMMON.get(native, frames.dtype), copy=False)


def cure_of_axes(shape: tuple[int, ...]) -> str:
    """Say how frames are made of one image, or of arrays of four axes; or ""."""
    if len(shape) == 2:
        return "; one image alone is image[None]"
    if len(shape) == 4 and shape[-1] in (3, 4):
        return "; of colours, take one: frames[..., 1], or their mean: frames.mean(-1)"
    if len(shape) == 4 and 2 in shape[:2]:
        return "; of real and imaginary parts, make complex frames: re + 1j * im"
    if len(shape) == 4 and 4 in shape[:2]:
        return "; of four phases, make complex frames: (d0 - d2) + 1j * (d1 - d3)"
    return ""


def frames_axis(values: Array) -> int:
    """Return the axis of a stack along which frames seem to lie, 0 unless another is plain.

    Few frames of larger pictures, which change much less along that axis than along the first:
    the variance about the mean along an axis, noise alone has as much along both.
    """
    axis = int(np.argmin(values.shape))
    count = values.shape[axis]
    if values.dtype.kind not in "iufc" or not 1 < count < min(_FEWEST_PX[axis], len(values)):
        return 0
    plain = np.where(np.isfinite(values), np.abs(values), 0).astype(np.float32)
    first, other = (
        float(np.mean(np.var(plain, axis=one, ddof=1, dtype=np.float64))) for one in (0, axis)
    )
    return axis if other < _ALIKE * first else 0


def doubt_about_axes(frames: Array, offset_px: ArrayLike | None) -> str:
    """Say that frames seem to lie along another axis; DataError where offsets tell so; or ""."""
    count = None if offset_px is None else len(np.atleast_1d(np.asarray(offset_px)))
    others = [axis for axis in (1, 2) if frames.shape[axis] == count != frames.shape[0]]
    axis = others[0] if others else frames_axis(frames) if count is None else 0
    if not axis:
        return ""
    why = f"there are {count} offsets" if others else "pictures along it are as alike as frames"
    doubt = (
        f"expected [frame row col], got shape {frames.shape} where frames seem to lie along axis "
        f"{axis} ({why}): np.moveaxis(frames, {axis}, 0) puts them first"
        f"{', of a file --frame-axis last' * (axis == 2)}"
    )
    if others:
        raise DataError(doubt, field="amplitude")
    return f"amplitude: {doubt}"


def doubt_about_phases(frames: Array) -> str:
    """Say that frames seem to be the four phases of each position; or "".

    Of phases d0 + d2 = d1 + d3, while d0 - d2 and d1 - d3 are no share of the light, as they are
    of frames that differ by a gain. Means of blocks hardly change where pictures move.
    """
    count, *shape = frames.shape
    if count < 8 or count % 4 or frames.dtype.kind == "c" or min(shape) < 2 * _BLOCK_PX:
        return ""
    rows, cols = (np.arange(0, size, _BLOCK_PX) for size in shape)
    plain = np.where(np.isfinite(frames), frames, 0.0)
    means = np.add.reduceat(np.add.reduceat(plain, rows, 1), cols, 2).reshape(count, -1)
    at_each = f"frames.reshape({count // 4}, 4, *frames.shape[1:])"
    one_by_one = f"frames.reshape(4, {count // 4}, *frames.shape[1:]).swapaxes(0, 1)"
    orders = {at_each: means.reshape(count // 4, 4, -1)}
    orders[one_by_one] = means.reshape(4, count // 4, -1).swapaxes(0, 1)
    for told, d in orders.items():
        for a, b, e, f in ((0, 2, 1, 3), (0, 1, 2, 3)):
            light = np.mean(d, 1, keepdims=True)
            waves = np.stack([d[:, a] - d[:, b], d[:, e] - d[:, f]], 1)
            power = np.maximum(np.sum(light**2, -1, keepdims=True), np.finfo(float).tiny)
            rest = waves - light * (np.sum(waves * light, -1, keepdims=True) / power)
            wave = np.sum(rest**2, (1, 2))
            odd = np.sum((d[:, a] + d[:, b] - d[:, e] - d[:, f]) ** 2, -1)
            if np.all((odd < _ODD**2 * wave) & (wave > _WAVE**2 * power[:, 0, 0])):
                return (
                    f"amplitude: the frames look like the four phases of {count // 4} positions, "
                    f"not like pictures: with d = {told} give phasors, (d[:, {a}] - d[:, {b}]) + "
                    f"1j * (d[:, {e}] - d[:, {f}]), and modulation_hz"
                )
    return ""


def unmasked(valid: ArrayLike | None, *arrays: ArrayLike | None) -> ArrayLike | None:
    """Return `valid` but False where an array of `numpy.ma` is masked; None if nothing is told."""
    masks = [~np.ma.getmaskarray(one) for one in arrays if isinstance(one, np.ma.MaskedArray)]
    if not masks:
        return valid
    seen: Mask = np.logical_and.reduce(masks)
    return seen if valid is None else as_valid(np.asarray(valid), seen) & seen


def all_valid() -> Mask:
    """Return what stands for a mask of any shape without a False."""
    return np.ones((), np.bool_)


def as_valid(valid: Array, frames: Array) -> Mask:
    """Return a mask of the frames' shape in which not everything is False.

    One of the sensor, [row col], holds for all frames.
    """
    mask = np.asarray(True if valid is None else valid)
    if mask.ndim == 0 or mask.shape in (frames.shape[1:], (1, *frames.shape[1:])):
        mask = np.broadcast_to(mask, frames.shape)
    if mask.shape != frames.shape:
        problem = f"expected shape {frames.shape} like amplitude, got {mask.shape}"
        raise DataError(problem, field="valid")
    if mask.dtype.kind not in "bui":
        raise DataError(f"expected booleans, got dtype {mask.dtype}", field="valid")
    mask = mask.astype(np.bool_)
    if not mask.any():
        raise DataError("every pixel is marked invalid; nothing is left to use", field="valid")
    return mask


def check_finite_where_valid(values: Array, valid: Mask, name: str) -> None:
    """Refuse NaN and infinity in pixels that are to be used, and sizes that have no square."""
    if values.dtype.kind in "ui":
        return
    bad = np.count_nonzero(~np.isfinite(values) & valid)
    if bad == np.count_nonzero(valid):
        raise DataError("every valid pixel is NaN or infinite", field=name)
    if bad:
        problem = f"{bad} of {values.size} pixels are NaN or infinite; mark them False in `valid`"
        raise DataError(problem, field=name)
    with np.errstate(over="ignore"):
        largest = float(np.max(np.abs(values), where=valid, initial=0.0))
    if largest and not LEAST_SIZE <= largest <= 1 / LEAST_SIZE:
        problem = f"expected values of {LEAST_SIZE:g} to {1 / LEAST_SIZE:g}, got {largest:g}"
        raise DataError(f"{problem}; give them in another unit", field=name)


def doubt_about_distances(
    distance_m: Array | None, valid: Mask, frequencies_hz: tuple[float, ...]
) -> str:
    """Say what can hardly be meant by frequencies and distances; or ""."""
    typical_m = None if distance_m is None else float(np.median(distance_m[valid]))
    of_units = (
        units.doubt_about_units(min(frequencies_hz), typical_m)
        if frequencies_hz
        else units.doubt_about_distance(typical_m)
    )
    if distance_m is not None and distance_m.dtype.kind in "ui" and not of_units:
        return "distance_m: whole metres only; were their parts cut off? Floats keep them"
    return of_units


def unmeasured(
    amplitude: Array, distance_m: Array, valid: Mask, frequencies_hz: tuple[float, ...]
) -> tuple[Mask, str]:
    """Return the valid pixels whose distance stands for none, and what to say of them; or "".

    Several have one number, no other comes near, and no distance is that: not above 0, beyond the
    unambiguous range, the end of a counter, or far beyond all others. So is 0 where no light is.
    """
    range_m = units.unambiguous_range_m(frequencies_hz[0]) if len(frequencies_hz) == 1 else np.inf
    left, said = np.zeros(valid.shape, np.bool_), []
    for end in (np.min, np.max) * _MOST_CODES:
        inside = valid & ~left
        end_m = end(distance_m[inside])
        alike = inside & (distance_m == end_m)
        others_m = distance_m[inside & ~alike].astype(np.float64)
        if not others_m.size or _can_be(end_m, others_m, range_m, lowest=end is np.min):
            continue
        usual_m = abs(np.median(others_m))
        reach_m = APART * (usual_m if end_m == 0 else max(usual_m, np.ptp(others_m)))
        if alike.sum() < 2 or np.min(np.abs(others_m - end_m)) <= reach_m:
            alike &= (amplitude == 0) & (end_m == 0)
        if alike.any():
            left |= alike
            said.append(f"{alike.sum()} of {distance_m.size} pixels are {end_m:g}")
    if not said:
        return left, ""
    return left, f"distance_m: {', '.join(said)}, as where nothing was measured: they are left out"


def _can_be(end_m: float, others_m: Floats, range_m: float, *, lowest: bool) -> bool:
    """Tell whether the lowest or the largest distance can be one, negative if they are relative."""
    if lowest:
        return bool(end_m > 0 or (end_m % 1 and np.min(others_m) < 0))
    codes = np.abs(1000.0 * float(end_m) - np.asarray(_CODES_MM)) < _CODE_MM
    most_m = min(range_m, _FAR * np.max(np.abs(others_m)) or np.inf)
    return bool(end_m <= 0 or (end_m <= most_m and not codes.any()))


def check_intrinsics(given: Any, shape: tuple[int, int]) -> None:
    """Refuse what says nothing of where pixels look, as a matrix, or not of so many."""
    if isinstance(given, PixelDirections):
        given.check_fits(shape)
    elif not isinstance(given, Pinhole):
        cure = "Pinhole(K[0, 0], K[1, 1], K[0, 2], K[1, 2], *dist.ravel()) of those of OpenCV"
        raise DataError(f"expected {cure}, got {type(given).__name__}", field="intrinsics")


def doubt_about_intrinsics(given: Intrinsics, shape: tuple[int, int]) -> str:
    """Say why a pinhole can hardly be that of an image of this shape; or ""."""
    if not isinstance(given, Pinhole):
        return ""
    rows, cols = shape
    across, down = 2.0 * given.cx_px + 1.0, 2.0 * given.cy_px + 1.0  # of what it is the middle
    if abs(across / cols - down / rows) < 0.1 * across / cols and not 0.75 < across / cols < 1.33:
        return (
            f"intrinsics: the principal point ({given.cx_px:g}, {given.cy_px:g}) is the middle of "
            f"{across:.0f} x {down:.0f} pixels, not of these {cols} x {rows}; are they those of an "
            "image of another size? intrinsics.refine(scale) is for one that is finer"
        )
    return units.doubt_about_focal_length(given.fx_px, cols)


def as_numbers(values: ArrayLike, shape: tuple[int, ...], name: str) -> Floats:
    """Return finite numbers of this shape."""
    try:
        numbers = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise DataError("expected numbers", field=name) from error
    if numbers.shape != shape:
        raise DataError(f"expected shape {shape}, got {numbers.shape}", field=name)
    if not np.all(np.isfinite(numbers)):
        raise DataError("expected finite numbers, got NaN or infinity", field=name)
    return numbers


def as_pairs(values: ArrayLike, count: int, name: str) -> Floats:
    """Return one (row, col) pair for each frame."""
    try:
        pairs = as_numbers(values, (count, 2), name)
    except DataError as error:
        hint = f"one (row, col) pair for each of the {count} frames"
        raise DataError(f"{error.problem} ({hint})", field=name) from error
    if name == "offset_sigma_px" and np.any(pairs < 0):
        raise DataError(f"expected no negative one, got {pairs.min():g}", field=name)
    return pairs


def as_frequencies(given: Any) -> float | tuple[float, ...] | None:
    """Return one modulation frequency as a number, several as a tuple."""
    if given is None:
        return None
    try:
        found = np.asarray(given, np.float64)
    except (TypeError, ValueError) as error:
        problem = f"expected frequencies, got {given!r:.80}"
        raise DataError(problem, field="modulation_hz") from error
    if found.ndim > 1 or found.size == 0 or not np.all(np.isfinite(found) & (found > 0)):
        raise DataError(f"expected a positive frequency, got {given}", field="modulation_hz")
    several = tuple(found.ravel().tolist())
    if len(set(several)) != len(several):
        raise DataError(f"expected different frequencies, got {given}", field="modulation_hz")
    return several[0] if len(several) == 1 else several


def as_phasors(
    given: Any, modulation_hz: float | tuple[float, ...] | None, valid: Mask | None = None
) -> NDArray[np.complex128]:
    """Return phasors [frequency frame row col], as many as frequencies, finite where valid."""
    phasors = np.asarray(given)
    count = 0 if modulation_hz is None else np.size(modulation_hz)
    frames = phasors.shape[1:] if valid is None else valid.shape
    if count == 0:
        raise DataError("expected as many frequencies as phasors have", field="modulation_hz")
    if phasors.dtype.kind != "c" or phasors.shape != (count, *frames):
        raise DataError(
            f"expected complex [frequency frame row col] of {count} modulation_hz, got "
            f"{phasors.dtype} of shape {phasors.shape}",
            field="phasors",
        )
    for one in phasors if valid is not None else ():
        check_finite_where_valid(one, np.asarray(valid), "phasors")
    return phasors.astype(np.complex128)
