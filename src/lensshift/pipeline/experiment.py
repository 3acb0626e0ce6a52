"""One simulated experiment: a scene, a camera, a burst, its reconstruction, the comparison."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Literal, get_args

import numpy as np

from lensshift.camera import (
    LensOptics,
    Sensor,
    TofCamera,
    TofCapture,
    TofTruth,
    Truth,
    camera_preset,
    simulate_burst,
)
from lensshift.camera import simulate_tof as take
from lensshift.camera.demodulate import unambiguous_distance_m
from lensshift.camera.flat import checked_plan
from lensshift.core.arrays import Array, Floats
from lensshift.core.grid import Grid
from lensshift.core.types import Burst, Reconstruction, ShiftField
from lensshift.evaluation import depth_error, fidelity
from lensshift.forward.model import MAX_SCALE
from lensshift.optics.lens import Lens
from lensshift.reconstruction.methods import make_method
from lensshift.reconstruction.phasor.choice import Channel
from lensshift.reconstruction.reconstruct import reconstruct
from lensshift.scene import Scene, demo_target

YARDSTICKS = ("nearest", "bicubic")
Shifts = Literal["planned", "true", "traced"]
DEMO_GRID = camera_preset("o3m151").grid  # 16 x 64 pixels
MOST_SHIFT_ERROR_PX = 5.0  # beyond that a plan of shifts says nothing


@dataclass(frozen=True, slots=True, eq=False)
class Experiment:
    """What is simulated, and how it is reconstructed.

    Parameters
    ----------
    scene, camera : the world
    pattern_px : [frame 2] where the image is sent
    shift_error_px : rms error of the shift along each axis, which the reconstruction cannot know
    seed : of noise and errors
    scale : upscaling factor
    method, channel : of the reconstruction
    shifts : what the reconstruction is told: the planned ones; the true ones of the middle of
        the sensor; or, for a traced lens, the planned ones with their field over the sensor
    psf_sigma_px : pixel response that the reconstruction assumes, in LR pixels; None: that of the
        camera
    name : for titles
    options : of the method
    """

    scene: Scene
    camera: TofCamera
    pattern_px: Floats
    shift_error_px: float = 0.02
    seed: int = 0
    scale: int = 2
    method: str = "auto"
    channel: Channel = "auto"
    shifts: Shifts = "planned"
    psf_sigma_px: float | None = None
    name: str = ""
    options: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        make_method(self.method, self.options)
        for name, kind in (("channel", Channel), ("shifts", Shifts)):
            if getattr(self, name) not in get_args(kind):
                expected = f"expected {name} of {', '.join(get_args(kind))}"
                raise ValueError(f"{expected}, got {getattr(self, name)!r}")
        if self.shifts == "traced":
            _moving_lens(self.camera)
        checked_plan(self.pattern_px, self.scale, self.camera.grid)
        if not 0.0 <= self.shift_error_px <= MOST_SHIFT_ERROR_PX:
            raise ValueError(
                f"expected shift_error_px from 0 to {MOST_SHIFT_ERROR_PX:g} LR pixels, "
                f"got {self.shift_error_px!r}"
            )
        width_px, scale = self.psf_sigma_px, self.scale
        known = isinstance(width_px, (int, float))
        if width_px is not None and not (known and 0.0 <= width_px < np.inf):
            raise ValueError(f"expected psf_sigma_px of at least 0, got {width_px!r}")
        if scale not in range(1, MAX_SCALE + 1):
            raise ValueError(f"expected an integer scale from 1 to {MAX_SCALE}, got {scale!r}")


def _moving_lens(camera: TofCamera) -> tuple[Lens, int]:
    optics = camera.optics
    if not isinstance(optics, LensOptics) or optics.element is None:
        raise ValueError("expected a camera whose lens is traced and moves for traced shifts")
    return optics.lens, optics.element


@dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """What an experiment gave.

    Parameters
    ----------
    capture : burst, truth and raw data
    reconstruction : by the method asked for
    images : name -> channel -> [row col] on the HR grid: the yardsticks and the method; distances
        that come back at the end of the range are told in the turn of the truth
    fidelity : name -> psnr_db, ssim, rmse of the amplitude, 4 HR px of border left out
    depth : name -> errors of the distance against the truth, in metres
    seconds : of the reconstruction asked for
    """

    capture: TofCapture
    reconstruction: Reconstruction
    images: dict[str, dict[str, Array]]
    fidelity: dict[str, dict[str, float]]
    depth: dict[str, dict[str, float]]
    seconds: float


def carry_out(
    experiment: Experiment, *, on_iteration: Callable[[int, float], None] | None = None
) -> Outcome:
    """Simulate the burst, reconstruct it, and compare with the truth.

    Parameters
    ----------
    on_iteration : called with the number of an iteration (from 1) and the objective

    Raises
    ------
    ValueError
        If there is no such method, or settings do not fit each other.
    DataError
        If no pixel of the burst is valid.
    """
    capture = simulate(experiment)
    burst, field = told(experiment, capture)
    start_s = time.perf_counter()
    result = reconstruct(
        burst,
        experiment.scale,
        experiment.method,
        channel=experiment.channel,
        psf_sigma_px=experiment.psf_sigma_px,
        shift_field=field,
        seed=experiment.seed,
        on_iteration=on_iteration,
        **experiment.options,
    )
    seconds = time.perf_counter() - start_s
    scale, truth = experiment.scale, capture.truth
    images = {name: images_of(reconstruct(burst, scale, name, std=False)) for name in YARDSTICKS}
    images[experiment.method] = images_of(result)
    turn_m = unambiguous_distance_m(experiment.camera.illumination.modulation_hz)
    like, depth = {}, {}
    for name, image in images.items():
        if "amplitude" in image:
            like[name] = asdict(fidelity(image["amplitude"], truth.amplitude))
        if "distance" in image:
            turns = np.rint((truth.distance_m - image["distance"]) / turn_m)
            image["distance"] = image["distance"] + turn_m * np.where(truth.valid, turns, 0.0)
            depth[name] = depth_numbers(image["distance"], truth, scale)
    return Outcome(capture, result, images, like, depth, seconds)


def simulate(experiment: Experiment) -> TofCapture:
    """Take the burst of an experiment."""
    return take(
        experiment.scene,
        experiment.camera,
        experiment.pattern_px,
        scale=experiment.scale,
        shift_error_px=experiment.shift_error_px,
        seed=experiment.seed,
    )


def told(experiment: Experiment, capture: TofCapture) -> tuple[Burst, ShiftField | None]:
    """Return the burst with the shifts that the reconstruction is told, and their field."""
    burst = capture.burst
    if experiment.shifts == "true":
        return replace(burst, offset_px=capture.truth.offset_px), None
    if experiment.shifts == "planned":
        return burst, None
    return burst, traced_field(experiment.camera, burst)


def traced_field(camera: TofCamera, burst: Burst) -> ShiftField:
    """Return the offsets of all pixels by the traced lens of a camera; ValueError without one."""
    from lensshift.optics.shift import decenter_for_shift, shift_map

    lens, element = _moving_lens(camera)
    decenter_mm = decenter_for_shift(lens, element, burst.offset_px, burst.grid)
    return shift_map(lens, element, decenter_mm, burst.grid)


def images_of(result: Reconstruction) -> dict[str, Array]:
    """Return the images of a reconstruction by channel."""
    return {name: estimate.image for name, estimate in result.channels.items()}


def depth_numbers(distance_m: Array, truth: TofTruth, scale: int) -> dict[str, float]:
    """Return the errors of a distance image against the truth."""
    found = asdict(depth_error(distance_m, truth.distance_m, truth_valid=truth.valid, scale=scale))
    return {name: float(value) for name, value in found.items()}


def demo_burst(grid: Grid = DEMO_GRID, *, scale: int = 2, seed: int = 0) -> tuple[Burst, Truth]:
    """Return a simulated burst of the demo target, and what nobody knows on a bench."""
    rows_mm, cols_mm = (n * pitch for n, pitch in zip(grid.shape, grid.pitch_mm, strict=True))
    return simulate_burst(demo_target((rows_mm, cols_mm)), Sensor(grid), scale=scale, seed=seed)
