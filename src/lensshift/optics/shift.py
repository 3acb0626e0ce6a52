"""How the image moves when an element moves: traced shifts, their inverse, their evenness."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from lensshift.core.arrays import Floats
from lensshift.core.grid import Grid
from lensshift.core.motion import ShiftField
from lensshift.optics.directions import continued
from lensshift.optics.lens import Lens
from lensshift.optics.mtf import pixel_centres_mm
from lensshift.optics.paraxial import decenter_gains
from lensshift.optics.spots import centroids_mm, fields_for_image
from lensshift.optics.trace import SIDES, Build

ENOUGH_PIXELS = 17  # rows and columns that tell how even a shift is
NEAR = 1e-5  # of a pixel; the offset changes by less than 1e-7 px over it
_INVERSE_STEPS = 12  # each divides the error by what is not linear in a shift, 100 and more
_INVERSE_PX = 1e-9  # far below any error of a shift
_LEAST_GAIN = 1e-6  # mm per mm: a window has none but rounding
# Of the stop, a decentre over which a stage map is linear to parts in a million.
_PROBE = 1.0 / 400.0


def shift_map(
    lens: Lens,
    element: int,
    decenter_mm: ArrayLike,
    grid: Grid,
    *,
    most: int | None = None,
    dark: bool = False,
) -> ShiftField:
    """Return the image offset of every pixel when one element is moved.

        offset(u) = image after the move - image before it

    of the object point whose image is at pixel u after the move: what `ShiftField` means.

    Parameters
    ----------
    lens : at rest
    element : number of the element that moves, counted from 0
    decenter_mm : [2] or [frame 2] (row, col), added to the decentre of the element
    grid : of the sensor, centred on the axis
    most : rows and columns of pixels, the outermost among them, where not all are wanted
    dark : whether pixels that receive no light are `continued` from others, in place of an error

    Returns
    -------
    offsets of [frame row col 2]; one frame if a single move is given

    Raises
    ------
    ValueError
        If there is no such element, a number is not finite, or a pixel receives no light.
    """
    moves = np.atleast_2d(np.asarray(decenter_mm, dtype=np.float64))
    if moves.ndim != 2 or moves.shape[1] != 2 or not np.all(np.isfinite(moves)):
        raise ValueError(f"expected finite decenter_mm [frame 2], got shape {moves.shape}")
    centres_mm = pixel_centres_mm(grid)
    for axis, count in enumerate(grid.shape):
        if most is not None and count > most:
            kept = np.linspace(0, count - 1, most).round().astype(int)
            centres_mm = centres_mm.take(kept, axis=axis)
    pixels_mm = centres_mm.reshape(-1, 2)
    moved = moving(lens, element, moves[:, None, :])
    near_mm = NEAR * min(grid.pitch_mm)
    fields = fields_for_image(lens, pixels_mm, build=moved, tolerance_mm=near_mm, dark=dark)
    moved_mm, resting_mm = (centroids_mm(lens, fields, of, dark=dark) for of in (moved, None))
    offset_px = (moved_mm - resting_mm) / np.asarray(grid.pitch_mm)
    of_frames = offset_px.reshape(len(moves), *centres_mm.shape)
    places = (centres_mm[:, 0, 0], centres_mm[0, :, 1])
    return ShiftField(np.stack([continued(one, *places) for one in of_frames]), grid.pitch_mm)


def decenter_for_shift(lens: Lens, element: int, offset_px: ArrayLike, grid: Grid) -> Floats:
    """Return the decentre of an element that moves the centre of the image as wanted.

    Parameters
    ----------
    offset_px : [... 2] (row, col) at the centre of the sensor
    grid : of the sensor; only its pitch matters

    Returns
    -------
    decenter_mm [... 2] (row, col)

    Raises
    ------
    ValueError
        If moving the element does not move the image, or the shift is not reached.
    """
    wanted = np.asarray(offset_px, dtype=np.float64)
    if wanted.ndim < 1 or wanted.shape[-1] != 2 or not np.all(np.isfinite(wanted)):
        raise ValueError(f"expected finite offset_px [... 2], got shape {wanted.shape}")
    lens.check_element(element)
    gain = decenter_gains(lens)[element]
    if abs(gain) < _LEAST_GAIN:
        raise ValueError(
            f"expected an element whose decentre moves the image, but {lens.called(element)} "
            f"moves it by {gain:.2g} mm per mm"
        )
    targets = wanted.reshape(-1, 2)
    centre = Grid((1, 1), grid.pitch_mm)
    mm_per_px = np.linalg.inv(px_per_mm_over(lens, element, centre)[0, 0])
    moves_mm = targets @ mm_per_px.T
    for _ in range(_INVERSE_STEPS):
        error_px = targets - shift_map(lens, element, moves_mm, centre).offset_px[:, 0, 0]
        moves_mm = moves_mm + error_px @ mm_per_px.T
        if np.abs(error_px).max() < _INVERSE_PX:
            return np.asarray(moves_mm.reshape(wanted.shape))
    raise ValueError(
        f"expected a shift that element {element + 1} can make, but after {_INVERSE_STEPS} steps "
        f"{np.abs(error_px).max():.2g} px are missing"
    )


def first_moving(lens: Lens) -> int:
    """Return the number of the first element whose decentre moves the image, 0 if none does."""
    return int(np.argmax(np.abs(decenter_gains(lens)) >= _LEAST_GAIN))


@dataclass(frozen=True, slots=True)
class ShiftUniformity:
    """How even a shift is over the sensor.

    Parameters
    ----------
    max_error_px : largest distance between the shift of a pixel and the wanted one
    rms_error_px : root mean square of that distance
    mean_px : (row, col) shift averaged over the sensor
    """

    max_error_px: float
    rms_error_px: float
    mean_px: tuple[float, float]


def shift_uniformity(field: ShiftField, wanted_px: ArrayLike) -> tuple[ShiftUniformity, ...]:
    """Compare the shift of every pixel with the wanted one, frame by frame.

    Parameters
    ----------
    wanted_px : [frame 2] (row, col)

    Raises
    ------
    ValueError
        If the number of frames differs.
    """
    wanted = np.asarray(wanted_px, dtype=np.float64)
    if wanted.shape != (len(field.offset_px), 2):
        raise ValueError(
            f"expected wanted_px of {(len(field.offset_px), 2)}, got shape {wanted.shape}"
        )
    error = np.linalg.norm(field.offset_px - wanted[:, None, None, :], axis=-1)
    rms, mean = np.sqrt(np.mean(error**2, axis=(1, 2))), field.offset_px.mean(axis=(1, 2))
    of_frames = zip(error.max(axis=(1, 2)).tolist(), rms.tolist(), mean.tolist(), strict=True)
    return tuple(ShiftUniformity(most, of, (row, col)) for most, of, (row, col) in of_frames)


def largest_error_px(
    lens: Lens, element: int, moves_mm: Floats, grid: Grid, wanted_px: ArrayLike
) -> float:
    """Return the largest error of the shifts over the sensor, at enough pixels to tell."""
    over = shift_map(lens, element, moves_mm, grid, most=ENOUGH_PIXELS)
    return max(one.max_error_px for one in shift_uniformity(over, wanted_px))


def moving(lens: Lens, element: int, by: Floats, *, tilt: bool = False) -> Build:
    """Return builds [...] in which one element is moved by [... 2] (mm), or tilted (rad)."""
    lens.check_element(element)
    moves = np.zeros((*by.shape[:-1], len(lens.elements), 2))
    moves[..., element, :] = by
    return Build(tilt_rad=moves) if tilt else Build(decenter_mm=moves)


def central_slope(of: Callable[[Floats], Floats], step: float) -> Floats:
    """Return the derivative [... 2 2] at 0 of a function of [4 2] with values [4 ... 2]."""
    row_up, row_down, col_up, col_down = of(step * SIDES)
    return np.stack([row_up - row_down, col_up - col_down], axis=-1) / (2.0 * step)


def px_per_um(lens: Lens, element: int, grid: Grid) -> float:
    """Return how far the middle of the image moves per micrometre of an element, about rest.

    Along the axis where that is more pixels. This is what every command means by px per um.

    Parameters
    ----------
    grid : of the sensor; only its pitch matters

    Raises
    ------
    ValueError
        As in `shift_map`.
    """
    slope = px_per_mm_over(lens, element, Grid((1, 1), grid.pitch_mm))
    return 1e-3 * float(np.linalg.norm(slope, axis=-2).max())


def probe_mm(lens: Lens) -> float:
    """Return a decentre that is small for a lens."""
    return _PROBE * lens.stop.diameter_mm


def px_per_mm_over(lens: Lens, element: int, grid: Grid) -> Floats:
    """Return [row col 2 2] image over stage at every pixel, by central differences.

    Raises
    ------
    ValueError
        As in `shift_map`.
    """
    return central_slope(lambda mm: shift_map(lens, element, mm, grid).offset_px, probe_mm(lens))
