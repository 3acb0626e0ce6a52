"""Frames one at a time: how long a step takes, beside the whole burst computed anew.

python benchmarks/bench_stream.py
python benchmarks/bench_stream.py --shape 16x64 --rounds 6 --cores 2

Four boxes before a simulated O3M whose lens goes round the quarter-pixel square, with its own
noise in every frame and shifts that are wrong by as much as an actuator's. At `live` pace the lens
rests on what it found, at `refined` everything is computed anew. Each pair of lines is of one
process, in turn; errors are against the scene, of the last round.
"""

from __future__ import annotations

import argparse
import os
import statistics
import sys
import time
import warnings
from dataclasses import replace
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from lensshift import Burst
    from lensshift.camera import TofTruth

QUARTER = ((-0.25, -0.25), (-0.25, 0.25), (0.25, 0.25), (0.25, -0.25))
SHAPES = ("16x64", "240x320", "480x640")


def main() -> None:
    """Print a line for each shape and channel."""
    ask = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    ask.add_argument("--shape", nargs="+", default=list(SHAPES), help="ROWSxCOLS")
    ask.add_argument("--rounds", type=int, default=4, help="of the lens, the first not counted")
    ask.add_argument("--cores", type=int, default=2, help="that a step may use")
    ask.add_argument("--seed", type=int, default=0)
    given = ask.parse_args()
    for library in ("OMP", "OPENBLAS", "NUMBA"):  # they read it when they are imported
        os.environ[f"{library}_NUM_THREADS"] = str(given.cores)
    warnings.simplefilter("ignore")
    sys.stdout.write(
        f"{'pixels':>8s} {'channel':10s}{'live ms':>9s}{'worst':>8s}{'refined':>9s}{'burst':>8s}"
        f"{'live/burst':>12s}{'PSNR live dB':>14s}{'refined':>9s}{'mm live':>9s}{'refined':>9s}\n"
    )
    for shape in given.shape:
        rows, cols = (int(side) for side in shape.split("x"))
        for line in measured((rows, cols), given.rounds, given.seed):
            sys.stdout.write(line + "\n")
            sys.stdout.flush()


def measured(shape: tuple[int, int], rounds: int, seed: int) -> list[str]:
    """Return a line for amplitudes and one for phasors."""
    from lensshift.camera import camera_preset, simulate_tof_burst
    from lensshift.core.grid import Grid
    from lensshift.scene import four_boxes

    preset = camera_preset("o3m151")
    width_mm = preset.grid.shape[1] * preset.grid.pitch_mm[1]
    pitch_mm = width_mm / max(shape[1], 2 * shape[0])  # the boxes stay in sight
    grid = Grid(shape, (pitch_mm, pitch_mm))
    # Smaller pixels under more light: as many electrons in each.
    power = preset.illumination.intensity_w_per_sr * (preset.grid.pitch_mm[1] / pitch_mm) ** 2
    light = replace(preset.illumination, intensity_w_per_sr=power)
    camera = replace(preset, output="float", grid=grid, illumination=light)
    plan = QUARTER * rounds
    burst, truth = simulate_tof_burst(four_boxes(), camera, plan, seed=seed)
    return [_line(burst, truth, channel) for channel in ("amplitude", "phasor")]


def _line(burst: Burst, truth: TofTruth, channel: str) -> str:
    import lensshift
    from lensshift.core.types import Frame
    from lensshift.evaluation import depth_error, psnr_db

    count = len(QUARTER)
    plan = burst.select(range(count))
    told = {"psf_sigma_px": 0.23, "channel": channel, "std": False}  # as `calibrate` finds it
    streams = {pace: lensshift.stream(plan, pace=pace, **told) for pace in ("live", "refined")}
    taken_ms: dict[str, list[float]] = {name: [] for name in (*streams, "burst")}
    psnr_of, mm_of = ({name: [] for name in streams} for _ in range(2))
    for number in range(burst.frame_count):
        seen = (burst.amplitude[number], burst.distance_m[number], burst.valid[number])
        for pace, one in streams.items():
            start_s = time.perf_counter()
            found = one.step(Frame(*seen, float("nan")))
            taken_ms[pace].append(1e3 * (time.perf_counter() - start_s))
            if number < burst.frame_count - count:
                continue
            psnr_of[pace].append(psnr_db(found.amplitude.image, truth.amplitude))
            if found.distance_m is not None:
                error = depth_error(
                    found.distance_m.image, truth.distance_m, truth_valid=truth.valid, scale=2
                )
                mm_of[pace].append(1e3 * error.rmse_m)
        start_s = time.perf_counter()
        lensshift.reconstruct(streams["live"].window, **told)
        taken_ms["burst"].append(1e3 * (time.perf_counter() - start_s))
    live, refined, whole = (statistics.median(taken_ms[name][count:]) for name in taken_ms)
    rows, cols = burst.grid.shape
    text = f"{cols:>4d}x{rows:<4d}{channel:10s}{live:9.1f}{max(taken_ms['live'][count:]):8.1f}"
    text += f"{refined:9.1f}{whole:8.1f}{live / whole:12.2f}"
    for width, of in ((14, psnr_of), (9, mm_of)):
        for name, wide in zip(streams, (width, 9), strict=True):
            text += f"{statistics.mean(of[name]):{wide}.1f}" if of[name] else ""
    return text


if __name__ == "__main__":
    main()
