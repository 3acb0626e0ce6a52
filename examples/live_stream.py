"""Frames one at a time: boxes sharpen while the lens goes round, then another scene appears.

After each frame there is a picture. How it was made, how far it is from the truth and what it cost
is printed: it is computed while the plan is not complete and once a round, and follows the light of
the frames in between.

    python examples/live_stream.py
"""

import time
import warnings

import lensshift
from lensshift import Burst, QualityWarning
from lensshift.camera import Sensor, simulate_burst
from lensshift.core.grid import Grid
from lensshift.evaluation import psnr_db
from lensshift.scene import Target, demo_target, siemens_star

SHAPE, PITCH_MM = (32, 64), (0.155, 0.155)
SQUARE_PX = ((-0.25, -0.25), (-0.25, 0.25), (0.25, 0.25), (0.25, -0.25))


def frames_of(target: Target, seed: int) -> tuple[Burst, lensshift.Estimate]:
    """Return a burst whose frames are taken one by one, and its truth."""
    sensor = Sensor(Grid(SHAPE, PITCH_MM))
    return simulate_burst(target, sensor, SQUARE_PX, seed=seed)


def main() -> None:
    """Print what happens at each step."""
    size_mm = (SHAPE[0] * PITCH_MM[0], SHAPE[1] * PITCH_MM[1])
    boxes, of_boxes = frames_of(demo_target(size_mm), 1)
    star, of_star = frames_of(siemens_star(4.0), 2)
    camera = lensshift.stream(boxes)
    for number in range(16):
        burst, truth = (boxes, of_boxes) if number < 10 else (star, of_star)
        start_s = time.perf_counter()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", QualityWarning)
            result = camera.step(burst.amplitude[number % 4])
        taken_ms = 1e3 * (time.perf_counter() - start_s)
        close_db = psnr_db(result.amplitude.image, truth.image)
        pace, event = result.settings["pace"], result.settings["event"] or ""
        print(f"frame {number:2d}: {close_db:5.1f} dB, {pace:<8} {taken_ms:7.1f} ms  {event}")


if __name__ == "__main__":
    main()
