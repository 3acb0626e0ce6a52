"""The forward model of a burst, y_k = gain_k (D B M_k x) + bias_k, from HR image to LR frames."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lensshift.core.arrays import Array, Floats, Mask
from lensshift.core.grid import hr_to_lr
from lensshift.forward import lean, sampling
from lensshift.forward.blur import Blur, GaussianBlur, Starts, Weights, sees_image, varying_taps
from lensshift.forward.operator import LinearOperator, by_parts, chained
from lensshift.forward.smooth_field import adjoint_smooth, forward_smooth, smooth_field
from lensshift.forward.warp import Positions, field_positions, frame_positions

MAX_SCALE = 8  # memory goes with its square


@dataclass(frozen=True, slots=True, eq=False)
class Taps:
    """The HR pixels that LR pixels see along one axis, and with what weights."""

    # [frame pixel] or, for a shift field, [frame row col]; where they look
    position_hr_px: Positions
    start: Starts  # of the same shape, HR index of the first tap
    weight: Weights  # [... T], sums to 1
    run: Starts  # as from `regular_runs`; none for a shift field


@dataclass(frozen=True, slots=True, eq=False)
class ForwardModel:
    """How one HR image becomes K LR frames; made by `forward_model`."""

    # (rows, cols) of a frame and of the HR image
    lr_shape: tuple[int, int]
    hr_shape: tuple[int, int]
    scale: int  # HR pixels per LR pixel
    blur: Blur  # the pixel response
    # the taps along row and along col
    rows: Taps
    cols: Taps
    offset_px: Floats | None  # [frame 2] if every frame has one shift, or None for a shift field
    # [frame]
    gain: Floats
    bias: Floats
    inside: Mask  # [frame row col] False where the centre of an LR pixel lies outside the HR image
    # [frame row col 3] variance (row, col) and covariance of the optical spot beyond that of
    # `blur`, 2 if no spot leans, or None if all pixels have the same response
    spot_px2: Floats | None = None
    # [frame row col 2] third central moment (row, col) of that spot, or None if it is even
    skew_px3: Floats | None = None
    leaning: lean.Taps | None = None  # blur along diagonals, which comes first, or None

    @property
    def frames(self) -> int:
        """Number of frames."""
        return self.gain.size

    @property
    def operator(self) -> LinearOperator:
        """HR image [row col] to frames [frame row col]: shift, blur, sample, gain; no bias."""
        seen = sampling_operator(self.hr_shape, self.lr_shape, self.rows, self.cols, self.gain)
        if self.leaning is None:
            return seen
        return chained(seen, lean.lean_operator(self.leaning, self.hr_shape))

    @property
    def mean_offset_px(self) -> Floats:
        """One offset [frame 2] per frame; of a shift field the mean over the sensor."""
        if self.offset_px is not None:
            return self.offset_px
        row, col = self.rows.position_hr_px, self.cols.position_hr_px
        rest = [(size - 1) / 2 for size in self.hr_shape]
        means = [row.mean(axis=(1, 2)) - rest[0], col.mean(axis=(1, 2)) - rest[1]]
        return -np.stack(means, axis=-1) / self.scale

    @property
    def shift_spread_px(self) -> float:
        """How far the shift of a pixel is from the mean of its frame at most."""
        if self.offset_px is not None:
            return 0.0
        places = np.ogrid[: self.lr_shape[0], : self.lr_shape[1]]
        both = zip((self.rows, self.cols), places, strict=True)
        away = [taps.position_hr_px - self.scale * place for taps, place in both]
        apart = [np.abs(one - one.mean(axis=(1, 2), keepdims=True)).max() for one in away]
        return float(max(apart)) / self.scale

    def predict(self, x: Array) -> Array:
        """Return the frames [frame row col] that the HR image gives, bias included."""
        y = self.operator(x)
        y += self.bias[:, None, None].astype(y.real.dtype)
        return y

    def on_grid(self, scale: int, moved_px: ArrayLike = (0.0, 0.0)) -> ForwardModel:
        """Return the model of the same frames on another HR grid, which is moved by (row, col)."""
        moved = np.asarray(moved_px, dtype=np.float64)
        if self.offset_px is not None:
            return forward_model(self.lr_shape, scale, self.offset_px - moved, blur=self.blur)
        seen = (hr_to_lr(taps.position_hr_px, self.scale) for taps in (self.rows, self.cols))
        rows, cols = np.ogrid[: self.lr_shape[0], : self.lr_shape[1]]
        offset_px = np.stack([u - at for u, at in zip((rows, cols), seen, strict=True)], axis=-1)
        return forward_model(
            self.lr_shape, scale, shift_field_px=offset_px - moved, spot_px2=self.spot_px2,
            skew_px3=self.skew_px3, blur=self.blur,
        )  # fmt: skip

    def crop(self, rows: slice, cols: slice) -> ForwardModel:
        """Return the model of a part of the frames (LR rows and columns) and of the HR image."""
        lr_shape = (rows.stop - rows.start, cols.stop - cols.start)
        hr_shape = (lr_shape[0] * self.scale, lr_shape[1] * self.scale)
        at = [taps.position_hr_px for taps in (self.rows, self.cols)]
        at = [p[:, rows, cols] for p in at] if at[0].ndim == 3 else [at[0][:, rows], at[1][:, cols]]
        places = at[0] - rows.start * self.scale, at[1] - cols.start * self.scale
        spots = [None if of is None else of[:, rows, cols] for of in (self.spot_px2, self.skew_px3)]
        return replace(
            self, lr_shape=lr_shape, hr_shape=hr_shape, inside=_inside(*places, hr_shape),
            spot_px2=spots[0], skew_px3=spots[1],
            **_seen(self.blur, places, self.scale, hr_shape, *spots),
        )  # fmt: skip


def forward_model(
    lr_shape: tuple[int, int],
    scale: int,
    offset_px: ArrayLike | None = None,
    *,
    shift_field_px: ArrayLike | None = None,
    spot_px2: ArrayLike | None = None,
    skew_px3: ArrayLike | None = None,
    blur: Blur | None = None,
    gain: ArrayLike | None = None,
    bias: ArrayLike | None = None,
) -> ForwardModel:
    """Build the forward model of a burst, y_k = gain_k (D B M_k x) + bias_k.

    ValueError if a shift is not finite, or spots are not those of a shift field.

    Parameters
    ----------
    lr_shape : (rows, cols) of a frame
    scale : HR pixels per LR pixel, 1 to 8
    offset_px : [frame 2] (row, col), one shift per frame; positive: the content moved down /
        right. Without any shift: one frame at (0, 0)
    shift_field_px : [frame row col 2] instead of `offset_px`, a shift for every pixel
    spot_px2 : [frame row col 3], with a shift field: variance (row, col) and covariance of the
        optical spot of every pixel beyond that of `blur`; with 2 in place of 3 none leans
    skew_px3 : [frame row col 2], with `spot_px2`: third central moment (row, col) of that spot
    blur : the pixel response; by default a Gaussian of 0.3 px
    gain, bias : [frame], by default 1 and 0
    """
    blur = GaussianBlur(0.3) if blur is None else blur
    hr_shape = (lr_shape[0] * scale, lr_shape[1] * scale)
    offset: Floats | None = None
    if shift_field_px is None:
        offset = np.array(np.zeros((1, 2)) if offset_px is None else offset_px, dtype=np.float64)
        places = frame_positions(lr_shape, offset, scale)
    else:
        places = field_positions(shift_field_px, scale)
    gains, biases = (
        np.full(len(places[0]), usual) if given is None else np.array(given, dtype=np.float64)
        for given, usual in ((gain, 1.0), (bias, 0.0))
    )
    spot = _of_field(spot_px2, "spot_px2", places[0], (2, 3))
    skew = _of_field(skew_px3, "skew_px3", places[0], (2,))
    if skew is not None and spot is None:
        raise ValueError("expected skew_px3 with spot_px2, got it alone")
    return ForwardModel(
        lr_shape=lr_shape, hr_shape=hr_shape, scale=scale, blur=blur, offset_px=offset, gain=gains,
        bias=biases, inside=_inside(*places, hr_shape), spot_px2=spot, skew_px3=skew,
        **_seen(blur, places, scale, hr_shape, spot, skew),
    )  # fmt: skip


def _of_field(
    values: ArrayLike | None, name: str, row_at: Positions, parts: tuple[int, ...]
) -> Floats | None:
    """Return what there is of spots [frame row col part], which only a shift field has."""
    if values is None:
        return None
    of = np.asarray(values, dtype=np.float64)
    shaped = row_at.ndim == 3 and of.shape in [(*row_at.shape, count) for count in parts]
    if not shaped or not np.all(np.isfinite(of)):
        raise ValueError(f"expected finite {name} of a shift field, got shape {of.shape}")
    return of


def _seen(
    blur: Blur,
    places: tuple[Positions, Positions],
    scale: int,
    hr_shape: tuple[int, int],
    spot_px2: Floats | None,
    skew_px3: Floats | None,
) -> dict[str, Any]:
    """Return the taps of a `ForwardModel` whose pixels look at HR places (row, col)."""
    lean_px2 = None
    if spot_px2 is not None:
        spot_px2, lean_px2 = lean.upright(spot_px2)
    rows, cols = (
        _taps(blur, at, scale, size, spot_px2, skew_px3, axis=axis)
        for axis, (at, size) in enumerate(zip(places, hr_shape, strict=True))
    )
    leaning = None if lean_px2 is None else lean.lean_taps(lean_px2, scale)
    return {"rows": rows, "cols": cols, "leaning": leaning}


def _taps(
    blur: Blur,
    at: Positions,
    scale: int,
    size: int,
    spot_px2: Floats | None,
    skew_px3: Floats | None,
    *,
    axis: int,
) -> Taps:
    if spot_px2 is not None:
        skew = None if skew_px3 is None else skew_px3[..., axis]
        taps = varying_taps(blur, at, spot_px2[..., axis], scale, size, skew)
        return _read_only(Taps(at, *taps, np.empty((0, 2), np.int64)))
    if at.ndim > 2:
        return _read_only(Taps(at, *blur.taps(at, scale, size), np.empty((0, 2), np.int64)))
    return _taps_of_shifts(blur, at.tobytes(), at.shape, scale, size)


# Both channels of a burst, and all bursts of a stream, look at the same places.
@lru_cache(maxsize=32)
def _taps_of_shifts(
    blur: Blur, at_bytes: bytes, shape: tuple[int, ...], scale: int, size: int
) -> Taps:
    at = np.frombuffer(at_bytes, np.float64).reshape(shape)
    start, weight = blur.taps(at, scale, size)
    return _read_only(Taps(at, start, weight, sampling.regular_runs(start, weight, scale)))


def _read_only(taps: Taps) -> Taps:
    """Return taps that no user of a model can spoil for the other models that share them."""
    for values in (taps.position_hr_px, taps.start, taps.weight, taps.run):
        values.flags.writeable = False
    return taps


def sampling_operator(
    hr_shape: tuple[int, int], lr_shape: tuple[int, int], rows: Taps, cols: Taps, gain: Floats
) -> LinearOperator:
    """Return the operator HR [row col] -> [frame row col] that takes the taps and the gain.

    Single precision stays single, complex stays complex; everything else is computed in float64.
    """
    # The gain rides on the row taps, which costs nothing per pixel.
    row_weight = rows.weight
    if np.any(gain != 1):
        row_weight = row_weight * gain.reshape(-1, *(1,) * (row_weight.ndim - 1))
    out_shape = (gain.size, *lr_shape)
    take, spread, places, by_tap = _kernels(rows, cols, row_weight, hr_shape[1] // lr_shape[1])

    @lru_cache(maxsize=2)
    def weights(precision: np.dtype[Any]) -> list[Array]:
        found = [w.astype(precision, copy=False) for w in (row_weight, cols.weight, *by_tap)]
        for values in found:
            values.flags.writeable = False  # always: the kernels are compiled for one kind
        return found

    def run_kernel(kernel: Any, values: Array, shape: tuple[int, ...]) -> Array:
        row, col, *others = weights(values.dtype)
        out = np.empty(shape, values.dtype)
        kernel(values, rows.start, row, cols.start, col, *places, *others, out)
        return out

    def forward(x: Array) -> Array:
        return by_parts(lambda part: run_kernel(take, part, out_shape), x)

    def adjoint(y: Array) -> Array:
        return by_parts(lambda part: run_kernel(spread, part, hr_shape), y)

    return LinearOperator(hr_shape, out_shape, forward, adjoint)


def _kernels(
    rows: Taps, cols: Taps, row_weight: Array, stride: int
) -> tuple[Any, Any, tuple[Starts, ...], tuple[Array, ...]]:
    """Return kernel, adjoint, and what they take besides the taps: places, and further weights."""
    if rows.start.ndim < 3:
        take, spread = (
            partial(sampling.in_bands, k)
            for k in (sampling.forward_separable, sampling.adjoint_separable)
        )
        return take, spread, (cols.run,), ()
    smooth = smooth_field(rows.start, row_weight, cols.start, cols.weight, stride)
    if smooth is None:
        return sampling.forward_field, sampling.adjoint_field, (), ()
    by_tap = (smooth.row_weight, smooth.col_weight)
    return forward_smooth, adjoint_smooth, (smooth.first, smooth.run), by_tap


def _inside(row_at: Positions, col_at: Positions, hr_shape: tuple[int, int]) -> Mask:
    row, col = sees_image(row_at, hr_shape[0]), sees_image(col_at, hr_shape[1])
    return row & col if row.ndim == 3 else row[:, :, None] & col[:, None, :]
