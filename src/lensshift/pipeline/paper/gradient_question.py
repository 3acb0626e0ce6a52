"""Why the distance may gain three times and the amplitude two: every edge phase of a strip.

A strip before a wall leans so little that each of 64 lines sees its left edge at another place
within a pixel. What the paper reads off one line is read off all of them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lensshift.camera import named_pattern_px, simulate_tof
from lensshift.core.arrays import Floats
from lensshift.core.grid import Grid
from lensshift.pipeline.paper import bench
from lensshift.pipeline.paper.box_claims import BRANCHES, SHARES, steepness
from lensshift.pipeline.paper.claims import Pair, mean_interval
from lensshift.scene import Plane, Rectangle, Scene

PHASES = 64  # lines, each a 64th of a pixel beside the one before
NEAR_M, FAR_M = 3.4, 3.7  # strip and wall
_GRID = Grid((PHASES, 24), (bench.PITCH_MM, bench.PITCH_MM))
_FIRST_COL = 2  # where the profiles begin, on the wall
_LEFT_COL = 8.0  # of the left edge in the middle of the image
_WIDEST_PX = 12.0  # beyond it a profile holds no more of the edge
_BRIGHT = 0.8  # reflectance of the brighter of the two


@dataclass(frozen=True, slots=True)
class Strip:
    """What is in front of the camera."""

    contrast: float  # amplitude of the strip over that of the wall
    width_px: float  # of the strip
    snr: float = 50.0  # of the brighter of the two


@dataclass(frozen=True, slots=True)
class Gain:
    """How much steeper than in one frame the edge becomes, over all its places on the pixels."""

    mean: float  # of the ratios of the slopes
    interval: Pair  # 95 % of the mean
    least: float  # smallest single ratio: what one profile may show
    most: float  # the largest
    above_three: float  # share of the profiles whose ratio is above 3
    lines: int  # number of profiles in which both edges reach the limits
    reach: float  # share of the true step that one frame shows, on average


def study_strip(
    strip: Strip, seed: int = 0, response: bench.Response = bench.PUBLISHED
) -> dict[str, Gain]:
    """Return the gains of all branches for one strip."""
    near, far = _reflectances(strip)
    light = max(near / NEAR_M**2, far / FAR_M**2)
    camera = bench.paper_camera(strip.snr, light, light, grid=_GRID, output="float")
    capture = simulate_tof(
        _scene(strip), camera, named_pattern_px("square"),
        shift_error_px=bench.SHIFT_ERROR_PX, seed=seed,
    )  # fmt: skip
    burst, truth = capture.burst, capture.truth
    fine = {
        "amplitude": bench.reconstructed(burst, "amplitude", response=response)["amplitude"],
        "distance": bench.reconstructed(burst, "distance", response=response)["distance"],
        "phasor": bench.reconstructed(burst, "phasor", response=response)["distance"],
    }
    frame = {"amplitude": burst.amplitude[0], "distance": np.asarray(burst.distance_m)[0]}
    true = {"amplitude": truth.amplitude, "distance": truth.distance_m}
    gains = {}
    for branch in BRANCHES:
        channel = "amplitude" if branch == "amplitude" else "distance"
        gains[branch] = _gain(fine[branch], frame[channel], true[channel], strip, channel)
    return gains


def _scene(strip: Strip) -> Scene:
    """Return the strip; its left edge moves by one pixel from the first line to the last."""
    near, far = _reflectances(strip)
    centre_px = _LEFT_COL + 0.5 * strip.width_px - 0.5 * (_GRID.shape[1] - 1)
    card = Rectangle(
        centre_m=(bench.px_to_m(centre_px, NEAR_M), 0.0, NEAR_M),
        size_m=(bench.px_to_m(strip.width_px, NEAR_M), bench.px_to_m(2.0 * PHASES, NEAR_M)),
        turn_rad=(0.0, 0.0, -1.0 / PHASES),
        reflectance=near,
        name="strip",
    )
    return Scene((card,), Plane(centre_m=(0.0, 0.0, FAR_M), reflectance=far))


def _reflectances(strip: Strip) -> Pair:
    """Return those of strip and wall, so that their amplitudes have the contrast."""
    ratio = strip.contrast * (NEAR_M / FAR_M) ** 2
    return (_BRIGHT, _BRIGHT / ratio) if ratio > 1 else (_BRIGHT * ratio, _BRIGHT)


def _gain(fine: Floats, frame: Floats, true: Floats, strip: Strip, channel: str) -> Gain:
    share = SHARES[channel]
    ratios, reach = [], []
    for row in range(PHASES):
        lean_px = (row - 0.5 * (PHASES - 1)) / PHASES
        # From the wall to the middle of the strip, the wide ones not to their end.
        end = _LEFT_COL + min(0.5 * strip.width_px, 0.5 * _WIDEST_PX) + lean_px
        last = int(np.floor(end + 0.5)) + 1
        coarse = steepness(frame, [row], slice(_FIRST_COL, last), bench.PITCH_MM, share)[0]
        cols = slice(2 * _FIRST_COL, 2 * last)
        steep = steepness(fine, [2 * row], cols, bench.PITCH_MM / 2, share)[0]
        ratios.append(steep / coarse)
        step = np.ptp(true[2 * row, 2 * _FIRST_COL : 2 * last])
        reach.append(np.ptp(frame[row, _FIRST_COL:last]) / step)
    values = np.asarray(ratios)
    values = values[np.isfinite(values)]
    if values.size < 2:
        nothing = float("nan")
        return Gain(nothing, (nothing, nothing), nothing, nothing, nothing, values.size, nothing)
    mean, interval = mean_interval(values.tolist())
    return Gain(
        mean=mean,
        interval=interval,
        least=float(values.min()),
        most=float(values.max()),
        above_three=float(np.mean(values > 3)),
        lines=int(values.size),
        reach=float(np.mean(reach)),
    )
