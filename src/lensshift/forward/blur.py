"""The response of one LR pixel as tap weights on the HR grid, the same along rows and columns."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtr

from lensshift.core.arrays import Floats, Mask

Positions = Floats
Starts = NDArray[np.int64]
Weights = Floats

GAUSSIAN_TAIL = 2e-4  # a tap of less weight is left out
APERTURE_TAIL = 1e-5  # the same of a square pixel behind a spot
# Below this distance (HR px^2) from the smallest possible variance, linear interpolation is exact.
_NO_EXCESS = 1e-12
# More positions than this are looked up in a table of so many phases, linear in between: that
# keeps the centroid exact and the variance to 2e-8 HR px^2, and a dense field affordable.
_PHASES = 4096
# Spots that differ: linear between tables of so many phases, and of variances so far apart (px^2),
# which keeps the variance, and the contrast at the Nyquist frequency of the frames to 0.002.
_VARYING_PHASES = 512
_SPOT_STEP_PX2 = 0.025
# The same of third moments (px^3): linear between phases 2.65 times as far apart at 0.4 cycles
# per px keeps the contrast there to 0.002.
_SKEW_STEP_PX3 = 0.05
_MOST_NODES = 128  # those of a lens that leaves nothing to resolve need not be as near
_SKEW_TAIL = 1e-3  # of taps that change sign where they fade, and so add up to less than that
# Central differences of sixth order: the cube of a frequency to 2.5 % at 0.37 cycles per pixel and
# scale 2, and 0 at the Nyquist frequency of the HR grid, where that of a sampled response jumps.
_THIRD_DERIVATIVE = (61 / 15, -169 / 60, 3 / 5, -7 / 120)  # of sin f, sin 2f ..


class Blur:
    """A pixel response that is separable in row and col; equal ones have equal taps."""

    __slots__ = ()

    def taps(self, position_hr_px: ArrayLike, scale: int, size: int) -> tuple[Starts, Weights]:
        """Return the taps of LR pixels centred at HR coordinates `position_hr_px`.

        Returns
        -------
        start : integers of the shape of `position_hr_px`, index of the first tap
        weight : [..., T], sums to 1; tap t lies on HR pixel start + t. Taps outside 0 .. size-1
            are dropped and the rest scaled to sum 1; a pixel that sees nothing of the image
            takes the nearest edge pixel.
        """
        position = _as_positions(position_hr_px)
        base = np.floor(position)
        phase = position - base
        if position.size <= _PHASES:
            phases, which = np.unique(phase, return_inverse=True)
            first_tap, table = self.table(phases, scale)
            lead, table = _pack(table)  # of the few phases, not of all positions
            which = which.reshape(position.shape)
            lead, weight = lead[which], table[which]
        else:
            first_tap, table = self.table(np.linspace(0.0, 1.0, _PHASES + 1), scale)
            node = np.minimum((phase * _PHASES).astype(np.int64), _PHASES - 1)
            part = (phase * _PHASES - node)[..., None]
            lead, weight = _pack((1.0 - part) * table[node] + part * table[node + 1])
        return _crop(base.astype(np.int64) + first_tap + lead, weight, size)

    def table(self, phase: Positions, scale: int) -> tuple[int, Weights]:
        """Return the first tap and the weights [phase T] of pixels centred at phases in 0 .. 1."""
        raise NotImplementedError

    def widened(self, spot_px2: float) -> Blur:
        """Return the response with another variance of the optical spot, by so many px^2."""
        raise NotImplementedError


@dataclass(frozen=True, slots=True)
class GaussianBlur(Blur):
    """A Gaussian pixel response that has the width and the centroid that it claims.

        w_n ~ exp(-(n - m)^2 / (2 s^2)),   sum w_n n = v,   sum w_n (n - v)^2 = (scale sigma)^2

    m and s are solved at every phase: a sampled Gaussian narrower than about 0.7 HR px is narrower
    than its name says, and off centre. No kernel of mean v has a smaller variance than linear
    interpolation, p (1 - p) with p = frac(v); where sigma asks for less, that is used. Taps of less
    than about 2e-4 are left out, the moments hold without them. ValueError if `sigma_px` is
    negative or not finite.
    """

    sigma_px: float = 0.3  # standard deviation in LR pixels; 0 gives linear interpolation

    def __post_init__(self) -> None:
        if not (np.isfinite(self.sigma_px) and self.sigma_px >= 0):
            raise ValueError(f"expected sigma_px >= 0, got {self.sigma_px}")

    def table(self, phase: Positions, scale: int) -> tuple[int, Weights]:
        """Return the first tap and the weights [phase T] (see `Blur.table`)."""
        return _solved_table(phase.tobytes(), self.sigma_px * scale)

    def widened(self, spot_px2: float) -> GaussianBlur:
        """Return the response behind another spot; never narrower than 0."""
        return GaussianBlur(float(np.sqrt(max(self.sigma_px**2 + spot_px2, 0.0))))


@dataclass(frozen=True, slots=True)
class ApertureBlur(Blur):
    """A square pixel aperture behind optics with a Gaussian spot, on piecewise constant HR pixels.

        w_n = integral over HR pixel n of (box * Gaussian)(t - v) dt

    The box is fill_factor * scale HR pixels wide, the Gaussian has the width of the optics. The
    integral is exact; taps below 1e-5 are left out and the rest scaled to sum 1. HR pixels are not
    evenly bright: off the HR grid a Gaussian of the same second moment errs less. ValueError if a
    parameter is out of its range.
    """

    fill_factor: float = 1.0  # light-sensitive width of the pixel / pixel pitch, in (0, 1]
    optics_sigma_px: float = 0.0  # standard deviation of the optical spot in LR pixels

    def __post_init__(self) -> None:
        if not 0 < self.fill_factor <= 1:
            raise ValueError(f"expected a fill_factor in (0, 1], got {self.fill_factor}")
        if not (np.isfinite(self.optics_sigma_px) and self.optics_sigma_px >= 0):
            raise ValueError(f"expected optics_sigma_px >= 0, got {self.optics_sigma_px}")

    def table(self, phase: Positions, scale: int) -> tuple[int, Weights]:
        """Return the first tap and the weights [phase T] (see `Blur.table`)."""
        half_hr_px, sigma_hr_px = 0.5 * self.fill_factor * scale, self.optics_sigma_px * scale
        reach = int(np.ceil(half_hr_px + 0.5 + 4.5 * sigma_hr_px))
        edge = np.arange(-reach, reach + 3) - 0.5 - phase[:, None]
        step = _ramp(edge + half_hr_px, sigma_hr_px) - _ramp(edge - half_hr_px, sigma_hr_px)
        table = np.diff(step, axis=1) / (2 * half_hr_px)
        table[table < APERTURE_TAIL] = 0.0
        return -reach, table / table.sum(axis=1, keepdims=True)

    def widened(self, spot_px2: float) -> ApertureBlur:
        """Return the aperture behind another spot; never a smaller one than a point."""
        spot_px = float(np.sqrt(max(self.optics_sigma_px**2 + spot_px2, 0.0)))
        return ApertureBlur(self.fill_factor, spot_px)


def varying_taps(
    blur: Blur,
    position_hr_px: Positions,
    spot_px2: Weights,
    scale: int,
    size: int,
    skew_px3: Weights | None = None,
) -> tuple[Starts, Weights]:
    """Return the taps of LR pixels whose spots differ, as `Blur.taps`.

    A few responses times weight maps: each pixel takes the two that are next to it in variance, in
    the shares that keep the variance of its own, and of each the two next to it in third moment.

    Parameters
    ----------
    blur : the response without the differences
    position_hr_px : [...]
    spot_px2 : [...] variance of the spot beyond that of `blur`, in LR pixels, also negative
    skew_px3 : [...] its third central moment in LR pixels, or None if it is even
    """
    position = _as_positions(position_hr_px)
    spots_px2, spot, spot_part = _noded(spot_px2, _SPOT_STEP_PX2)
    skews_px3, skew, skew_part = np.zeros(1), np.zeros_like(spot), np.zeros_like(spot_part)
    if skew_px3 is not None and np.any(skew_px3):
        skews_px3, skew, skew_part = _noded(skew_px3, _SKEW_STEP_PX3)
    phases = np.linspace(0.0, 1.0, _VARYING_PHASES + 1)
    found: dict[int, tuple[int, Weights]] = {}  # by the nodes that any pixel needs
    corners = [(up, aside) for up in (0, 1) for aside in range(min(2, len(skews_px3)))]
    for up, aside in corners:
        for one in np.unique((spot + up) * len(skews_px3) + skew + aside):
            number, turn = divmod(int(one), len(skews_px3))
            even = blur.widened(spots_px2[number]).table(phases, scale)
            found[int(one)] = skewed(*even, skews_px3[turn] * scale**3)
    first_tap = min(first for first, _ in found.values())
    taps = max(first + table.shape[1] for first, table in found.values()) - first_tap
    tables = np.zeros((len(spots_px2) * len(skews_px3), len(phases), taps))
    for one, (first, table) in found.items():
        tables[one, :, first - first_tap : first - first_tap + table.shape[1]] = table
    base = np.floor(position)
    phase, phase_part = _between(position - base, _VARYING_PHASES)
    weight = np.zeros((*position.shape, taps))
    for up, aside in corners:
        of_node = np.abs(1 - up - spot_part) * np.abs(1 - aside - skew_part)
        one = (spot + up) * len(skews_px3) + skew + aside
        for beside in (0, 1):
            share = of_node * np.abs(1 - beside - phase_part)
            weight += share[..., None] * tables[one, phase + beside]
    lead, weight = _pack(weight)
    return _crop(base.astype(np.int64) + first_tap + lead, weight, size)


def skewed(first_tap: int, table: Weights, skew_hr_px3: float) -> tuple[int, Weights]:
    """Return first tap and weights [phase T] of a response with another third central moment.

        sum_n w_n exp(i f n)  becomes  exp(i skew f^3 / 6) times as much

    which leaves sum, mean, variance and contrast as they are.

    Parameters
    ----------
    skew_hr_px3 : by how much it is more, in HR pixels
    """
    if skew_hr_px3 == 0:
        return first_tap, table
    spare = table.shape[1] + int(np.ceil(3.0 * abs(skew_hr_px3)))  # no frequency moves farther
    padded = np.pad(table, ((0, 0), (spare, spare)))
    f = 2.0 * np.pi * np.fft.rfftfreq(padded.shape[1])
    cube = sum(c * np.sin(n * f) for n, c in enumerate(_THIRD_DERIVATIVE, start=1))
    turned = np.fft.rfft(padded, axis=1) * np.exp(-1j / 6.0 * skew_hr_px3 * cube)
    found = np.fft.irfft(turned, padded.shape[1], axis=1)
    found[np.abs(found) < _SKEW_TAIL] = 0.0
    used = np.flatnonzero(found.any(axis=0))
    found = found[:, used[0] : used[-1] + 1]
    return first_tap - spare + int(used[0]), found / found.sum(axis=1, keepdims=True)


def _noded(values: Weights, step: float) -> tuple[Weights, Starts, Weights]:
    """Return nodes so far apart, the one below each value, and how far on the way it is."""
    low, high = float(values.min()), float(values.max())
    count = max(1, min(_MOST_NODES, int(np.ceil((high - low) / step))))
    return np.linspace(low, high, count + 1), *_between(
        (values - low) / max(high - low, 1e-12), count
    )


def _between(at: Weights, steps: int) -> tuple[Starts, Weights]:
    """Return the node below each place in 0 .. 1, and how far on the way to the next it is."""
    node = np.clip((at * steps).astype(np.int64), 0, steps - 1)
    return node, np.clip(at * steps - node, 0.0, 1.0)


def sees_image(position_hr_px: ArrayLike, size: int) -> Mask:
    """Tell which LR pixels have their centre on the area of the HR pixels 0 .. size-1.

    Half of the footprint of such a pixel, or more, lies on the image.
    """
    position = _as_positions(position_hr_px)
    inside: Mask = np.abs(position - 0.5 * (size - 1)) <= 0.5 * size + 1e-6
    return inside


def _as_positions(position_hr_px: ArrayLike) -> Positions:
    position = np.asarray(position_hr_px, dtype=np.float64)
    if not np.all(np.isfinite(position)):
        raise ValueError("expected finite positions, got NaN or infinity")
    return position


def _ramp(at: Positions, sigma: float) -> Positions:
    """Return the integral of the Gaussian step, z Phi(z/s) + s phi(z/s); max(z, 0) for s = 0."""
    if sigma < 1e-9:
        return np.maximum(at, 0.0)
    z = at / sigma
    ramp: Positions = sigma * (z * ndtr(z) + np.exp(-0.5 * z * z) / np.sqrt(2 * np.pi))
    return ramp


# The moments are solved once for the few phases of a burst, not for every burst of a stream.
@lru_cache(maxsize=64)
def _solved_table(phase_bytes: bytes, sigma: float) -> tuple[int, Weights]:
    """Return first tap and weights [phase, T] of mean p and variance max(sigma^2, p (1 - p))."""
    phases = np.frombuffer(phase_bytes, dtype=np.float64)
    reach = _gaussian_reach(sigma)
    t = np.arange(-int(reach), int(reach) + 2, dtype=np.float64)
    table = np.zeros((phases.size, t.size))
    table[:, t == 0] = 1.0 - phases[:, None]
    table[:, t == 1] = phases[:, None]
    wide = np.flatnonzero(sigma**2 - phases * (1.0 - phases) > _NO_EXCESS)
    if wide.size:
        table[wide] = _maximum_entropy(phases[wide], sigma, t, reach)
    table.flags.writeable = False
    return int(t[0]), table


def _gaussian_reach(sigma: float) -> float:
    """Return the distance beyond which a tap of the Gaussian is smaller than `GAUSSIAN_TAIL`."""
    if sigma == 0:
        return 0.0
    peak = 1.0 / max(1.0, sigma * np.sqrt(2 * np.pi))
    reach = sigma * np.sqrt(2 * np.log(max(peak / GAUSSIAN_TAIL, 1e2)))
    # Three taps at least (and four half way between two pixels), or no variance can be set.
    return max(1.5, float(reach))


def _maximum_entropy(phases: Positions, sigma: float, t: Positions, reach: float) -> Weights:
    """Return weights exp(a t - c t (t - 1)), normalised, with the two moments exact (Newton).

    t (t - 1) vanishes on the two taps of linear interpolation, so its mean is the variance above
    that of linear interpolation, and stays well conditioned however small that becomes.
    """
    mirrored = phases > 0.5
    p = np.where(mirrored, 1.0 - phases, phases)
    q = t * (t - 1.0)
    excess = sigma**2 - p * (1.0 - p)
    support = np.abs(t - p[:, None]) <= reach + 1e-9
    a, c = _moment_start(p, sigma, excess)
    for _ in range(40):
        exponent = np.where(support, a[:, None] * t - c[:, None] * q, -np.inf)
        w = np.exp(exponent - exponent.max(axis=1, keepdims=True))
        w /= w.sum(axis=1, keepdims=True)
        mean, more = w @ t, w @ q
        miss, gap = mean - p, np.log(more / excess)
        if max(np.abs(miss).max(), np.abs(gap).max()) < 1e-13:
            break
        from_mean, from_more = t - mean[:, None], q - more[:, None]
        t_t = (w * from_mean**2).sum(axis=1)
        t_q = (w * from_mean * from_more).sum(axis=1)
        q_q = (w * from_more**2).sum(axis=1)
        determinant = t_t * q_q - t_q**2
        a += np.clip((t_q * gap * more - q_q * miss) / determinant, -1.0, 1.0)
        c += np.clip((t_t * gap * more - t_q * miss) / determinant, -1.0, 1.0)
    weight: Weights = np.where(mirrored[:, None], w[:, ::-1], w)
    return weight


def _moment_start(p: Positions, sigma: float, excess: Positions) -> tuple[Positions, Positions]:
    """Return where Newton starts: the three-tap kernel if narrow, else the plain Gaussian."""
    if sigma > 0.55:
        c = np.full_like(p, 0.5 / sigma**2)
        return 2.0 * c * p - c, c
    second = sigma**2 + p * p
    a = np.log((second + p) / (2.0 * (1.0 - second)))
    c = -0.5 * (a + np.log(excess / (2.0 * (1.0 - second))))
    return a, c


def _pack(table: Weights) -> tuple[Starts, Weights]:
    """Move the non-zero taps to the left; return how far, and as few taps as hold them all."""
    count = table.shape[-1]
    used = table != 0
    lead = np.argmax(used, axis=-1)
    last = count - 1 - np.argmax(used[..., ::-1], axis=-1)
    columns = lead[..., None] + np.arange(int((last - lead).max(initial=0)) + 1)
    inside = columns < count
    packed = np.take_along_axis(table, np.where(inside, columns, 0), axis=-1)
    return lead.astype(np.int64), np.where(inside, packed, 0.0)


def _crop(first: Starts, weight: Weights, size: int) -> tuple[Starts, Weights]:
    """Drop taps outside 0 .. size-1, scale the rest to sum 1, and keep the array rectangular."""
    count = weight.shape[-1]
    kept = min(count, size)
    cut = (first < 0) | (first + count > size)
    start = np.clip(first, 0, size - kept)
    source = start[cut][:, None] + np.arange(kept) - first[cut][:, None]
    taken = np.take_along_axis(weight[cut], np.clip(source, 0, count - 1), axis=-1)
    # Skewed responses turn negative where they fade, and the sum of such taps may vanish.
    border = np.where((source >= 0) & (source < count), np.maximum(taken, 0.0), 0.0)
    total = border.sum(axis=-1)
    above = first[cut] < 0
    border[(total == 0) & above, 0] = 1.0
    border[(total == 0) & ~above, -1] = 1.0
    cropped = weight[..., :kept].copy()
    cropped[cut] = border / border.sum(axis=-1, keepdims=True)
    return start, cropped
