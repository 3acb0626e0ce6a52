"""Errors of a distance image against the truth, at its edges and away from them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from lensshift.core.arrays import Floats, Mask
from lensshift.core.errors import warn_quality
from lensshift.evaluation.edge_gradient import profile_edge
from lensshift.evaluation.inputs import check_shape, mask_array, real_array

EDGE_SHARE = 0.05  # of the nearer distance: smaller steps are no edges
_MIN_LINE_SAMPLES = 4
_OTHER_UNIT = 30.0  # between what is off by chance and cm for m


@dataclass(frozen=True, slots=True)
class DepthError:
    """Errors over the pixels valid in both images; NaN where there is no such pixel.

    Parameters
    ----------
    rmse_m, mae_m, bias_m : root mean square, mean absolute and mean error, measured - true
    median_abs_m, p95_abs_m : median and 95th percentile of the absolute error
    edge_rmse_m, flat_rmse_m : near the edges of the truth, and elsewhere
    count, edge_count : pixels compared, and those of them near edges
    fill_rate, edge_fill_rate : valid share of the true pixels, and of those near edges. Read
        `edge_rmse_m` with the latter: dropping the bad pixels at edges lowers both.
    """

    rmse_m: float
    mae_m: float
    bias_m: float
    median_abs_m: float
    p95_abs_m: float
    edge_rmse_m: float
    flat_rmse_m: float
    count: int
    edge_count: int
    fill_rate: float
    edge_fill_rate: float


@dataclass(frozen=True, slots=True)
class EdgeLocationError:
    """Where a straight depth edge lies against the truth, in LR pixels across the lines."""

    mean_px: float  # mean over the lines; positive towards larger indices
    rms_px: float  # of the fitted edges, so that a turned edge shows
    scatter_px: float  # rms of the single lines about the fitted edge of the image
    lines: int  # number of lines with an edge


def depth_error(
    distance_m: ArrayLike,
    truth_m: ArrayLike,
    *,
    valid: ArrayLike | None = None,
    truth_valid: ArrayLike | None = None,
    scale: int = 1,
    edge_width_px: float = 2.0,
    noise_m: float = 0.0,
    min_step_m: float | None = None,
) -> DepthError:
    """Compare a distance image with the truth.

        e = distance - truth,   rmse = sqrt( mean e^2 ),   mae = mean |e|,   bias = mean e

    over the pixels valid in both. Pixels within `edge_width_px` of a true edge count as edge: see
    `near_edges`.

    Parameters
    ----------
    distance_m, truth_m : [row col] of one shape; NaN is invalid
    valid, truth_valid : [row col], False for pixels left out
    scale : pixels of these images per LR pixel
    edge_width_px : half width of the edge zone, in LR pixels
    noise_m : standard deviation of the distances, sigma
    min_step_m : smallest step that is an edge; if not given max(3 sigma, 5 % of the distance)

    Raises
    ------
    ValueError
        If shapes differ, a number is out of range, or no pixel is valid in both images.

    Warns
    -----
    QualityWarning
        If pixels have no distance above 0, as cameras mark what is invalid, or the image seems to
        be in another unit than the truth.
    """
    measured_m, truth = distance_image(distance_m, valid), distance_image(truth_m, truth_valid)
    check_shape(measured_m, truth)
    known = np.isfinite(truth)
    used = known & np.isfinite(measured_m)
    if not used.any():
        raise ValueError("expected pixels valid in the image and in the truth, got none")
    near = near_edges(
        truth, scale=scale, edge_width_px=edge_width_px, noise_m=noise_m, min_step_m=min_step_m
    )
    _warn_of_values(measured_m[used], truth[used])
    error_m = measured_m - truth
    inside_m, off_m = error_m[used], np.abs(error_m[used])
    return DepthError(
        rmse_m=rms(inside_m), mae_m=float(np.mean(off_m)), bias_m=float(np.mean(inside_m)),
        median_abs_m=float(np.median(off_m)), p95_abs_m=float(np.percentile(off_m, 95)),
        edge_rmse_m=rms(error_m[used & near]), flat_rmse_m=rms(error_m[used & ~near]),
        count=int(np.count_nonzero(used)), edge_count=int(np.count_nonzero(used & near)),
        fill_rate=_share(used, known), edge_fill_rate=_share(used & near, known & near),
    )  # fmt: skip


def _warn_of_values(measured_m: Floats, truth_m: Floats) -> None:
    empty = int(np.count_nonzero(measured_m <= 0.0))
    if empty and truth_m.min() > 0.0:
        warn_quality(
            f"{empty} of {measured_m.size} pixels have a distance of 0 or less and count as "
            "errors; make them NaN if they are invalid",
            stacklevel=3,
        )
    middle_m, true_m = float(np.median(measured_m)), float(np.median(truth_m))
    if min(middle_m, true_m) > 0.0 and max(middle_m / true_m, true_m / middle_m) > _OTHER_UNIT:
        warn_quality(
            f"the image lies at {middle_m:.4g}, the truth at {true_m:.4g}: expected both in m",
            stacklevel=3,
        )


def near_edges(
    truth_m: ArrayLike,
    *,
    scale: int = 1,
    edge_width_px: float = 2.0,
    noise_m: float = 0.0,
    min_step_m: float | None = None,
) -> Mask:
    """Return the pixels near the edges of a distance image [row col].

    An edge lies between two neighbours along an axis whose distances differ by more than
    `min_step_m`, by default max(3 sigma, 5 % of the nearer one). Near are pixels whose centre is at
    most `edge_width_px` LR pixels from an edge.

    Parameters
    ----------
    truth_m : [row col]; NaN is invalid, and there is no edge towards it
    scale, edge_width_px, noise_m, min_step_m : as in `depth_error`

    Raises
    ------
    ValueError
        If an argument is out of range.
    """
    from scipy.ndimage import distance_transform_edt

    distance_m = distance_image(truth_m, None)
    check_edges(scale, edge_width_px, noise_m, min_step_m)
    beside = np.zeros(distance_m.shape, dtype=np.bool_)
    for lines_m, near in ((distance_m, beside), (distance_m.T, beside.T)):
        nearer_m = np.minimum(lines_m[:-1], lines_m[1:])
        step_m = np.abs(np.diff(lines_m, axis=0))
        is_edge = step_m > smallest_step_m(nearer_m, noise_m, min_step_m)
        near[:-1] |= is_edge
        near[1:] |= is_edge
    if not beside.any():
        return beside
    # Pixels beside an edge have their centre half a pixel from it.
    to_edge_hr_px = np.asarray(distance_transform_edt(~beside)) + 0.5
    return np.asarray(to_edge_hr_px <= edge_width_px * scale)


def edge_location_error(
    distance_m: ArrayLike,
    truth_m: ArrayLike,
    *,
    valid: ArrayLike | None = None,
    along: Literal["row", "col"] = "col",
    scale: int = 1,
    noise_m: float = 0.0,
    min_step_m: float | None = None,
) -> EdgeLocationError:
    """Compare the place of one straight depth edge with the truth.

        x_i : where line i crosses the middle of its step, by linear interpolation
        error_i = (a + b i)_image - (a + b i)_truth,   a, b by least squares

    Lines whose true distances span less than a step are left out. A truth that averages the scene
    over its pixels is exact to 0.1 pixels a line, one of point samples to half a pixel; over a
    slanted edge both average out.

    Parameters
    ----------
    distance_m, truth_m : [row col] of one shape, with one edge in a line; NaN is invalid
    valid : [row col], False for pixels left out
    along : axis that crosses the edge: "col" for an edge that runs down the image
    scale : pixels of these images per LR pixel
    noise_m, min_step_m : as in `depth_error`

    Raises
    ------
    ValueError
        If an argument is out of range, fewer than two lines have an edge, or the image shows none
        in such a line.
    """
    measured_m, truth = distance_image(distance_m, valid), distance_image(truth_m, None)
    check_shape(measured_m, truth)
    check_edges(scale, 0.0, noise_m, min_step_m)
    if along not in ("row", "col"):
        raise ValueError(f"expected along 'row' or 'col', got {along!r}")
    if along == "row":
        measured_m, truth = measured_m.T, truth.T
    numbers, places = [], []
    for number, (line_m, true_m) in enumerate(zip(measured_m, truth, strict=True)):
        known_m = true_m[np.isfinite(true_m)]
        if known_m.size == 0:
            continue
        if np.ptp(known_m) > smallest_step_m(known_m.min(), noise_m, min_step_m):
            numbers.append(number)
            places.append((_crossing_px(line_m, number), _crossing_px(true_m, number)))
    if len(numbers) < 2:
        raise ValueError(f"expected an edge in at least 2 lines, got {len(numbers)}")
    place_px = np.array(places) / scale  # [line, (image, truth)]
    fits = np.polyfit(numbers, place_px, 1)
    fitted_px = np.outer(numbers, fits[0]) + fits[1]
    error_px = fitted_px[:, 0] - fitted_px[:, 1]
    scatter_px = rms(place_px[:, 0] - fitted_px[:, 0])
    return EdgeLocationError(float(error_px.mean()), rms(error_px), scatter_px, len(numbers))


def fill_rate(distance_m: ArrayLike, *, valid: ArrayLike | None = None) -> float:
    """Return the share of valid pixels.

    Parameters
    ----------
    distance_m : [row col]; NaN is invalid
    valid : [row col], False for pixels left out

    Raises
    ------
    ValueError
        If the shapes differ.
    """
    return float(np.mean(np.isfinite(distance_image(distance_m, valid))))


def smallest_step_m(
    nearer_m: float | Floats, noise_m: float, min_step_m: float | None
) -> float | Floats:
    """Return the smallest step that is an edge: as given, or max(3 sigma, 5 % of the distance)."""
    if min_step_m is not None:
        return min_step_m
    return np.maximum(3 * noise_m, EDGE_SHARE * nearer_m)


def rms(values: Floats) -> float:
    """Return the root mean square, NaN of nothing."""
    return float(np.sqrt(np.mean(values**2))) if values.size else float("nan")


def distance_image(distance_m: ArrayLike, valid: ArrayLike | None) -> Floats:
    """Return a distance image [row col] with NaN where it is not valid, or a ValueError."""
    values = real_array(distance_m, "distance image")
    return np.where(mask_array(valid, values.shape) & np.isfinite(values), values, np.nan)


def check_edges(scale: int, edge_width_px: float, noise_m: float, min_step_m: float | None) -> None:
    """Raise `ValueError` if what tells an edge is out of range."""
    if scale < 1:
        raise ValueError(f"expected a scale of at least 1, got {scale}")
    for name, number in (("edge width in px", edge_width_px), ("noise in m", noise_m)):
        if not (np.isfinite(number) and number >= 0):
            raise ValueError(f"expected a {name} of 0 or more, got {number}")
    if min_step_m is not None and not (np.isfinite(min_step_m) and min_step_m > 0):
        raise ValueError(f"expected a positive smallest step in m, got {min_step_m}")


def _crossing_px(line_m: Floats, number: int) -> float:
    """Return where a line crosses the middle of its step, over gaps too."""
    valid = np.flatnonzero(np.isfinite(line_m))
    if valid.size < _MIN_LINE_SAMPLES:
        raise ValueError(
            f"expected at least {_MIN_LINE_SAMPLES} valid pixels in line {number}, got {valid.size}"
        )
    try:  # the profile takes any unit of place, here pixels
        edge = profile_edge(valid.astype(np.float64), line_m[valid], "range", 0.1, "median")
    except ValueError as error:
        raise ValueError(f"line {number}: {error}") from error
    return edge.position_mm


def _share(part: Mask, whole: Mask) -> float:
    return float(part.sum() / whole.sum()) if whole.any() else float("nan")
