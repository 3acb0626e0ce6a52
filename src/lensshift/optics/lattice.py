"""The image of a point as light on a lattice of points, as much as pixels of some size can tell."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lensshift.core.arrays import Floats, Mask
from lensshift.core.errors import QualityWarning
from lensshift.core.linear_algebra import one_thread
from lensshift.optics.lens import Lens
from lensshift.optics.mtf import otf_of_rays
from lensshift.optics.otf import PupilFit, pupils_of_fields
from lensshift.optics.spots import Spots, spots
from lensshift.optics.trace import Build

_TAIL = 10.0  # wavelengths x f-number: beyond are 0.2 / 10 of the light of an Airy disc
_LEAST_SAMPLES = 64  # across the pupil
_FEW_POINTS = 40  # along an axis
_MOST_POINTS = 1024  # along an axis; of a spot a hundred pixels wide rays say enough
_RAY_RINGS = 24  # where there is no diffraction
_MOST_SAMPLES = 2048  # across the pupil; beyond are 100 waves, where rays do
# Of fewer samples waves cost no more than rays, whose OTF is within 0.005 of theirs (mostly 0.001)
# at frequencies so far below the cutoff.
_FEW_SAMPLES, _LOW = 256, 1.0 / 64.0
_FEW_STEPS, _STEPS = 40, 200  # of the fit, on every other point and on all of them
_CLOSE = 1e-3  # of the contrast, anywhere in the band
_ENOUGH = 5e-3  # beyond, every other point is not
_GRAIN = 5e-4  # of the light: weaker points are drawn together

Transform = Callable[[NDArray[Any]], NDArray[Any]]
Otf = NDArray[Any]


@dataclass(frozen=True, slots=True, eq=False)
class LatticeImage:
    """Light on points of a lattice, of which the image of the point is one.

    Parameters
    ----------
    place : [point 2] (row, col) whole steps from the image
    weight : [point] sums to 1
    """

    place: NDArray[np.int64]
    weight: Floats


def lattice_images(
    lens: Lens,
    field_tan: Floats,
    step_mm: Floats,
    band_lpmm: Floats,
    *,
    build: Build | None = None,
    diffraction: bool = True,
) -> list[LatticeImage]:
    """Return light on a lattice that has the OTF of each field, about the centroid, within a band.

    Parameters
    ----------
    field_tan : [field 2] (row, col)
    step_mm : [2] of the lattice
    band_lpmm : [2] highest frequency along each axis, less than a quarter of 1 / step
    build : as for `exact_otf`
    diffraction : whether there is any; else only rays
    """
    with warnings.catch_warnings(), one_thread():
        warnings.simplefilter("ignore", QualityWarning)  # of light that is lost: spots tell of it
        pupils: list[PupilFit | None] = [None] * len(field_tan)
        if diffraction:
            pupils[:] = pupils_of_fields(lens, field_tan, build=build)
        images = []
        for field, pupil in zip(field_tan, pupils, strict=True):
            samples = 0.0 if pupil is None else _samples(lens, pupil)
            wave_mm = 1e-6 * lens.wavelength_nm
            low = pupil is not None and wave_mm * max(band_lpmm) < _LOW * 2.0 * pupil.span
            if pupil is None or samples > (_FEW_SAMPLES if low else _MOST_SAMPLES):
                spot = spots(lens, field, build=build, rings=_RAY_RINGS)
                along = partial(otf_of_rays, lens, field, build=build) if low else None
                images.append(_image_of_rays(spot, step_mm, band_lpmm, along))
            else:
                count = _counts(np.full(2, _reach_mm(lens, pupil)), step_mm)
                otf = _wave_otf(pupil, wave_mm, count, step_mm)
                images.append(_image(otf, count, band_lpmm * step_mm))
    return images


def _reach_mm(lens: Lens, pupil: PupilFit) -> float:
    """Return how far the light of a point goes, but for what is diffracted farthest."""
    return pupil.reach_mm + _TAIL * 1e-6 * lens.wavelength_nm / (2.0 * pupil.span)


def _samples(lens: Lens, pupil: PupilFit) -> float:
    """Return how many samples across the pupil keep copies of the image apart."""
    return 4.0 * pupil.span * _reach_mm(lens, pupil) / (1e-6 * lens.wavelength_nm)


def _image_of_rays(
    spot: Spots, step_mm: Floats, band_lpmm: Floats, diffracted: Callable[[Floats], Otf] | None
) -> LatticeImage:
    """Return the image of a spot, of a very wide one each ray as it lands.

    With its OTF at frequencies [n 2] if that is given, else without diffraction.
    """
    count = _counts(np.abs(spot.ray_mm).max(axis=0), step_mm)
    landing = spot.ray_mm / step_mm
    place = np.rint(landing).astype(np.int64)
    if max(count) > _MOST_POINTS:
        arrives = spot.weight > 0.0
        return LatticeImage(place[arrives], spot.weight[arrives])
    light = np.zeros(count)
    np.add.at(light, tuple(place.T), spot.weight)  # where the fit begins
    otf, wanted = np.fft.rfft2(light), _wanted(count, band_lpmm * step_mm)
    wanted[0, 0] = False  # there it is 1
    if wanted.any():
        at = zip(_cycles(count), np.nonzero(wanted), strict=True)
        cycles = np.stack([of_axis[number] for of_axis, number in at], axis=-1)
        if diffracted is None:
            otf[wanted] = np.exp(-2j * np.pi * cycles @ landing.T) @ spot.weight
        else:
            otf[wanted] = diffracted(cycles / step_mm)
    return _image(otf, count, band_lpmm * step_mm)


def _image(otf: Otf, count: tuple[int, int], band: Floats) -> LatticeImage:
    """Return the image with an OTF within a band, in cycles per step, from that on a lattice.

    On every other point where that does, because the light is spread anyway.
    """
    wanted = _wanted(count, band)
    stride, missing = 2, np.inf
    if max(count) > _FEW_POINTS:
        light, missing = _fitted(_halved(otf), _halved(wanted), _FEW_STEPS)
    if missing > _ENOUGH:
        stride = 1
        light, _ = _fitted(otf, wanted, _STEPS)
    place, weight = _drawn_together(np.fft.fftshift(light))
    return LatticeImage(stride * place, weight)


def _wanted(count: tuple[int, int], band: Floats) -> Mask:
    """Return which frequencies of `rfft2` lie within a band, in cycles per step."""
    cycles = zip(_cycles(count), band, strict=True)
    row, col = (np.abs(cycle) <= highest for cycle, highest in cycles)
    return np.asarray(row[:, None] & col)


def _halved(spectrum: NDArray[Any]) -> NDArray[Any]:
    """Return the frequencies of `rfft2` that a lattice of half as many points along an axis has."""
    quarter, half = len(spectrum) // 4, spectrum.shape[1] // 2
    return np.concatenate([spectrum[:quarter], spectrum[-quarter:]])[:, : half + 1]


def _counts(reach_mm: Floats, step_mm: Floats) -> tuple[int, int]:
    """Return the points along each axis of a lattice that holds an image, multiples of 4."""
    from scipy.fft import next_fast_len

    half = np.ceil(0.5 * reach_mm / step_mm).astype(int).tolist()
    return (4 * next_fast_len(half[0] + 1, real=True), 4 * next_fast_len(half[1] + 1, real=True))


def _cycles(count: tuple[int, int]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return the frequencies, in cycles per step, of `rfft2`."""
    return np.fft.fftfreq(count[0]), np.fft.rfftfreq(count[1])


