"""One page to file: what was found, with which devices, how well it does, what to do."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from lensshift.registration.robust_fit import BUDGET_PX
from lensshift.report.page import Page

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from lensshift.pipeline.doctor.examine import Diagnosis
    from lensshift.pipeline.doctor.view import View

_KEPT = 60  # characters of a value in a table


def doctor_page(done: Diagnosis) -> Page:
    """Return the page of a diagnosis, as far as it came."""
    from lensshift.report.calibration import add_calibration

    page = Page("Examination of the rig")
    page.text(done.verdict)
    page.text(f"{done.source}, {done.began}")
    worst_first = sorted(done.findings, key=lambda one: -one.level)
    page.table([{"level": one.level.name.lower(), "what": one.name, "found": one.said,
                 "do": one.cure} for one in worst_first])  # fmt: skip
    if done.view is not None:
        page.heading("What the camera sees")
        page.figure(
            _view_figure(done.view),
            "Amplitude, mean of the frames before the lens moved, and its noise over the mean; "
            "pixels that were invalid in a frame are shaded.",
        )
        counted = {name: count for name, count in done.counts.items() if count}
        page.table(_plain_rows(done.view.numbers | counted))
    if done.axes is not None:
        page.heading("What the axes do")
        if done.calibration is None:
            page.text("From a nudge of each by 50 um and back.")
        page.table(_plain_rows(done.axes.numbers))
    if done.budget is not None and done.calibration is not None:
        page.heading("Error budget")
        page.text(
            f"The shift of a frame of a burst is known to {done.budget.shift_px:.4f} px rms along "
            f"each axis; up to {BUDGET_PX} px is wanted. To make the largest part smaller: "
            f"{done.budget.cure}"
        )
        page.table([{"part": name, "px rms": size} for name, size in done.budget.parts.items()])
        whole = done.calibration
        add_calibration(page, whole.fit, whole.psnr_loss_db, whole.mtf50_loss)
    for name, known in done.devices.items():
        page.heading(name.capitalize())
        page.table(_plain_rows(_flat(known)))
    return page


def _view_figure(view: View) -> Figure:
    """Draw the scene as the camera sees it, and the noise of its pixels."""
    from lensshift.report.images import add_scale, draw_image
    from lensshift.report.style import new_figure, styled

    always = view.valid.all(axis=0)
    mean = np.where(always, view.amplitude.mean(axis=0), np.nan)
    noise = np.where(always, view.amplitude.std(axis=0) / np.abs(mean), np.nan)
    rows, cols = mean.shape
    wide = cols > 2 * rows
    with styled():
        figure = new_figure(9.0, 2 * 9.0 * rows / cols + 1.4 if wide else 9.0 / 2 * rows / cols + 1)
        panels = figure.subplots(2 if wide else 1, 1 if wide else 2, squeeze=False)
        first, second = panels.ravel()
        add_scale(first, draw_image(first, mean, "amplitude"), "amplitude")
        add_scale(second, draw_image(second, 100.0 * noise, "noise / mean"), "%")
    return figure


def _flat(known: Mapping[str, Any], before: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for name, value in known.items():
        inner = _flat(value, f"{before}{name} ") if isinstance(value, dict) else None
        flat |= {f"{before}{name}": value} if inner is None else inner
    return flat


def _plain_rows(known: Mapping[str, Any]) -> list[dict[str, str]]:
    return [{"what": name.replace("_", " "), "value": _text(one)} for name, one in known.items()]


def _text(value: Any) -> str:
    if isinstance(value, np.ndarray):
        return np.array2string(value, precision=4, separator=", ").replace("\n", "")
    text = f"{value:.4g}" if isinstance(value, float) else str(value)
    return text if len(text) <= _KEPT else f"{text[:_KEPT]} ..."
