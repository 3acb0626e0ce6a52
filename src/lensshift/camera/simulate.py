"""A time-of-flight camera takes a burst of a scene; the order of the effects."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lensshift.camera.channels import Seen, Tones
from lensshift.camera.demodulate import unambiguous_distance_m
from lensshift.camera.flat import QUARTER_SQUARE_PX, checked_plan
from lensshift.camera.footprints import Footprints, see
from lensshift.camera.output import Image, O3mImages, image_of
from lensshift.camera.radiometry import active_electrons_per_s, ambient_electrons_per_s
from lensshift.camera.readout import Rates, Reading, harmonic_shares, read
from lensshift.camera.settings import LensOptics, TofCamera
from lensshift.camera.view import intrinsics_of, motions, response_width_px
from lensshift.core.arrays import Array, Floats, Mask
from lensshift.core.errors import DataError, warn_quality
from lensshift.core.motion import ShiftField
from lensshift.core.stray_light import StrayLight
from lensshift.core.types import Burst
from lensshift.core.units import doubt_about_units, unambiguous_range_m
from lensshift.scene import Scene

_SAMPLES_PER_HR_PX = 8  # along an axis
_FEWEST_SAMPLES = 16  # of an LR pixel
_MEASURED = 1  # names the errors of what was measured of a camera, apart from those of its frames


@dataclass(frozen=True, slots=True, eq=False)
class TofTruth:
    """What an experimenter never gets to know.

    Images are on the HR grid [row col]: what pixels of 1/scale pitch, sensitive all over, see
    through the same lens at rest, without noise, scattered or indirect light, and errors. The sharp
    ones are those of a lens that images the same place onto each pixel and as bright, but every
    point as a point.

    Parameters
    ----------
    amplitude : in the unit of the burst
    distance_m : radial, from the mean phasor of the first modulation frequency
    sharp_amplitude, sharp_distance_m : the same without blur
    valid : whether anything is there
    flying : whether a pixel mixes surfaces, see `Validity`
    flying_in_frames : [frame row col] the same for the LR pixels of the frames
    offset_px : [frame 2] where the image content really was, at the centre of the sensor
    offset_field : the same for every pixel, if the shift varies over the sensor, or None
    """

    amplitude: Floats
    distance_m: Floats
    sharp_amplitude: Floats
    sharp_distance_m: Floats
    valid: Mask
    flying: Mask
    flying_in_frames: Mask
    offset_px: Floats
    offset_field: ShiftField | None


@dataclass(frozen=True, slots=True, eq=False)
class RawPhases(Reading):
    """The four phase images behind a burst.

    Parameters
    ----------
    difference : [frame frequency phase row col] tap A - tap B in counts: whole numbers, or
        electrons if there is no converter
    electrons_per_count : [frame row col]
    exposure, gain : [frame row col] which of those of `Readout` a pixel used
    saturated : [frame row col]
    modulation_hz : [frequency]
    """

    modulation_hz: tuple[float, ...]


@dataclass(frozen=True, slots=True, eq=False)
class TofCapture:
    """Everything about one simulated burst.

    Parameters
    ----------
    burst : what reconstruction gets
    truth : what it is compared with
    raw : the phase images
    o3m : what an O3M sends, if the camera is one, or None
    """

    burst: Burst
    truth: TofTruth
    raw: RawPhases
    o3m: O3mImages | None


def simulate_tof_burst(
    scene: Scene,
    camera: TofCamera,
    planned_px: ArrayLike = QUARTER_SQUARE_PX,
    *,
    scale: int = 2,
    shift_error_px: float = 0.02,
    samples_per_px: int | None = None,
    seed: int = 0,
) -> tuple[Burst, TofTruth]:
    """Take a burst with a time-of-flight camera; see `simulate_tof`, which returns more."""
    capture = simulate_tof(
        scene, camera, planned_px, scale=scale, shift_error_px=shift_error_px,
        samples_per_px=samples_per_px, seed=seed,
    )  # fmt: skip
    return capture.burst, capture.truth


def simulate_tof(
    scene: Scene,
    camera: TofCamera,
    planned_px: ArrayLike = QUARTER_SQUARE_PX,
    *,
    scale: int = 2,
    shift_error_px: float = 0.02,
    samples_per_px: int | None = None,
    seed: int = 0,
    on_progress: Callable[[int, int], None] | None = None,
) -> TofCapture:
    """Take a burst with a time-of-flight camera whose lens does not go exactly where it was sent.

        P(u) = mean over pixel u of [ (rho cos / d^2) exp(4 pi i f d / c) ] * PSF, scattered
        D_k = A_k - B_k,  k = 0 .. 3: counted, suppressed, filled, read, converted
        offset = planned + e,  e ~ normal(0, shift error) along each axis

    The order: light and phase of the surfaces, indirect light; lens, moved; mean over the
    aperture; scattered light; drift; taps with harmonics, sunlight and dark current; shot noise,
    background suppression, full well, read noise, converter; amplitude, phase, unwrapping,
    validity, output. The burst holds the planned offsets, the width of the pixel response and the
    stray light, as measured.

    Parameters
    ----------
    scene : in the world, the camera at its origin
    planned_px : [frame 2] (row, col) at the centre; positive: the content moves down / right
    scale : the truth has pixels of 1/scale of the pitch
    shift_error_px : rms error of the shift along each axis
    samples_per_px : rays across an LR pixel; by default 8 across an HR pixel, at least 16
    on_progress : is told how many parts of the image of how many are seen

    Raises
    ------
    ValueError
        If `planned_px` is not [frame 2], a number is out of range, or a traced lens cannot make
        a shift.
    DataError
        If no pixel is valid: with the reason.

    Warns
    -----
    QualityWarning
        If valid pixels see farther than the modulation frequencies reach.
    """
    planned = checked_plan(planned_px, scale, camera.grid)
    samples = _samples(scale, samples_per_px)
    if not (np.isfinite(shift_error_px) and shift_error_px >= 0):
        raise ValueError(f"expected shift_error_px of at least 0, got {shift_error_px}")
    rng = np.random.default_rng(seed)
    offset = planned + shift_error_px * rng.standard_normal(planned.shape)
    side_px = camera.pixels.fill_factor**0.5
    looks = [
        Footprints(1, moved_px, side_px, blur)
        for moved_px, blur in motions(camera, offset, side_px)
    ]
    rest_px = np.zeros((1, 2))
    ((_, rest_blur),) = motions(camera, rest_px, min(side_px, 1.0 / scale), scale=scale)
    looks += [Footprints(scale, rest_px[None], 1.0 / scale, blur) for blur in (rest_blur, 0.0)]
    tones = Tones(camera.illumination.modulation_hz, tuple(harmonic_shares(camera.pixels)))
    *frames, ideal, sharp = see(scene, camera, tones, looks, samples, on_progress)
    if camera.multipath is not None:
        ideal, sharp = see(scene, replace(camera, multipath=None), tones, looks[-2:], samples)
    readings = [
        read(rates_of(seen, camera, number), camera.pixels, camera.readout, rng)
        for number, seen in enumerate(frames)
    ]
    images = [image_of(reading, camera) for reading in readings]
    if not any(image.valid.any() for image in images):
        raise DataError(_why_nothing(frames, readings, camera))
    notes = {"origin": "simulated", "seed": int(seed), "samples_per_px": samples}
    # What `calibrate` would tell of a real camera.
    notes["psf_sigma_px"] = response_width_px(side_px, rest_blur, camera.grid.shape)
    notes |= told_stray_light(camera, seed)
    field = None
    if isinstance(camera.optics, LensOptics) and camera.optics.element is not None:
        field = ShiftField(np.stack([one.offset_px for one in looks[:-2]]))
    truth = TofTruth(
        *true_images(ideal, camera),
        *true_images(sharp, camera),
        valid=ideal.light > 0,
        flying=_flying(ideal, camera),
        flying_in_frames=np.stack([_flying(seen, camera) for seen in frames]),
        offset_px=offset,
        offset_field=field,
    )
    _tell_what_comes_back(truth, images, camera)
    return TofCapture(
        burst=_burst(images, camera, planned, shift_error_px, notes),
        truth=truth,
        raw=RawPhases(**_stacked(readings), modulation_hz=camera.illumination.modulation_hz),
        o3m=_o3m(images),
    )


def _tell_what_comes_back(truth: TofTruth, images: list[Image], camera: TofCamera) -> None:
    """Warn of distances that phases cannot tell from shorter ones."""
    hz, scale = camera.illumination.modulation_hz, len(truth.valid) // camera.grid.shape[0]
    used = np.kron(np.any([image.valid for image in images], axis=0), np.ones((scale, scale)))
    distance_m = truth.sharp_distance_m[(used > 0) & (truth.sharp_amplitude > 0)]
    reach_m = unambiguous_distance_m(hz)
    beyond = distance_m >= reach_m
    if beyond.any():
        far_m, mhz = float(np.median(distance_m[beyond])), ", ".join(f"{one / 1e6:g}" for one in hz)
        warn_quality(
            f"{100 * beyond.mean():.3g} % of the valid pixels see beyond {reach_m:.4g} m, where "
            f"distances begin again at 0 with {mhz} MHz: {far_m:.4g} m is told as "
            f"{far_m % reach_m:.4g}. Lower modulation_hz, or several, reach farther",
            stacklevel=3,
        )


def _why_nothing(frames: list[Seen], readings: list[Reading], camera: TofCamera) -> str:
    """Say why no pixel is valid."""
    seen = np.stack([one.light > 0 for one in frames])
    if not seen.any():
        return "expected something in view of the camera that scatters light, but it sees nothing"
    typical_m = float(np.median(np.stack([one.distances()[0] for one in frames])[seen]))
    if doubt := doubt_about_units(min(camera.illumination.modulation_hz), typical_m):
        return doubt
    full = float(np.stack([one.saturated for one in readings])[seen].mean())
    return (
        f"expected pixels to use, but of those that see light {100 * full:.0f} % are full "
        f"in the shortest exposure and {100 * (1 - full):.0f} % have too little light; change "
        "exposure_s or intensity_w_per_sr"
    )


def _samples(scale: int, samples_per_px: int | None) -> int:
    usual = max(_FEWEST_SAMPLES, _SAMPLES_PER_HR_PX * int(scale))
    samples = usual if samples_per_px is None else samples_per_px
    if samples != int(samples) or samples < 1:
        raise ValueError(f"expected an integer samples_per_px from 1, got {samples}")
    return int(samples)


def rates_of(seen: Seen, camera: TofCamera, frame: int) -> Rates:
    """Return electrons per second of one frame: scattered light, drift, sunlight, dark current."""
    if camera.scatter is not None:
        from scipy.ndimage import gaussian_filter

        sigma_px, share = camera.scatter.sigma_px, camera.scatter.scattered  # the sum stays
        spread = gaussian_filter(seen.values, sigma_px, axes=(0, 1), mode="reflect")
        seen = Seen((1.0 - share) * seen.values + share * spread, seen.tones)
    active = active_electrons_per_s(camera)
    phasor = active * seen.phasor
    if camera.drift is not None:
        rise_k = camera.drift.temperature_rise_k + frame * camera.drift.warming_k_per_frame
        delay = seen.tones.phases(np.array(1e-3 * camera.drift.mm_per_k * rise_k))
        phasor = phasor * np.exp(1j * delay).reshape(*phasor.shape[:2], 1, 1)
    constant = ambient_electrons_per_s(camera) * seen.reflectance
    return Rates(active * seen.light, constant + camera.pixels.dark_electrons_per_s, phasor)


def told_stray_light(camera: TofCamera, seed: int) -> dict[str, Any]:
    """Return what a burst says of the stray light of its camera, measured once, with an error."""
    if camera.scatter is None or not camera.scatter.scattered:
        return {}
    share, error = camera.scatter.scattered, camera.scatter.told_error
    rng = np.random.default_rng((seed, _MEASURED))
    measured = float(np.clip(share * (1.0 + error * rng.standard_normal()), 0.0, 0.5))
    told = StrayLight(measured, camera.scatter.sigma_px, min(error * share, 0.5))
    return {"stray_light": told.table}


def _flying(seen: Seen, camera: TofCamera) -> Mask:
    return np.asarray(seen.distances()[1] > camera.validity.flying_std_m)


def true_images(ideal: Seen, camera: TofCamera) -> tuple[Array, Array]:
    """Return amplitude and distance as `TofTruth` has them."""
    phasor = ideal.phasor[0, 0]
    full = camera.readout.exposure_s[-1] * active_electrons_per_s(camera) * camera.pixels.contrast
    amplitude = np.abs(phasor) * full / camera.readout.full_well_electrons
    range_m = unambiguous_range_m(camera.illumination.modulation_hz[0])
    mean_m = ideal.distances()[0]  # of all that are c / 2f apart the nearest to it
    turned_rad = np.angle(phasor * np.exp(-2j * np.pi * mean_m / range_m))
    return amplitude, np.asarray(mean_m + turned_rad * range_m / (2.0 * np.pi))


def _burst(
    images: list[Image],
    camera: TofCamera,
    planned_px: Floats,
    shift_error_px: float,
    notes: dict[str, Any],
) -> Burst:
    sent = [image.phasors for image in images if image.phasors is not None]
    return Burst(
        amplitude=np.stack([image.amplitude for image in images]),
        distance_m=np.stack([image.distance_m for image in images]),
        valid=np.stack([image.valid for image in images]), offset_px=planned_px,
        offset_sigma_px=np.full(planned_px.shape, float(shift_error_px)), grid=camera.grid,
        modulation_hz=camera.illumination.modulation_hz,
        phasors=np.stack(sent, axis=1) if sent and len(sent[0]) > 1 else None,
        intrinsics=intrinsics_of(camera), meta={**notes, **camera.settings()},
    )  # fmt: skip


def _o3m(images: list[Image]) -> O3mImages | None:
    sent = [image.o3m for image in images if image.o3m is not None]
    if not sent:
        return None
    factors = sent[0].amplitude_normalization
    return O3mImages(**_stacked(sent) | {"amplitude_normalization": factors})


def _stacked(frames: Sequence[Any]) -> dict[str, Array]:
    """Return the fields of frames, each [frame ...]."""
    names = [one.name for one in fields(frames[0])]
    return {name: np.stack([getattr(one, name) for one in frames]) for name in names}
