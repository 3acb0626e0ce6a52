"""What the paper did not try: patterns, exposure, wrong shifts, the shift map of the lens."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lensshift.camera import named_pattern_px, simulate_tof
from lensshift.evaluation import fidelity
from lensshift.evaluation.slanted_edge import EdgeResult
from lensshift.optics.lens_file import load_lens
from lensshift.pipeline.experiment import Experiment, told
from lensshift.pipeline.paper.bench import CARD_LIGHT, SHIFT_ERROR_PX, paper_camera
from lensshift.pipeline.paper.measure import measured_edge, reconstructed
from lensshift.scene import Plane, Scene, ZonePlate, slanted_edge_card

Floats = NDArray[np.float64]
Row = dict[str, Any]

SNR = 50.0
# pattern, scale
PATTERNS = (("square", 2), ("3x3", 3), ("4x4", 4))
# pattern, at the light of four frames in all
EQUAL_LIGHT = ("still", "square", "3x3", "4x4")
ERRORS_PX = (0.0, 0.02, 0.05, 0.1)
# Moved lens, SNR, shift error: with planned shifts and single frames, with shifts as `calibrate`
# leaves them, and with sixteen frames averaged at each position as well.
MAPS = ((0, SNR, 0.02), (0, SNR, 0.004), *((element, 4 * SNR, 0.004) for element in (0, 1, 2)))
# The zone plate fills the sensor; its last ring is 1.25 pixels wide. Automatic weights take such
# fine rings for noise, so the weight is fixed.
_RADIUS_M, _FINEST_M, _PRIOR_WEIGHT = 0.41, 0.0155, 0.003
# A Gaussian with the second moment of the square pixel and its spot. Taps that take HR pixels for
# evenly bright are right on the HR grid; beside it they widen the pixel, which hides the map.
_RESPONSE = (None, float(np.hypot(1.0 / np.sqrt(12.0), 0.05)))
_ZONE_DRAWS = 4


def pattern_row(pattern: str, scale: int, seed: int = 0) -> Row:
    """Return what a finer pattern resolves, every frame exposed as one of four."""
    fine, coarse = _edges(pattern, scale, SHIFT_ERROR_PX, seed)
    return {"pattern": pattern, "scale": scale} | _numbers(fine, coarse)


def light_row(pattern: str, seed: int = 0) -> Row:
    """Return what more, shorter frames are worth at scale 2, with the light of four in all."""
    count = len(named_pattern_px(pattern))
    fine, coarse = _edges(pattern, 2, SHIFT_ERROR_PX, seed, exposure=4.0 / count)
    return {"frames": count, "exposure": 4.0 / count} | _numbers(fine, coarse)


def error_row(shift_error_px: float, seed: int = 0) -> Row:
    """Return what wrong shifts leave of the resolution."""
    fine, coarse = _edges("square", 2, shift_error_px, seed)
    return {"shift_error_px": shift_error_px} | _numbers(fine, coarse)


def shift_map_row(element: int, snr: float, shift_error_px: float) -> Row:
    """Return the PSNR of a zone plate with one shift per frame, and with the traced map.

    The lens is the second reconstruction of the paper's, whose shift varies more. Means over
    draws of noise and shift errors, and the least and the most that the map gains in one.
    """
    planned, traced = np.transpose(
        [zone_psnr_db(element, snr, shift_error_px, seed) for seed in range(_ZONE_DRAWS)]
    )
    gain_db = traced - planned
    return {
        "element": f"{element + 1} ({load_lens('petzval_b').elements[element].name})",
        "snr": snr,
        "shift_error_px": shift_error_px,
        "planned_psnr_db": float(planned.mean()),
        "traced_psnr_db": float(traced.mean()),
        "gain_db": float(gain_db.mean()),
        "least_gain_db": float(gain_db.min()),
        "most_gain_db": float(gain_db.max()),
    }


def zone_psnr_db(element: int, snr: float, shift_error_px: float, seed: int) -> tuple[float, float]:
    """Return the PSNR with one shift per frame, and with the map, of the same frames."""
    light = 0.9 / 3.5**2
    camera = paper_camera(snr, light, light, optics="petzval_b", element=element)
    experiment = Experiment(
        _zone_plate(), camera, named_pattern_px("square"), shift_error_px=shift_error_px,
        seed=seed,
    )  # fmt: skip
    capture = simulate_tof(
        experiment.scene, camera, experiment.pattern_px, shift_error_px=shift_error_px, seed=seed
    )
    psnr_db = []
    for shifts in ("planned", "traced"):
        burst, field = told(replace(experiment, shifts=shifts), capture)
        image = reconstructed(
            burst, "amplitude", method="tikhonov", shift_field=field,
            prior_weight=_PRIOR_WEIGHT, response=_RESPONSE,
        )["amplitude"]  # fmt: skip
        psnr_db.append(fidelity(image, capture.truth.amplitude).psnr_db)
    return psnr_db[0], psnr_db[1]


def _zone_plate() -> Scene:
    rings = ZonePlate(_RADIUS_M, _FINEST_M, 0.1, 0.9)
    return Scene((Plane(centre_m=(0.0, 0.0, 3.5), reflectance=rings),))


def _edges(
    pattern: str, scale: int, shift_error_px: float, seed: int, *, exposure: float = 1.0
) -> tuple[EdgeResult, EdgeResult]:
    """Return the edge of the card as reconstructed, and as one of the frames shows it.

    Parameters
    ----------
    exposure : of a frame, over that with the usual SNR; the range of the converter follows
    """
    camera = paper_camera(SNR, CARD_LIGHT, CARD_LIGHT)
    readout = camera.readout
    readout = replace(
        readout,
        exposure_s=(exposure * readout.exposure_s[0],),
        full_well_electrons=exposure * readout.full_well_electrons,
    )
    camera = replace(camera, readout=readout)
    capture = simulate_tof(
        slanted_edge_card(), camera, named_pattern_px(pattern), scale=scale,
        shift_error_px=shift_error_px, seed=seed,
    )  # fmt: skip
    burst = capture.burst
    method = "bicubic" if len(burst.amplitude) == 1 else "auto"
    fine = reconstructed(burst, "amplitude", scale=scale, method=method)["amplitude"]
    return measured_edge(fine, scale), measured_edge(np.asarray(burst.amplitude[0]), 1)


def _numbers(fine: EdgeResult, coarse: EdgeResult) -> Row:
    return {
        "mtf50_lpmm": fine.mtf50_lpmm.value,
        "mtf50_gain": fine.mtf50_lpmm.value / coarse.mtf50_lpmm.value,
        "width_gain": coarse.rise_mm.value / fine.rise_mm.value,
        "noise": fine.noise,
        "noise_gain": fine.noise / coarse.noise,
    }
