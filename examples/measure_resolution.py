"""How much resolution does a reconstruction gain, and what noise does it cost?

python examples/measure_resolution.py [--plot gain.png]

Four frames of a slanted edge, a quarter pixel off the centre each, with noise and shift errors that
the reconstruction does not know; the edge is then measured in one frame, in all frames together
and in the reconstruction, each with its 95 % interval.
"""

import argparse

import numpy as np

import lensshift
from lensshift.camera import Sensor
from lensshift.core.grid import Grid
from lensshift.report.edges import gain_figure
from lensshift.report.save import save_figure
from lensshift.scene import slanted_edge

PITCH_MM = 0.155
SHAPE = (16, 64)
SLANT_RAD = np.deg2rad(10.0)


def main() -> None:
    """Print the resolution of a frame, of all frames and of the reconstruction."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--plot", help="draw both curves there: .png, .svg or .pdf")
    arguments = parser.parse_args()
    sensor = Sensor(Grid(SHAPE, (PITCH_MM, PITCH_MM)), full_well_electrons=4000.0)
    burst, _ = lensshift.simulate_burst(slanted_edge(SLANT_RAD), sensor, shift_error_px=0.02)
    result = lensshift.reconstruct(burst, scale=2)
    if result.amplitude is None:
        raise SystemExit("the reconstruction has no amplitude")
    rows, cols = SHAPE
    whole = (0, rows, 0, cols)
    frame = lensshift.measure_edge(burst.amplitude[0], PITCH_MM, region=whole)
    frames = lensshift.measure_edge(
        burst.amplitude, PITCH_MM, region=whole, offset_px=burst.offset_px
    )
    sharp = lensshift.measure_edge(
        result.amplitude.image, PITCH_MM / 2, region=(0, 2 * rows, 0, 2 * cols), scale=2
    )
    for name, edge in (
        ("one frame", frame),
        ("four frames fitted together", frames),
        ("reconstruction x2", sharp),
    ):
        print(f"{name:<28s} MTF50 {edge.mtf50_lpmm} LP/mm, SNR {edge.snr:.0f}")
    gain = lensshift.resolution_gain(sharp, frame)
    print(f"{'gain in MTF50':<28s} {gain.mtf50}")
    print(f"{'gain in 10-90 width':<28s} {gain.width}")
    print(f"{'noise of a pixel':<28s} {gain.noise:.2f} times that of a frame")
    if arguments.plot:
        save_figure(gain_figure(sharp, frame, gain), arguments.plot)
        print(f"wrote {arguments.plot}")


if __name__ == "__main__":
    main()
