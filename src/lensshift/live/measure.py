"""What is measured beside the pictures, in a process of its own: no picture waits for it."""

from __future__ import annotations

import multiprocessing
import os
import signal
import time
import warnings
from concurrent.futures import ProcessPoolExecutor
from typing import Any

import numpy as np

from lensshift.core.arrays import Array
from lensshift.core.errors import QualityWarning
from lensshift.core.types import Burst

_CURVE_POINTS = 51  # of the curve that the page draws


def beside() -> ProcessPoolExecutor:
    """Return the process that measures; it gives way to all others."""
    context = multiprocessing.get_context("spawn")
    return ProcessPoolExecutor(1, mp_context=context, initializer=_give_way)


def _give_way() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the process that started it
    if hasattr(os, "nice"):
        os.nice(4)


def shift_error(window: Burst) -> dict[str, float]:
    """Return how far the registered shifts are from the planned ones.

    rms_px : over frames and axes of (registered - planned), the mean of each axis left out
    sigma_px : standard error of a registered shift (rms)
    cost_s : of a core
    """
    from lensshift.registration import register

    begin_s = time.process_time()
    with warnings.catch_warnings(action="ignore", category=QualityWarning):  # sigma_px says it
        found = register(window, motion="shift")
    error_px = found.offset_px - window.offset_px
    error_px = error_px - error_px.mean(axis=0)
    sigma_px = np.zeros(1) if found.offset_sigma_px is None else found.offset_sigma_px[1:]
    cost_s = time.process_time() - begin_s
    return {"rms_px": _rms(error_px), "sigma_px": _rms(sigma_px), "cost_s": cost_s}


def edge_curve(
    image: Array,  # [row col]
    pitch_mm: float,  # of its pixels
    scale: int,  # how many of them are as wide as an LR pixel
    box: tuple[int, ...],  # (row start, row stop, col start, col stop)
    most_lpmm: float,  # where the curve ends, unless one cycle per pixel is less
) -> dict[str, Any]:
    """Return the MTF of the edge in a box of an image, or "why" there is none.

    "low" and "high" are the 95 % band, or None; "nyquist_lpmm" is of the LR pixels.
    """
    from lensshift.evaluation.slanted_edge import measure_edge

    frequency_lpmm = np.linspace(0.0, min(most_lpmm, 1.0 / pitch_mm), _CURVE_POINTS)
    try:
        with warnings.catch_warnings(action="ignore", category=QualityWarning):  # the notes say it
            found = measure_edge(
                image,
                pitch_mm,
                region=(box[0], box[1], box[2], box[3]),
                valid=np.isfinite(image),
                scale=scale,
                frequency_lpmm=frequency_lpmm,
            )
    except (ValueError, np.linalg.LinAlgError) as error:
        return {"why": str(error)}
    return {
        "frequency_lpmm": found.mtf.frequency_lpmm.tolist(),
        "modulation": _finite(found.mtf.modulation),
        "low": None if found.low is None else _finite(found.low),
        "high": None if found.high is None else _finite(found.high),
        "nyquist_lpmm": found.nyquist_lpmm,
        "mtf50": f"{found.mtf50_lpmm} lp/mm",
        "notes": list(found.notes),
        "usable": found.usable,
    }


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values)))) if values.size else 0.0


def _finite(values: Array) -> list[float | None]:
    return [float(one) if np.isfinite(one) else None for one in values]
