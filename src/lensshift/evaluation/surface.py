"""What distance images say about themselves: flatness, pixels between surfaces."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lensshift.core.arrays import Floats, Mask
from lensshift.evaluation import depth
from lensshift.evaluation.edge_gradient import split_index
from lensshift.evaluation.inputs import check_shape

STEP_SHARE = 0.10  # a pixel farther than this share of the step from a surface is not on it
_PLATEAU_SHARE = 0.25  # values this near to the median of a side belong to its surface
_MIN_SURFACE_PX = 3
_LOCAL_PX = 5  # side of the window whose mean tells low-frequency bias from noise


@dataclass(frozen=True, slots=True, eq=False)
class PlaneFit:
    """The plane normal . p = offset that fits a distance image best, and what is left."""

    normal: Floats  # [3] of unit length, towards the camera
    offset_m: float
    residual_m: Floats  # [row col] distance of each pixel, positive towards the camera, or NaN
    rms_m: float  # of the residual
    max_m: float  # of the residual
    bias_rms_m: float  # its smooth part; bias^2 + noise^2 = rms^2
    noise_rms_m: float  # the rest
    count: int  # pixels used


@dataclass(frozen=True, slots=True, eq=False)
class FlyingPixels:
    """Pixels between the surfaces of an edge, or beyond both."""

    fraction: float  # flying share of the checked pixels, NaN if none was checked
    flying: Mask  # [row col]
    checked: Mask  # [row col] valid pixels near an edge


def fit_plane(
    distance_m: ArrayLike,
    *,
    valid: ArrayLike | None = None,
    directions: ArrayLike | None = None,
    pitch_m: float | tuple[float, float] | None = None,
) -> PlaneFit:
    """Fit a plane by total least squares.

        minimise sum_i (n . p_i - d)^2 with |n| = 1,   p_i = distance_i * direction_i
        noise^2 = sum (r - local mean)^2 / sum (1 - 1/m),   bias^2 = rms^2 - noise^2

    The local mean is over the m valid pixels of a 5 x 5 window; the split is exact for white noise
    and a smooth bias. Noise that neighbours share counts in part as bias.

    Parameters
    ----------
    distance_m : [row col]; NaN is invalid
    valid : [row col], False for pixels left out
    directions : [row col 3] unit vectors of the rays, for radial distances
    pitch_m : without directions: spacing of the pixels on the object, one or (row, col); the image
        is then the depth over p = (row, col, depth)

    Raises
    ------
    ValueError
        If not exactly one of `directions` and `pitch_m` is given, shapes do not fit, or the valid
        pixels are fewer than three or in one line.

    Source: Golub and Van Loan, Matrix Computations, on total least squares.
    """
    image_m = depth.distance_image(distance_m, valid)
    points_m, used = _points_m(image_m, directions, pitch_m)
    if len(points_m) < _MIN_SURFACE_PX:
        raise ValueError(f"expected at least 3 valid pixels for a plane, got {len(points_m)}")
    center_m = points_m.mean(axis=0)
    _, spread, axes = np.linalg.svd(points_m - center_m, full_matrices=False)
    if spread[1] <= 1e-9 * spread[0]:
        raise ValueError(f"expected pixels that span a plane, got {len(points_m)} in one line")
    normal = axes[2]
    # Towards the camera, which lies at the origin or, over a pitch, at small depth.
    behind = normal[2] if directions is None else normal @ center_m
    normal = -normal if behind > 0 else normal
    residual_m = np.full(image_m.shape, np.nan)
    residual_m[used] = (points_m - center_m) @ normal
    inside_m = residual_m[used]
    noise_m = _local_noise_m(residual_m)
    rms_m, max_m = depth.rms(inside_m), float(np.max(np.abs(inside_m)))
    bias_m = float(np.sqrt(max(0.0, rms_m**2 - noise_m**2)))
    offset_m = float(normal @ center_m)
    return PlaneFit(normal, offset_m, residual_m, rms_m, max_m, bias_m, noise_m, inside_m.size)


def flying_pixel_fraction(
    distance_m: ArrayLike,
    truth_m: ArrayLike | None = None,
    *,
    valid: ArrayLike | None = None,
    scale: int = 1,
    edge_width_px: float = 2.0,
    noise_m: float = 0.0,
    min_step_m: float | None = None,
) -> FlyingPixels:
    """Count the pixels near depth edges that lie on neither surface.

        flying:  |distance - surface| > max(3 sigma, 10 % of the step)   for both surfaces

    With the truth the surfaces are its values within the window (2 edge widths wide), so it must
    be free of mixed pixels. Without it two planes are fitted to the near and to the far values in
    the window and taken at its centre; a surface of fewer than three pixels is no surface.

    Parameters
    ----------
    distance_m, truth_m : [row col] of one shape; NaN is invalid
    valid : [row col], False for pixels left out
    scale, edge_width_px, noise_m, min_step_m : as in `depth_error`

    Raises
    ------
    ValueError
        If shapes differ or a number is out of range.
    """
    measured_m = depth.distance_image(distance_m, valid)
    depth.check_edges(scale, edge_width_px, noise_m, min_step_m)
    reach = max(1, int(np.ceil(edge_width_px * scale)))
    if truth_m is None:
        off_m, step_m = _off_fitted_m(measured_m, reach, noise_m, min_step_m)
    else:
        truth = depth.distance_image(truth_m, None)
        check_shape(measured_m, truth)
        off_m, step_m = _off_truth_m(measured_m, truth, reach)
        near = depth.near_edges(
            truth, scale=scale, edge_width_px=edge_width_px, noise_m=noise_m, min_step_m=min_step_m
        )
        off_m[~near] = np.nan
    checked = np.isfinite(off_m)
    flying = checked & (off_m > np.maximum(3 * noise_m, STEP_SHARE * step_m))
    fraction = flying.sum() / checked.sum() if checked.any() else np.nan
    return FlyingPixels(fraction=float(fraction), flying=flying, checked=checked)


def _points_m(
    image_m: Floats, directions: ArrayLike | None, pitch_m: float | tuple[float, float] | None
) -> tuple[Floats, Mask]:
    """Return the points [n 3] of the valid pixels, and which these are."""
    used = np.isfinite(image_m)
    if (directions is None) == (pitch_m is None):
        raise ValueError("expected either directions or pitch_m, got both or neither")
    if directions is not None:
        rays = np.asarray(directions, dtype=np.float64)
        if rays.shape != (*image_m.shape, 3):
            raise ValueError(f"expected directions {(*image_m.shape, 3)}, got {rays.shape}")
        length = np.linalg.norm(rays[used], axis=1)
        if not np.allclose(length, 1.0, atol=1e-4):
            raise ValueError(
                f"expected directions of length 1, got {length.min():.4g} to {length.max():.4g}"
            )
        return image_m[used, None] * rays[used], used
    pitches_m = np.broadcast_to(np.asarray(pitch_m, dtype=np.float64), 2)
    if not (np.all(np.isfinite(pitches_m)) and np.all(pitches_m > 0)):
        raise ValueError(f"expected a positive pitch in m, got {pitch_m}")
    rows, cols = np.nonzero(used)
    return np.column_stack([rows * pitches_m[0], cols * pitches_m[1], image_m[used]]), used


def _local_noise_m(residual_m: Floats) -> float:
    """Return the rms of what a local mean leaves, freed from the share the mean takes."""
    from scipy.ndimage import uniform_filter

    used = np.isfinite(residual_m)
    size = _LOCAL_PX**2
    members = np.rint(uniform_filter(used.astype(np.float64), _LOCAL_PX, mode="constant") * size)
    sums_m = uniform_filter(np.where(used, residual_m, 0.0), _LOCAL_PX, mode="constant") * size
    rest_m = residual_m[used] - sums_m[used] / members[used]
    freedom = float(np.sum(1 - 1 / members[used]))
    return float(np.sqrt(np.sum(rest_m**2) / freedom)) if freedom > 0 else 0.0


def _off_truth_m(measured_m: Floats, truth_m: Floats, reach: int) -> tuple[Floats, Floats]:
    """Return how far each pixel is off the nearest true value around it, and the step there."""
    padded_m = np.pad(truth_m, reach, constant_values=np.nan)
    windows_m = np.lib.stride_tricks.sliding_window_view(padded_m, (2 * reach + 1,) * 2)
    known = np.isfinite(windows_m)
    gap_m = np.where(known, np.abs(windows_m - measured_m[:, :, None, None]), np.inf)
    far_m = np.where(known, windows_m, -np.inf).max(axis=(2, 3))
    near_m = np.where(known, windows_m, np.inf).min(axis=(2, 3))
    off_m = np.where(known.any(axis=(2, 3)), gap_m.min(axis=(2, 3)), np.nan)
    return off_m, far_m - near_m


def _off_fitted_m(
    measured_m: Floats, reach: int, noise_m: float, min_step_m: float | None
) -> tuple[Floats, Floats]:
    """Return how far pixels are off the nearer of two planes around them, and the step; or NaN."""
    from scipy.ndimage import maximum_filter, minimum_filter

    off_m, step_m = np.full((2, *measured_m.shape), np.nan)
    known = np.isfinite(measured_m)
    size = 2 * reach + 1
    nearest_m = minimum_filter(np.where(known, measured_m, np.inf), size, mode="nearest")
    farthest_m = maximum_filter(np.where(known, measured_m, -np.inf), size, mode="nearest")
    smallest_m = depth.smallest_step_m(nearest_m, noise_m, min_step_m) + np.zeros(known.shape)
    for row, col in np.argwhere(known & (farthest_m - nearest_m > smallest_m)):
        top, left = max(0, row - reach), max(0, col - reach)
        window_m = measured_m[top : row + reach + 1, left : col + reach + 1]
        valid = np.isfinite(window_m)
        place_px = np.argwhere(valid) - (row - top, col - left)
        planes_m = _two_planes_m(place_px, window_m[valid])
        if planes_m is not None and planes_m[1] - planes_m[0] > smallest_m[row, col]:
            off_m[row, col] = np.min(np.abs(measured_m[row, col] - planes_m))
            step_m[row, col] = planes_m[1] - planes_m[0]
    return off_m, step_m


def _two_planes_m(place_px: NDArray[np.int64], values_m: Floats) -> Floats | None:
    """Return the near and far surface at place 0 of [n 2]; None if a side has too few pixels."""
    ordered_m = np.sort(values_m)
    split = split_index(ordered_m)
    near_m, far_m = np.median(ordered_m[:split]), np.median(ordered_m[split:])
    margin_m = _PLATEAU_SHARE * (far_m - near_m)
    others = place_px.any(axis=1)  # the pixel under test has no say in its surfaces
    planes_m = []
    for side in (values_m <= near_m + margin_m, values_m >= far_m - margin_m):
        members = side & others
        if np.count_nonzero(members) < _MIN_SURFACE_PX:
            return None
        own_px, own_m = place_px[members], values_m[members]
        center_px, level_m = own_px.mean(axis=0), own_m.mean()
        # Level along directions that the places do not span.
        tilt = np.linalg.lstsq(own_px - center_px, own_m - level_m, rcond=None)[0]
        planes_m.append(level_m - tilt @ center_px)
    return np.array(planes_m)
