"""What the paper did not try: patterns and wrong shifts."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from lensshift.camera import named_pattern_px, simulate_tof
from lensshift.pipeline.paper import bench
from lensshift.pipeline.paper.box_claims import BRIGHTEST_LIGHT, amplitude_error
from lensshift.pipeline.paper.claims import Claim, mean_interval
from lensshift.pipeline.paper.gratings import grating_of
from lensshift.scene import four_boxes, slanted_edge_card

Row = dict[str, Any]

# pattern, scale
PATTERNS = (("square", 2), ("3x3", 3), ("4x4", 4))
ERRORS_PX = (0.0, 0.02, 0.05, 0.1)  # rms: none, that of the bench, two that hurt
_GRATING_LPMM = 5.0  # beside the edges of the tables; beyond the Nyquist frequency of a frame


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
