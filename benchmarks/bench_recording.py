"""A long recording through `reconstruct --window`: how fast, in how much memory, and the same.

    python benchmarks/bench_recording.py [--minutes 60] [--every 4] [--workers 2] [--folder FOLDER]

Frames of 64 x 16 pixels at 50 Hz of boxes before a wall, from phasors with noise of their own that
follows the light, on a square of shifts that is told wrong by 0.02 px. Printed: how many times real
time the pictures took, the largest memory of the process and of a worker, and whether the file of
the workers is that of one process, of the first minute.
"""

import argparse
import resource
import shutil
import tempfile
import time
import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from lensshift import Burst, QualityWarning, reconstruct_recording, write_recording
from lensshift.core.units import distance_to_phase

RATE_HZ, SHAPE, POINTS, F_HZ = 50, (16, 64), 8, 15e6
SQUARE_PX = np.array([(-0.25, -0.25), (-0.25, 0.25), (0.25, 0.25), (0.25, -0.25)])


def still_phasors(offset_px: np.ndarray) -> np.ndarray:
    """Return the mean phasor of each pixel of boxes before a wall."""
    rows, cols = ((np.arange(n * POINTS) + 0.5) / POINTS - 0.5 for n in SHAPE)
    rows, cols = np.meshgrid(rows - offset_px[0], cols - offset_px[1], indexing="ij")
    light, distance_m = np.full(rows.shape, 0.3), 4.0 + 0.002 * cols
    for number, (row, col, half) in enumerate([(8, 9, 3), (7, 26, 5), (9, 43, 4), (6, 57, 3)]):
        on = (abs(rows - row) < half) & (abs(cols - col + 0.1 * rows) < half)
        light = np.where(on, 0.15 + 0.2 * number, light)
        distance_m = np.where(on, 3.2 + 0.15 * number, distance_m)
    z = light * np.exp(1j * distance_to_phase(distance_m, F_HZ))
    return z.reshape(SHAPE[0], POINTS, SHAPE[1], POINTS).mean(axis=(1, 3))


def parts(frames: int, each: int = 1000) -> Iterator[Burst]:
    """Yield bursts of frames, each with its own noise."""
    wrong = 0.02 * np.random.default_rng(0).standard_normal(SQUARE_PX.shape)
    clean = np.stack([still_phasors(o) for o in SQUARE_PX + wrong])
    sigma = 0.004 * np.sqrt(0.1 + 0.9 * np.abs(clean) / np.median(np.abs(clean)))
    for first in range(0, frames, each):
        rng = np.random.default_rng(first + 1)
        numbers = np.arange(first, min(first + each, frames))
        noise = rng.standard_normal((2, len(numbers), *SHAPE))
        z = clean[numbers % 4] + sigma[numbers % 4] * (noise[0] + 1j * noise[1])
        distance_m = np.mod(np.angle(z), 2 * np.pi) / distance_to_phase(1.0, F_HZ)
        yield Burst.from_arrays(
            np.abs(z).astype(np.float32), distance_m.astype(np.float32), pitch_mm=0.1,
            offset_px=SQUARE_PX[numbers % 4], modulation_hz=F_HZ, time_s=numbers / RATE_HZ,
        )  # fmt: skip


def largest_mb(who: int) -> float:
    """Return the largest memory so far, of this process or of the children that ended."""
    return resource.getrusage(who).ru_maxrss / 1e3


def main() -> None:
    """Print what the module says."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--every", type=int, default=4)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--folder", type=Path)
    told = parser.parse_args()
    warnings.simplefilter("ignore", QualityWarning)
    folder = Path(tempfile.mkdtemp(dir=told.folder))
    try:
        for minutes, workers in ((min(1.0, told.minutes), None), (told.minutes, told.workers)):
            frames = int(60 * RATE_HZ * minutes)
            film = write_recording(folder / f"{frames}.nc", frames, parts(frames))
            start_s = time.perf_counter()
            found = reconstruct_recording(
                film, folder / f"{frames}_sr.nc", window=4, every=told.every, workers=workers
            )
            seconds = time.perf_counter() - start_s
            print(
                f"{frames} frames, {found.windows} pictures, "
                f"{'one process' if workers is None else f'{workers} workers'}: {seconds:.1f} s, "
                f"{60 * minutes / seconds:.1f} times real time, "
                f"{largest_mb(resource.RUSAGE_SELF):.0f} MB here, "
                f"{found.contradicted} contradicted",
                flush=True,
            )
        print(f"largest worker: {largest_mb(resource.RUSAGE_CHILDREN):.0f} MB")
        frames = int(60 * RATE_HZ * min(1.0, told.minutes))
        once = (folder / f"{frames}_sr.nc").read_bytes()
        again = reconstruct_recording(
            folder / f"{frames}.nc", folder / "again.nc", window=4, every=told.every,
            workers=told.workers,
        )  # fmt: skip
        same = again.path.read_bytes() == once
        print(f"the file of {told.workers} workers and that of one process: "
              f"{'the same' if same else 'DIFFERENT'}")  # fmt: skip
    finally:
        shutil.rmtree(folder)


if __name__ == "__main__":
    main()
