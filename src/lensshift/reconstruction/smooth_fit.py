"""What a smooth fit to frames leaves of them, in closed form, and pixels that contradict it.

At each spatial frequency of the frames a scene of falling spectrum has the covariance D between
frames, known from their shifts; what it hardly reaches is noise:

    r = s (s 1 + D)^-1 y,   D_kj = sum over aliases v of |H(v)|^2 / |v|^4 exp(-2 pi i v (d_k - d_j))

the residual of the fit, for stiff and soft fits s.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy import fft

from lensshift.core.arrays import Array, Mask
from lensshift.core.gaussian import MAD_TO_SIGMA

# Power of a scene over that of the noise, at 1 cycle per LR pixel, where a fit stops following.
STIFFNESS = np.array([3.0, 0.3, 0.03])
ALIASES = 3  # a square pixel lets 10 % through at the third
PAD_PX = 4  # continued beyond the border
# The median of 144 sizes, compared to that of all frames: five of its standard errors more.
ODD_FRAME = 1.5
OUTLIER_SIGMAS, OUTLIER_BLOCK_PX = 4.0, 12
# Steps that fill pixels in, fewer where a hundredth of their residual is left.
REFILLS, REFILLED = 5, 0.01
MIDDLE = slice(1, 2)  # of the fits


@dataclass(frozen=True, slots=True, eq=False)
class SmoothFits:
    """The fits of one geometry.

    Parameters
    ----------
    response : [fit frame frame frequency] of the residual, so that unit white noise leaves one
    share : [frame] residual of the middle fit over what a pixel differs by from what the others
        predict
    """

    response: Array
    share: Array

    def residuals(self, values: Array, fits: slice = slice(None)) -> Array:
        """Return the residuals [fit window frame row col] of values [window frame row col]."""
        shape = values.shape[-2:]
        padded = _padded_shape(shape)
        spectrum = fft.rfft2(_continued(values, padded))
        # Not `einsum`, which takes three times as long.
        found = np.sum(self.response[fits][:, None] * spectrum[:, None], axis=3)
        rows, cols = (slice(_pad_px(n), _pad_px(n) + n) for n in shape)
        return np.asarray(fft.irfft2(found, padded)[..., rows, cols])


@lru_cache(maxsize=8)
def smooth_fits(
    offset_bytes: bytes, count: int, shape: tuple[int, int], blur_px: float
) -> SmoothFits:
    """Return the fits to frames of this shape, shifts [frame 2] and blur."""
    offset_px = np.frombuffer(offset_bytes).reshape(count, 2)
    padded = _padded_shape(shape)
    row, col = np.fft.fftfreq(padded[0]), np.fft.rfftfreq(padded[1])
    alias = np.arange(-ALIASES, ALIASES + 1)
    v, w = (at[:, None] + alias for at in (row, col))
    square = np.maximum((v * v)[:, None, None, :, None] + (w * w)[:, None, None, :], 1e-4)
    size = np.exp(-2 * np.pi**2 * blur_px**2 * square) / square
    along_row, along_col = (
        np.exp(-2j * np.pi * at[:, None] * offset_px[:, axis, None])
        for axis, at in enumerate((v, w))
    )
    seen = size * along_row[:, None, ..., None] * along_col[:, :, None]
    seen = seen.reshape(*size.shape[:2], count, -1)  # of each alias by each frame
    covariance = seen @ np.conj(np.swapaxes(seen, -1, -2))
    eye = np.eye(count)
    response = np.stack([s * np.linalg.inv(s * eye + covariance) for s in STIFFNESS])
    twice = np.where((col == 0) | (col == 0.5), 1.0, 2.0)  # for the half that is left out
    response = np.moveaxis(response, (1, 2), (3, 4))
    power = np.einsum("skjrc,c->sk", np.abs(response) ** 2, twice) / (padded[0] * padded[1])
    response = response / np.sqrt(power)[:, :, None, None, None]
    share = np.einsum("kkrc,c->k", response[1].real, twice) / (padded[0] * padded[1])
    return SmoothFits(np.ascontiguousarray(response, np.complex64), share.astype(np.float32))


def _padded_shape(shape: tuple[int, ...]) -> tuple[int, int]:
    rows, cols = (fft.next_fast_len(n + 2 * _pad_px(n), real=True) for n in shape)
    return rows, cols


def _pad_px(size: int) -> int:
    return min(PAD_PX, size - 1)


def _continued(values: Array, padded: tuple[int, int]) -> Array:
    """Return values that go on beyond the border as their mirror image about it, turned over."""
    rows, cols = values.shape[-2:]
    down, right = _pad_px(rows), _pad_px(cols)
    wide = np.zeros((*values.shape[:2], *padded), values.dtype)
    wide[..., down : down + rows, right : right + cols] = values
    across = wide[..., : rows + 2 * down, :].swapaxes(2, 3)
    for lines, pad, size in ((wide[..., right : right + cols], down, rows), (across, right, cols)):
        end = pad + size
        lines[:, :, :pad] = 2 * lines[:, :, pad : pad + 1] - lines[:, :, 2 * pad : pad : -1]
        lines[:, :, end : end + pad] = (
            2 * lines[:, :, end - 1 : end] - lines[:, :, end - 2 : size - 2 : -1]
        )
    return wide


def outliers(fits: SmoothFits, values: Array, rest: Array, used: Mask) -> tuple[Mask, Array]:
    """Return the pixels that the others contradict, and the frames as these predict them there.

    A residual is also large beside an outlier. So all pixels where it is large are left out, and
    those that the rest then predicts come back.

    Parameters
    ----------
    values, used : [window frame row col]
    rest : residuals of the middle fit to the values
    """
    usual, of_frame = _usual(rest, used), _usual(_alone(rest), _alone(used)).reshape(rest.shape)
    odd = of_frame > ODD_FRAME * usual
    doubted = used & (odd | (np.abs(rest) > OUTLIER_SIGMAS * usual))
    if not doubted.any():
        return doubted, values
    filled = refilled(fits, values, rest, doubted | ~used)
    rest = fits.residuals(filled, MIDDLE)[0]
    usual = _usual(rest, used & ~doubted) / fits.share[:, None, None]
    return doubted & (np.abs(values - filled) > OUTLIER_SIGMAS * usual), filled


def _alone(values: Array) -> Array:
    return np.asarray(values.reshape(-1, 1, *values.shape[2:]))


def _usual(rest: Array, used: Mask) -> Array:
    """Return the usual size of the residual around each pixel [window 1 row col]."""
    windows, count, rows, cols = rest.shape
    side = OUTLIER_BLOCK_PX
    tall, wide = -(-rows // side), -(-cols // side)
    size = np.full((windows, count, tall * side, wide * side), np.nan, np.float32)
    size[:, :, :rows, :cols] = np.where(used, np.abs(rest), np.nan)
    blocks = size.reshape(windows, count, tall, side, wide, side).transpose(0, 2, 4, 1, 3, 5)
    ordered = np.sort(blocks.reshape(windows, tall, wide, -1), axis=-1)  # NaN last
    middle = np.isfinite(ordered).sum(axis=-1, keepdims=True) // 2
    found = np.nan_to_num(np.take_along_axis(ordered, middle, axis=-1)[..., 0])
    around = np.repeat(np.repeat(found, side, axis=1), side, axis=2)[:, None, :rows, :cols]
    return np.asarray(MAD_TO_SIGMA * around)


def refilled(
    fits: SmoothFits, values: Array, rest: Array, missing: Mask, start: Array | None = None
) -> Array:
    """Return the frames with the residual of the middle fit brought to 0 at missing pixels.

    Parameters
    ----------
    values, missing : [window frame row col]
    rest : residuals of the middle fit to the values
    start : what missing pixels may be, to begin with
    """

    def there(x: Array) -> Array:
        return np.where(missing, x, np.float32(0))

    def applied(x: Array) -> Array:
        return there(fits.residuals(x, MIDDLE)[0])

    filled, r = values.copy(), there(rest)
    enough = REFILLED**2 * float(np.vdot(r, r))
    if start is not None:
        filled = np.where(missing, start, values)
        r = applied(filled)
    p, power = r.copy(), float(np.vdot(r, r))
    for _ in range(REFILLS):  # conjugate gradients
        if power <= enough:
            break
        q = applied(p)
        curvature = float(np.vdot(p, q))
        if curvature <= np.finfo(np.float32).tiny:
            break
        step = power / curvature
        filled -= step * p
        r -= step * q
        power, before = float(np.vdot(r, r)), power
        p = r + (power / before) * p
    return filled
