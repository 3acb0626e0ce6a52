"""How often the standard errors of a calibrated rig cover the truth.

    python benchmarks/calibration.py --seeds 50

Each seed is another rig before another scene: a map turned by up to 3 degrees, 10 % off in scale
and different at the ends of the sensor, play of up to 10 um, stages whose encoders read 0.5 um
wrong, drift, and random turned cards at several distances behind the sharp optics and half-filled
pixels of the O3M151 preset. The scan is the one of `lensshift calibrate`, four readings averaged
at each place. Printed for map, play and drift: rms error, median told standard error, share of
errors within 1.96 of the told ones; and what a calibrated offset of a quarter pixel is off by,
anywhere on the sensor. About ten seconds a seed.
"""

import argparse
import warnings
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lensshift import Burst, QualityWarning
from lensshift.capture.emulators.rig import EmulatedWorld, RigSettings
from lensshift.registration import calibration_scan_mm
from lensshift.registration.calibrate import fit_scan
from lensshift.scene import Plane, Rectangle, Scene

Array = NDArray[np.float64]

PX_PER_MM = 0.25 / 0.0444  # of the first lens: a quarter of a pixel of 0.155 mm takes 44.4 um
SPAN_MM, STEPS, READINGS = 0.3, 4, 4
ENCODER_MM, STEP_S = 0.0005, 0.4


def random_scene(rng: np.random.Generator) -> Scene:
    """Return cards before a wall; the sensor sees 0.8 m by 0.2 m at 3.5 m."""
    cards = []
    for _ in range(12):
        distance_m = rng.uniform(2.5, 4.5)
        cards.append(
            Rectangle(
                centre_m=(
                    float(rng.uniform(-0.12, 0.12) * distance_m),
                    float(rng.uniform(-0.03, 0.03) * distance_m),
                    float(distance_m),
                ),
                size_m=tuple(float(size) for size in rng.uniform(0.05, 0.3, 2)),
                turn_rad=(0.0, float(rng.uniform(-0.5, 0.5)), float(rng.uniform(-np.pi, np.pi))),
                reflectance=float(rng.uniform(0.1, 0.9)),
            )
        )
    return Scene((Plane(centre_m=(0.0, 0.0, 5.0), reflectance=0.3), *cards))


def random_rig(seed: int) -> tuple[RigSettings, Array]:
    """Return a rig and its drift in px per s."""
    rng = np.random.default_rng(seed)
    turn = np.deg2rad(rng.uniform(-3.0, 3.0))
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    settings = RigSettings(
        scene=random_scene(rng),
        px_per_mm=rotation @ np.diag(PX_PER_MM * rng.uniform(0.9, 1.1, 2)),
        field_share=float(rng.uniform(-0.02, 0.02)),
        play_mm=float(rng.uniform(0.0, 0.01)),
        seed=seed,
    )
    return settings, rng.uniform(-5e-4, 5e-4, 2)


def scan(settings: RigSettings, drift_px_per_s: Array) -> tuple[Burst, Array]:
    """Return the scan of a rig, and its true map at every pixel [row col 2 2]."""
    rng = np.random.default_rng(settings.seed + 1_000_000)
    world = EmulatedWorld(settings, None)
    asked = calibration_scan_mm(settings.rest_mm, SPAN_MM, steps=STEPS)
    lens, time_s = asked[0].copy(), STEP_S * np.arange(len(asked))
    images = []
    for place, time in zip(asked, time_s, strict=True):
        half = 0.5 * settings.play_mm
        lens = np.clip(lens, place - half, place + half)  # friction holds it within the play
        offset_px = world.offset_px(lens) + drift_px_per_s * time
        taken = [world.running.frame(offset_px[None], world._rng) for _ in range(READINGS)]
        images.append(np.mean([image.amplitude for image in taken], axis=0))
    nominal_px = (asked - settings.rest_mm) * PX_PER_MM
    read_mm = asked + ENCODER_MM * rng.standard_normal(asked.shape)
    burst = Burst.from_arrays(
        np.array(images),
        offset_px=nominal_px,
        pitch_mm=0.155,
        stage_mm=read_mm,
        stage_commanded_mm=asked,
        time_s=time_s,
    )
    return burst, world._share[..., None] * settings.px_per_mm


def main() -> None:
    """Print everything."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=50, help="rigs")
    parser.add_argument("--first", type=int, default=0, help="first seed")
    asked = parser.parse_args()
    warnings.simplefilter("ignore", QualityWarning)
    rows: dict[str, list[Any]] = {"map, px per mm": [], "play, um": [], "drift, px per min": []}
    quarters_px = []
    for seed in range(asked.first, asked.first + asked.seeds):
        settings, drift = random_rig(seed)
        burst, true = scan(settings, drift)
        found = fit_scan(burst, rest_mm=settings.rest_mm).calibration
        middle = true.mean(axis=(0, 1))
        per_mm = found.stage_map
        told = per_mm.field_px_per_mm
        everywhere = per_mm.px_per_mm if told is None else told
        quarters_px.append(np.ravel((everywhere - true) * 0.25 / PX_PER_MM))
        for name, error, sigma, unit in (
            ("map, px per mm", per_mm.px_per_mm - middle, found.px_per_mm_sigma, 1.0),
            ("play, um", found.play_mm - settings.play_mm, found.play_sigma_mm, 1e3),
            ("drift, px per min", found.drift_px_per_s - drift, found.drift_sigma_px_per_s, 60.0),
        ):
            rows[name].append(np.stack([np.ravel(error), np.ravel(sigma)]) * unit)
    for name, parts in rows.items():
        error, sigma = np.concatenate(parts, axis=1)
        cover = 100 * np.mean(np.abs(error) < 1.96 * sigma)
        rms = np.sqrt(np.mean(error**2))
        print(
            f"{name:18} {rms:.4f} rms, told {np.median(sigma):.4f} (median), covers {cover:.0f} %"
        )
    quarter = np.concatenate(quarters_px)
    print(f"a quarter pixel    {np.sqrt(np.mean(quarter**2)):.4f} px rms anywhere on the sensor")


if __name__ == "__main__":
    main()