def _wave_otf(pupil: PupilFit, wave_mm: float, count: tuple[int, int], step_mm: Floats) -> Otf:
    """Return the OTF [row col] at the frequencies of the lattice: of the pupil with itself."""
    from scipy.fft import fft2, ifft2, next_fast_len

    apart = wave_mm / (np.array(count) * step_mm * pupil.span)  # of pupils a frequency apart
    finer = np.ceil(0.5 * _LEAST_SAMPLES * apart).astype(int)
    row, col = (
        each * np.arange(-half, half + 1)
        for each, half in zip(apart / finer, np.ceil(finer / apart).astype(int), strict=True)
    )
    step = float(np.sqrt(np.prod(apart / finer)))
    wave, energy = pupil.waves_at(row, col, step, 2.0 * np.pi / wave_mm)
    shifts = [
        np.rint(cycles * n).astype(int) * fine
        for cycles, n, fine in zip(_cycles(count), count, finer, strict=True)
    ]
    farthest = (int(np.abs(shift).max()) for shift in shifts)
    size = [next_fast_len(n + far) for n, far in zip(wave.shape, farthest, strict=True)]
    otf = ifft2(np.abs(fft2(wave, size)) ** 2)[np.ix_(*shifts)] / energy
    otf[0, 0] = 1.0  # what the soft edge of the pupil lacks is far away
    return np.asarray(otf)


