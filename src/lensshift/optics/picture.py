"""What a lens, the element that moves and the pattern leave of the picture: a closed form."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lensshift.core.grid import Grid
from lensshift.core.pattern import named_pattern_px
from lensshift.optics.lens import Lens
from lensshift.optics.mtf import diffraction_limit
from lensshift.optics.shift import decenter_for_shift, moving, px_per_um
from lensshift.optics.spots import spots
from lensshift.optics.which import edge_fields

Array = NDArray[np.float64]

_ALIASES = np.arange(-2, 2)  # scenes up to two cycles per pixel, twice what half pixels carry
_WAVES = 8  # frequencies of the baseband along each axis
_RINGS = 8
_SCENE = 0.2  # standard deviation of a scene as a share of full scale
_LARGEST_PX = 64.0  # structures larger than this add no more


@dataclass(frozen=True, slots=True)
class PictureScore:
    """What is left of a scene when the frames are fused.

    Parameters
    ----------
    element : number of the one that moves, from 0
    pattern : of the frames
    rmse : error of the picture as a share of full scale, root mean square over the fields
    rmse_exact : the same if the actuator made no error
    shift_error_px : standard deviation of each shift along each axis
    """

    element: int
    pattern: str
    rmse: float
    rmse_exact: float
    shift_error_px: float


def picture_score(
    lens: Lens,
    element: int,
    grid: Grid,
    *,
    pattern: str = "square",
    actuator_um: float = 1.0,
    noise: float = 0.005,
) -> PictureScore:
    """Return the error of the best linear reconstruction with a lens, a mover and a pattern.

    At the centre, the ends of the axes and the corners of the sensor, with the traced shift and
    spot of each frame there (geometric OTF times the diffraction limit). Patterns of other than
    four frames share the light of four.

    Parameters
    ----------
    element : number of the one that moves, from 0
    pattern : a name of `lensshift.core.pattern.PATTERNS`
    actuator_um : standard deviation of each position of the element
    noise : of a pixel of four frames, standard deviation as a share of full scale

    Raises
    ------
    ValueError
        If a number is out of range, or as in `decenter_for_shift`.
    """
    if not actuator_um >= 0 or not noise > 0:
        raise ValueError(f"expected actuator_um >= 0 and noise > 0, got {actuator_um} and {noise}")
    pitch_mm = np.asarray(grid.pitch_mm)
    fields = edge_fields(lens, grid)
    moves_mm = decenter_for_shift(lens, element, named_pattern_px(pattern), grid)
    moved = spots(lens, fields, build=moving(lens, element, moves_mm[:, None, :]), rings=_RINGS)
    resting_mm = spots(lens, fields, rings=_RINGS).centroid_mm
    offset_px = (moved.centroid_mm - resting_mm) / pitch_mm
    ray_px = moved.ray_mm / pitch_mm
    weight = moved.weight / moved.weight.sum(axis=-1, keepdims=True)
    spread_px = px_per_um(lens, element, grid) * actuator_um
    each_noise = noise * math.sqrt(len(moves_mm) / 4.0)
    squares = []
    for number in range(len(fields)):
        otf = _SpotOtf(lens, ray_px[:, number], weight[:, number], pitch_mm)
        errors = [
            linear_rmse(offset_px[:, number], otf, each_noise, error_px)
            for error_px in (spread_px, 0.0)
        ]
        squares.append(np.square(errors))
    rmse, exact = np.sqrt(np.mean(squares, axis=0))
    return PictureScore(element, pattern, float(rmse), float(exact), spread_px)


class _SpotOtf:
    """OTF of spots [frame ray 2] in pixels times the diffraction limit, made once."""

    def __init__(self, lens: Lens, ray_px: Array, weight: Array, pitch_mm: Array) -> None:
        self.lens, self.ray_px, self.weight, self.pitch_mm = lens, ray_px, weight, pitch_mm
        self.found: NDArray[np.complex128] | None = None

    def __call__(self, frequency: Array) -> NDArray[np.complex128]:
        if self.found is None:
            phase = np.einsum("frx,...x->f...r", self.ray_px, frequency)
            spot = np.einsum("f...r,fr->f...", np.exp(-2j * np.pi * phase), self.weight)
            lpmm = np.linalg.norm(frequency / self.pitch_mm, axis=-1)
            rising, places = np.unique(lpmm, return_inverse=True)
            limit = diffraction_limit(self.lens, rising).modulation[places].reshape(lpmm.shape)
            self.found = np.asarray(spot * limit)
        return self.found


def linear_rmse(
    offset_px: ArrayLike,
    otf: Callable[[Array], NDArray[np.complex128]],
    noise: float,
    shift_error_px: float = 0.0,
    *,
    scene: float = _SCENE,
) -> float:
    """Return the root mean square error of the best linear estimate of a picture from frames.

        frame_k(f) = sum_m A_km s(f + m),   A_km = OTF_k sinc(f_row) sinc(f_col) exp(2 pi i f p_k)
        error = trace T [ S - S A* (A S A* + N)^-1 A S ] T*

    per frequency f of the pixels, with the aliases m, the power S ~ 1 / (f_0^2 + f^2) of natural
    scenes, T the aperture of pixels half the size, and N the noise and what unknown errors of the
    shifts do, sum_m |2 pi f|^2 shift_error^2 |A_km|^2 S_m, independent from frame to frame.

    Parameters
    ----------
    offset_px : [frame 2] (row, col)
    otf : of the lens [frame ...] at frequencies [... 2] in cycles per pixel
    noise : standard deviation of a pixel
    shift_error_px : standard deviation along each axis
    scene : standard deviation of the scene

    Source: N. Wiener, Extrapolation, Interpolation, and Smoothing (1949); the power of scenes:
    D. J. Field, J. Opt. Soc. Am. A 4 (1987) 2379.
    """
    offsets = np.asarray(offset_px, dtype=np.float64)
    base = (np.arange(_WAVES) + 0.5) / _WAVES - 0.5
    waves = np.stack(np.meshgrid(base, base, indexing="ij"), axis=-1).reshape(-1, 1, 2)
    aliases = np.stack(np.meshgrid(_ALIASES, _ALIASES, indexing="ij"), axis=-1).reshape(1, -1, 2)
    frequency = waves + 0.5 * (len(_ALIASES) % 2 == 0) + aliases  # even about 0
    square = np.sum(frequency**2, axis=-1)
    power = 1.0 / (_LARGEST_PX**-2 + square)
    power *= scene**2 / power.sum()
    aperture = np.prod(np.sinc(frequency), axis=-1)
    shift = np.exp(2j * np.pi * np.einsum("kx,fmx->kfm", offsets, frequency))
    response = np.moveaxis(otf(frequency) * aperture * shift, 0, 1)  # [f frame m]
    seen = response * power[:, None, :]
    # Each of the frequencies carries its share of the noise.
    spread = (2.0 * np.pi * shift_error_px) ** 2 * np.einsum(
        "fkm,fm->fk", np.abs(response) ** 2, square * power
    )
    clutter = noise**2 / len(waves) + spread
    covariance = seen @ np.conj(np.swapaxes(response, 1, 2))
    covariance = covariance + clutter[:, :, None] * np.eye(len(offsets))
    solved = np.linalg.solve(covariance, seen)
    known = np.einsum("fkm,fkm->fm", np.conj(seen), solved).real
    wanted = np.prod(np.sinc(0.5 * frequency), axis=-1) ** 2
    return float(np.sqrt(max(0.0, np.sum(wanted * (power - known)))))


def format_scores(names: list[str], scores: list[PictureScore]) -> str:
    """Return a table of scores as lines of text."""
    lines = [f"{'lens':<44} moves  pattern  shift error    RMSE   exact shifts"]
    lines += [
        f"{name:<44.44} {one.element + 1:>5}  {one.pattern:<8} {one.shift_error_px:8.4f} px "
        f"{one.rmse:8.5f} {one.rmse_exact:8.5f}"
        for name, one in zip(names, scores, strict=True)
    ]
    return "\n".join(lines)
