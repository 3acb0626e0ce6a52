"""What the assumed pixel response decides: sharper edges, or truer distances."""

from __future__ import annotations

from typing import Any

import numpy as np

from lensshift.camera import named_pattern_px, simulate_tof
from lensshift.pipeline.experiment import depth_numbers
from lensshift.pipeline.paper.bench import CARD_LIGHT, SHIFT_ERROR_PX, WALL_LIGHT, paper_camera
from lensshift.pipeline.paper.box_claims import BRIGHTEST_LIGHT, SNR
from lensshift.pipeline.paper.edge_claims import FREQUENCY_LPMM, limit
from lensshift.pipeline.paper.measure import Response, measured_edge, reconstructed
from lensshift.scene import four_boxes, slanted_edge_card

# The pixel as it is, on HR pixels that are evenly bright, and Gaussians about as wide.
RESPONSES: tuple[Response, ...] = (
    (1.0, 0.05), (None, 0.25), (None, 0.28), (None, 0.30), (None, 0.32)
)  # fmt: skip
_DRAWS = 3


def response_row(fill_factor: float | None, width_px: float) -> dict[str, Any]:
    """Return what the edge card and the boxes become with an assumed pixel response.

    Means over draws of noise and shift errors; the camera is the same in all rows.
    """
    response = (fill_factor, width_px)
    edges = [_edge_numbers(response, seed) for seed in range(_DRAWS)]
    boxes = [_box_numbers(response, seed) for seed in range(_DRAWS)]
    shape = "Gaussian" if fill_factor is None else "square, spot"
    return {"assumed": shape, "width_px": width_px} | {
        name: float(np.mean([row[name] for row in rows]))
        for rows in (edges, boxes)
        for name in rows[0]
    }


def _edge_numbers(response: Response, seed: int) -> dict[str, float]:
    camera = paper_camera(SNR, CARD_LIGHT, CARD_LIGHT)
    burst = simulate_tof(
        slanted_edge_card(), camera, named_pattern_px("square"), shift_error_px=SHIFT_ERROR_PX,
        seed=seed,
    ).burst  # fmt: skip
    image = reconstructed(burst, "amplitude", response=response)["amplitude"]
    fine = measured_edge(image, 2, FREQUENCY_LPMM)
    coarse = measured_edge(np.asarray(burst.amplitude[0]), 1)
    between = (FREQUENCY_LPMM >= 2.0) & (FREQUENCY_LPMM <= 5.0)
    return {
        "width_gain": coarse.rise_mm.value / fine.rise_mm.value,
        "above_limit": float(np.max((fine.mtf.modulation - limit(0.5))[between])),
    }


def _box_numbers(response: Response, seed: int) -> dict[str, float]:
    camera = paper_camera(SNR, WALL_LIGHT, BRIGHTEST_LIGHT, optics="petzval_a")
    capture = simulate_tof(
        four_boxes(), camera, named_pattern_px("square"), shift_error_px=SHIFT_ERROR_PX, seed=seed
    )
    numbers = {}
    for branch in ("distance", "phasor"):
        image = reconstructed(capture.burst, branch, response=response)["distance"]
        found = depth_numbers(image, capture.truth, 2)
        numbers[f"{branch}_edge_mm"] = 1e3 * found["edge_rmse_m"]
    return numbers