def _fitted(otf: Otf, wanted: Mask, steps: int) -> tuple[Floats, float]:
    """Return light [row col] on a lattice, nowhere negative, with the OTF where it is wanted.

    And what is missing of that at most: its squares are minimised by projected gradients.

    Source: Beck, Teboulle, SIAM J. Imaging Sci. 2 (2009) 183.
    """
    from scipy.fft import irfft2

    count = (len(otf), 2 * (otf.shape[1] - 1))
    into, back = _within(wanted, count)
    wanted_otf = otf[np.ix_(wanted.any(axis=1), wanted.any(axis=0))]
    light = np.maximum(irfft2(otf, count), 0.0)
    ahead, pace = light, 1.0
    for _ in range(steps):
        missing = wanted_otf - into(ahead)
        if np.abs(missing).max() < _CLOSE:
            break
        before, light = light, np.maximum(ahead + back(missing), 0.0)
        faster = 0.5 * (1.0 + np.sqrt(1.0 + 4.0 * pace * pace))
        ahead = light + (pace - 1.0) / faster * (light - before)
        pace = faster
    return light, float(np.abs(wanted_otf - into(light)).max())


def _within(wanted: Mask, count: tuple[int, int]) -> tuple[Transform, Transform]:
    """Return the transforms from light to the wanted frequencies, and back.

    By products of matrices where the lattice is small: the overhead of FFTs is larger.
    """
    from scipy.fft import irfft2, rfft2

    some = np.ix_(wanted.any(axis=1), wanted.any(axis=0))
    if max(count) > _FEW_POINTS:

        def spread(part: NDArray[Any]) -> NDArray[Any]:
            whole = np.zeros(wanted.shape, dtype=np.complex128)
            whole[some] = part
            return np.asarray(irfft2(whole, count))

        return lambda light: rfft2(light)[some], spread
    row, col = (
        np.exp(-2j * np.pi * np.outer(cycle[one.ravel()], np.arange(n)))
        for cycle, one, n in zip(_cycles(count), some, count, strict=True)
    )
    across = np.ascontiguousarray(col.T)
    down = row.conj().T / (count[0] * count[1])
    half = col.conj()
    half[1:] *= 2.0  # the other half of the frequencies
    return lambda light: row @ light @ across, lambda part: (down @ part @ half).real


def _drawn_together(light: Floats) -> tuple[NDArray[np.int64], Floats]:
    """Return the places [point 2] and weights of points that have light, weak ones drawn together.

    Along a curve that fills the plane: of each grain of their light that where half is reached.
    """
    light = light / light.sum()
    strong = np.argwhere(light >= _GRAIN)
    weak = np.argwhere((light > 0.0) & (light < _GRAIN))
    weak = weak[np.argsort(_morton(weak))]
    summed = np.cumsum(light[tuple(weak.T)])
    weight = light[tuple(strong.T)]
    if len(weak) and (grains := round(summed[-1] / _GRAIN)):
        grain = summed[-1] / grains
        chosen = np.searchsorted(summed, (np.arange(grains) + 0.5) * grain)
        strong = np.concatenate([strong, weak[chosen]])
        weight = np.concatenate([weight, np.full(grains, grain)])
    return strong - np.array(light.shape) // 2, weight / weight.sum()


def _morton(place: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the numbers of places [point 2] whose bits are those of row and col by turns."""
    number = np.zeros(len(place), dtype=np.int64)
    for bit in range(16):
        for axis in (0, 1):
            number |= ((place[:, axis] >> bit) & 1) << (2 * bit + 1 - axis)
    return number
