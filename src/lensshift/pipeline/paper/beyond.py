"""What the paper did not try: patterns, wrong shifts, and every edge phase of a strip.

A strip before a wall leans so little that each of 64 lines sees its left edge at another place
within a pixel. What the paper reads off one line is read off all of them: why the distance may gain
three times and the amplitude two.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lensshift.camera import named_pattern_px, simulate_tof
from lensshift.core.arrays import Floats
from lensshift.core.grid import Grid
from lensshift.pipeline.paper import bench
from lensshift.pipeline.paper.box_claims import (
    BRANCHES,
    BRIGHTEST_LIGHT,
    SHARES,
    amplitude_error,
    steepness,
)
from lensshift.pipeline.paper.claims import Claim, Pair, mean_interval
from lensshift.pipeline.paper.gratings import grating_of
from lensshift.scene import Plane, Rectangle, Scene, four_boxes, slanted_edge_card

Row = dict[str, Any]

# pattern, scale
PATTERNS = (("square", 2), ("3x3", 3), ("4x4", 4))
ERRORS_PX = (0.0, 0.02, 0.05, 0.1)  # rms: none, that of the bench, two that hurt
_GRATING_LPMM = 5.0  # beside the edges of the tables; beyond the Nyquist frequency of a frame
PHASES = 64  # lines, each a 64th of a pixel beside the one before
NEAR_M, FAR_M = 3.4, 3.7  # strip and wall
_GRID = Grid((PHASES, 24), (bench.PITCH_MM, bench.PITCH_MM))
_FIRST_COL = 2  # where the profiles begin, on the wall
_LEFT_COL = 8.0  # of the left edge in the middle of the image
_WIDEST_PX = 12.0  # beyond it a profile holds no more of the edge
_BRIGHT = 0.8  # reflectance of the brighter of the two


def pattern_row(pattern: str, scale: int, response: bench.Response = bench.PUBLISHED) -> Row:
    """Return what a finer pattern resolves, every frame exposed as one of four."""
    row = {"pattern": pattern, "scale": scale, "grid_nyquist_lpmm": 0.5 * scale / bench.PITCH_MM}
    return row | _numbers(pattern, scale, response)


def error_row(
    shift_error_px: float, seed: int = 0, response: bench.Response = bench.PUBLISHED
) -> Row:
    """Return what wrong shifts leave of edge, grating and boxes, and what it is to know them."""
    row: Row = {"shift_error_px": shift_error_px}
    row |= _numbers("square", 2, response, shift_error_px=shift_error_px, seed=seed)
    capture = simulate_tof(
        four_boxes(), bench.paper_camera(bench.SNR, bench.WALL_LIGHT, BRIGHTEST_LIGHT),
        named_pattern_px("square"), shift_error_px=shift_error_px, seed=seed,
    )  # fmt: skip
    known = replace(capture.burst, offset_px=capture.truth.offset_px)
    for method in ("auto", "tikhonov"):
        for name, burst in (("planned", capture.burst), ("known", known)):
            error = amplitude_error(bench.solved(burst, method, response), capture.truth)
            row[f"{name}_error_{method}"] = error
    return row


def mean_rows(rows: list[Row], key: str) -> list[Row]:
    """Return the means of the rows that share a key."""
    values = sorted({row[key] for row in rows})
    same = [[row for row in rows if row[key] == value] for value in values]
    return [{name: float(np.mean([r[name] for r in some])) for name in some[0]} for some in same]


def shift_claim(rows: list[Row]) -> Claim:
    """Return what the rows with wrong shifts say of knowing them."""
    wrong = [row for row in rows if row["shift_error_px"] > 0]
    numbers = {
        f"ratio{whose}": mean_interval(
            [row[f"known_error_{method}"] / row[f"planned_error_{method}"] for row in wrong]
        )
        for whose, method in (("", "auto"), (", tikhonov", "tikhonov"))
    }
    worst = mean_rows(wrong, "shift_error_px")[-1]
    return Claim(
        id="known-shifts-help",
        statement="The better the sub-pixel positions are known, the better the result.",
        paper="yes",
        numbers=numbers,
        why=f"Told the true shifts instead of the planned ones, the error of the boxes is "
        f"{numbers['ratio'][0]:.3f} times as large (tikhonov {numbers['ratio, tikhonov'][0]:.3f}), "
        f"over shift errors up to {worst['shift_error_px']:g} px rms; there it is "
        f"{worst['known_error_auto']:.4f} instead of {worst['planned_error_auto']:.4f}.",
    )


def remark(name: str, rows: list[Row]) -> str:
    """Return what has to be said of a table whose edges contradict what is resolved."""
    if name == "errors":
        mtf50 = [row["mtf50_lpmm"] for row in rows]
        if max(mtf50[1:], default=0.0) > mtf50[0]:
            return (
                f"MTF50 of the edge rises from {mtf50[0]:.2f} to {max(mtf50):.2f} LP/mm while the "
                "shifts get worse and so do the errors against the truth: a straight edge is what "
                "a sparse or learned prior expects, and it sharpens what it believes to see. This "
                "is no resolution; errors and gratings are to be believed."
            )
    beyond = [
        row for row in rows if row.get("grid_nyquist_lpmm", np.inf) < row.get("mtf50_lpmm", 0)
    ]
    if beyond:
        worst = ", ".join(
            f"{row['mtf50_lpmm']:.1f} LP/mm on a grid that ends at "
            f"{row['grid_nyquist_lpmm']:.1f}" for row in beyond
        )  # fmt: skip
        return (
            f"An MTF50 beyond the Nyquist frequency of the grid ({worst}) cannot be resolution: "
            "it is the width of an edge, found over many lines that cross it at other places, of "
            "a picture whose prior draws edges steep."
        )
    return ""


def _numbers(
    pattern: str,
    scale: int,
    response: bench.Response,
    *,
    shift_error_px: float = bench.SHIFT_ERROR_PX,
    seed: int = 0,
) -> Row:
    """Return what the edge of the card and a grating become."""
    camera = bench.paper_camera(bench.SNR, bench.CARD_LIGHT, bench.CARD_LIGHT)
    burst = simulate_tof(
        slanted_edge_card(), camera, named_pattern_px(pattern), scale=scale,
        shift_error_px=shift_error_px, seed=seed,
    ).burst  # fmt: skip
    fine = bench.measured_edge(bench.solved(burst, "auto", response, scale), scale)
    coarse = bench.measured_edge(np.asarray(burst.amplitude[0]), 1)
    return {
        "mtf50_lpmm": fine.mtf50_lpmm.value,
        "width_gain": coarse.rise_mm.value / fine.rise_mm.value,
        "noise_gain": fine.noise / coarse.noise,
        "grating_modulation": grating_of(
            camera, pattern, scale, _GRATING_LPMM, response, shift_error_px=shift_error_px,
            seed=seed,
        ),
    }  # fmt: skip


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
