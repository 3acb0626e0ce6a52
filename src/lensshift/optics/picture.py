"""What a lens, the element that moves and the pattern leave of the picture: a closed form."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lensshift.core.arrays import Floats
from lensshift.core.grid import Grid
from lensshift.core.pattern import named_pattern_px
from lensshift.optics.actuator import PIXEL_NOISE
from lensshift.optics.lens import Lens
from lensshift.optics.otf import diffraction_limit
from lensshift.optics.shift import decenter_for_shift, moving, px_per_um
from lensshift.optics.spots import spots
from lensshift.optics.which import edge_fields

_ALIASES = np.arange(-2, 2)  # scenes up to two cycles per pixel, twice what half pixels carry
_WAVES = 8  # frequencies of the baseband along each axis
_RINGS = 8  # of the pupil, for the OTF up to two cycles per pixel
_SCENE = 0.2  # standard deviation of a scene as a share of full scale
PLACE_PX = 0.25  # of the pixels of a picture of twice as many, from the middle of a pixel
# What a search tries: patterns, and where the picture has its pixels.
PICTURES = (("square", PLACE_PX), ("square", 0.0), ("3x3", PLACE_PX))
_LIMIT_STEPS = 33  # of the diffraction limit, which hardly bends
_LARGEST_PX = 64.0  # structures larger than this add no more


@dataclass(frozen=True, slots=True)
class PictureScore:
    """What is left of a scene when the frames are fused.

    Parameters
    ----------
    element : number of the one that moves, from 0
    pattern : of the frames
    place_px : of the pixels of the picture, as in `linear_picture`
    rmse : error of the picture as a share of full scale, root mean square over the fields
    rmse_exact : the same if the actuator made no error
    mtf : contrast beyond what the pixels of frames carry (`linear_mtf`), mean over the fields
    shift_error_px : standard deviation of each shift along each axis
    """

    element: int
    pattern: str
    place_px: float
    rmse: float
    rmse_exact: float
    mtf: float
    shift_error_px: float

    @property
    def label(self) -> str:
        """The pattern and where the picture has its pixels."""
        return self.pattern if self.place_px == PLACE_PX else f"{self.pattern}, aside"


def picture_score(
    lens: Lens,
    element: int,
    grid: Grid,
    *,
    pattern: str = "square",
    place_px: float = PLACE_PX,
    actuator_um: float = 1.0,
    noise: float = PIXEL_NOISE,
) -> PictureScore:
    """Return the error of the best linear reconstruction with a lens, a mover and a pattern.

    At the centre, the ends of the axes and the corners of the sensor, with the traced shift and
    spot of each frame there (geometric OTF times the diffraction limit). Patterns of other than
    four frames share the light of four.

    Parameters
    ----------
    element : number of the one that moves, from 0
    pattern : a name of `lensshift.core.pattern.PATTERNS`
    place_px : of the pixels of the picture, as in `linear_picture`; another than 1/4 is had by that
        much more or less in all offsets of a burst
    actuator_um : standard deviation of each position of the element
    noise : of a pixel of four frames, standard deviation as a share of full scale

    Raises
    ------
    ValueError
        If a number is out of range, or as in `decenter_for_shift`.
    """
    if not actuator_um >= 0 or not noise > 0:
        raise ValueError(f"expected actuator_um >= 0 and noise > 0, got {actuator_um} and {noise}")
    frames = traced_frames(lens, element, grid, named_pattern_px(pattern))
    error_px = frames.px_per_um * actuator_um
    each_noise = noise * math.sqrt(len(frames.offset_px) / 4.0)
    squares, contrast = [], []
    for number in range(frames.offset_px.shape[1]):
        seen = (frames.offset_px[:, number], frames.otf(number), each_noise)
        wrong, right = (linear_picture(*seen, px, place_px=place_px) for px in (error_px, 0.0))
        squares.append(np.square([wrong.rmse, right.rmse]))
        contrast.append(wrong.mtf)
    rmse, exact = map(float, np.sqrt(np.mean(squares, axis=0)))
    mtf = float(np.mean(contrast))
    return PictureScore(element, pattern, place_px, rmse, exact, mtf, error_px)


@dataclass(frozen=True, slots=True, eq=False)
class TracedFrames:
    """Frames at the fields of `edge_fields`.

    Parameters
    ----------
    offset_px : [frame field 2] (row, col)
    ray_px, weight : [frame field ray 2] and [frame field ray] of the spots
    px_per_um : of the element
    lens, pitch_mm : what made them
    """

    offset_px: Floats
    ray_px: Floats
    weight: Floats
    px_per_um: float
    lens: Lens
    pitch_mm: Floats

    def otf(self, field: int) -> Callable[[Floats], NDArray[np.complex128]]:
        """Return the OTF [frame ...] of a field at frequencies [... 2] in cycles per pixel."""
        spots_px = list(zip(self.ray_px[:, field], self.weight[:, field], strict=True))
        known: dict[bytes, NDArray[np.complex128]] = {}  # one for all that is asked of a field

        def otf(frequency: Floats) -> NDArray[np.complex128]:
            if (key := frequency.tobytes()) not in known:
                spot = [
                    np.exp(-2j * np.pi * (frequency @ ray.T)) @ weight for ray, weight in spots_px
                ]
                lpmm = np.linalg.norm(frequency / self.pitch_mm, axis=-1)
                rising = np.linspace(0.0, max(lpmm.max(), 1.0), _LIMIT_STEPS)
                limit = np.interp(lpmm, rising, diffraction_limit(self.lens, rising).modulation)
                known[key] = np.asarray(spot) * limit
            return known[key]

        return otf


def traced_frames(lens: Lens, element: int, grid: Grid, pattern_px: ArrayLike) -> TracedFrames:
    """Trace the shift and the spot of each frame at the centre, edges and corners of a sensor.

    Parameters
    ----------
    element : number of the one that moves, from 0
    pattern_px : [frame 2] shifts (row, col) at the centre
    """
    pitch_mm = np.asarray(grid.pitch_mm)
    fields = edge_fields(lens, grid)
    moves_mm = decenter_for_shift(lens, element, pattern_px, grid)
    moved = spots(lens, fields, build=moving(lens, element, moves_mm[:, None, :]), rings=_RINGS)
    resting_mm = spots(lens, fields, rings=_RINGS).centroid_mm
    return TracedFrames(
        offset_px=(moved.centroid_mm - resting_mm) / pitch_mm,
        ray_px=moved.ray_mm / pitch_mm,
        weight=moved.weight / moved.weight.sum(axis=-1, keepdims=True),
        px_per_um=px_per_um(lens, element, grid),
        lens=lens,
        pitch_mm=pitch_mm,
    )


class LinearPicture(NamedTuple):
    """What the best linear estimate of a picture from frames leaves and passes.

    Parameters
    ----------
    rmse : root mean square error
    mtf : contrast beyond what the pixels of frames carry: the mean, along rows and columns from
        half a cycle to one cycle per pixel, of the picture's share of a wave that the scene has,
        against that of sharp pixels half the size
    """

    rmse: float
    mtf: float


def linear_picture(
    offset_px: ArrayLike,
    otf: Callable[[Floats], NDArray[np.complex128]],
    noise: float,
    shift_error_px: float = 0.0,
    *,
    scene: float = _SCENE,
    place_px: float | None = PLACE_PX,
) -> LinearPicture:
    """Return error and contrast of the best linear estimate of a picture from frames.

        frame_k(f) = sum_m A_km s(f + m),  A_km = OTF_k sinc(f_row) sinc(f_col) exp(-2 pi i f p_k)
        E = S - S A* (A S A* + N)^-1 A S
        error^2 = sum_f sum_mm' T_m T_m' E_mm' mean_r exp(2 pi i (m - m') r)

    per frequency f of the pixels, with the aliases m, the power S ~ 1 / (f_0^2 + f^2) of natural
    scenes, T the aperture of pixels half the size, r where they lie on a pixel of the frames, and N
    the noise and what unknown errors of the shifts do, sum_m |2 pi f|^2 shift_error^2 |A_km|^2 S_m,
    independent from frame to frame. The aliases of the error are not independent of each other:
    it differs from place to place.

    Parameters
    ----------
    offset_px : [frame 2] (row, col)
    otf : of the lens [frame ...] at frequencies [... 2] in cycles per pixel
    noise : standard deviation of a pixel
    shift_error_px : standard deviation along each axis
    scene : standard deviation of the scene
    place_px : of a pixel of the picture from the middle of a pixel of the frames, along each axis:
        1/4 as pictures have them, 0 for half a pixel of the picture aside; None: mean over all

    Source: N. Wiener, Extrapolation, Interpolation, and Smoothing (1949); the power of scenes:
    D. J. Field, J. Opt. Soc. Am. A 4 (1987) 2379.
    """
    found = _estimate(offset_px, otf, noise, shift_error_px, scene)
    folded = _folded(found, place_px) * found.aperture[:, :, None]
    passed = np.einsum("fnm,fnm->fm", folded.conj(), found.known).real
    passed = passed / (found.aperture * found.power)
    high, low = np.abs(found.frequency).max(axis=-1), np.abs(found.frequency).min(axis=-1)
    contrast = passed[(high > 0.5) & (high < 1.0) & (low < 1.0 / _WAVES)].mean()
    left = -found.known
    left[:, range(len(found.alias)), range(len(found.alias))] += found.power
    square = np.sum((folded * found.aperture[:, None, :] * left).real)
    return LinearPicture(float(np.sqrt(max(0.0, square))), float(contrast))


class _Estimate(NamedTuple):
    """What frames tell of each frequency and its aliases."""

    frequency: Floats  # [f m 2] cycles per pixel
    alias: NDArray[np.signedinteger]  # [m 2] whole cycles per pixel
    power: Floats  # [f m] of the scene
    aperture: Floats  # [f m] of pixels half the size
    known: NDArray[np.complex128]  # [f m m'] covariance of the estimate


def _estimate(
    offset_px: ArrayLike,
    otf: Callable[[Floats], NDArray[np.complex128]],
    noise: float,
    shift_error_px: float,
    scene: float,
) -> _Estimate:
    offsets = np.asarray(offset_px, dtype=np.float64)
    base = (np.arange(_WAVES) + 0.5) / _WAVES - 0.5
    waves = np.stack(np.meshgrid(base, base, indexing="ij"), axis=-1).reshape(-1, 1, 2)
    alias = np.stack(np.meshgrid(_ALIASES, _ALIASES, indexing="ij"), axis=-1).reshape(-1, 2)
    frequency = waves + 0.5 * (len(_ALIASES) % 2 == 0) + alias  # even about 0
    square = np.sum(frequency**2, axis=-1)
    power = 1.0 / (_LARGEST_PX**-2 + square)
    power *= scene**2 / power.sum()
    aperture = np.prod(np.sinc(frequency), axis=-1)
    shift = np.exp(-2j * np.pi * np.einsum("kx,fmx->kfm", offsets, frequency))
    response = np.moveaxis(otf(frequency) * aperture * shift, 0, 1)  # [f frame m]
    seen = response * power[:, None, :]
    # Each of the frequencies carries its share of the noise.
    spread = (2.0 * np.pi * shift_error_px) ** 2 * np.einsum(
        "fkm,fm->fk", np.abs(response) ** 2, square * power
    )
    clutter = noise**2 / len(waves) + spread
    covariance = seen @ np.conj(np.swapaxes(response, 1, 2))
    covariance = covariance + clutter[:, :, None] * np.eye(len(offsets))
    known = np.conj(np.swapaxes(seen, 1, 2)) @ np.linalg.solve(covariance, seen)
    half = np.prod(np.sinc(0.5 * frequency), axis=-1)
    return _Estimate(frequency, alias, power, half, known)


def _folded(found: _Estimate, place_px: float | None) -> NDArray[np.complex128]:
    """Return the mean of exp(2 pi i (m - m') r) over the pixels of a picture, [m m']."""
    apart = found.alias[:, None] - found.alias[None]
    if place_px is None:
        return np.asarray(np.all(apart == 0, axis=-1), dtype=np.complex128)
    turned = np.exp(2j * np.pi * place_px * apart.sum(axis=-1))  # the next pixel is 1/2 away
    return np.asarray(np.where(np.all(apart % 2 == 0, axis=-1), turned, 0.0))


def format_scores(names: list[str], scores: list[PictureScore]) -> str:
    """Return a table of scores as lines of text."""
    lines = [f"{'lens':<40} moves  pattern        shift error    RMSE   exact shifts  SR MTF"]
    lines += [
        f"{name:<40.40} {one.element + 1:>5}  {one.label:<14} {one.shift_error_px:8.4f} px "
        f"{one.rmse:8.5f} {one.rmse_exact:8.5f}     {one.mtf:8.3f}"
        for name, one in zip(names, scores, strict=True)
    ]
    return "\n".join(lines)
