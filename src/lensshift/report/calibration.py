"""One page on a calibration: what the stage does to the image, and whether that is good enough."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from lensshift.core.arrays import Floats
from lensshift.registration.calibrate import ScanFit
from lensshift.registration.robust_fit import BUDGET_PX
from lensshift.report.curves import legend_above
from lensshift.report.page import Page
from lensshift.report.style import BLUE, GREY, INK, RED, SMALL_PT, new_figure, round_number, styled

_MOVE_PX = 0.25  # that of the square pattern
_MOST_ARROWS = 17  # along an axis
_NAMES = ("row", "col")


def calibration_page(fit: ScanFit, *, psnr_loss_db: float, mtf50_loss: float) -> Page:
    """Return the page of a calibration.

    Parameters
    ----------
    psnr_loss_db, mtf50_loss : what shifts wrong by the rest of this calibration cost
    """
    page = Page("Calibration of the shift")
    add_calibration(page, fit, psnr_loss_db, mtf50_loss)
    return page


def add_calibration(page: Page, fit: ScanFit, psnr_loss_db: float, mtf50_loss: float) -> None:
    """Add what `calibration_page` holds to a page."""
    sigma_px = fit.calibration.stage_map.sigma_px
    page.heading("Calibration")
    good = sigma_px <= BUDGET_PX
    page.text(
        f"{'Good enough' if good else 'Not good enough'}: the calibration predicts the shift of a "
        f"frame to {sigma_px:.4f} px rms along each axis; up to {BUDGET_PX} px is wanted. Shifts "
        f"wrong by as much cost {psnr_loss_db:.2f} dB PSNR and {100 * mtf50_loss:.1f} % of MTF50."
    )
    page.heading("Numbers")
    page.table(_rows(fit))
    page.heading("What the calibration does not explain")
    page.figure(
        residual_figure(fit),
        "Registered shift less predicted shift of every frame of the scan: as arrows where the "
        "stage was, and their spread against the budget.",
    )
    page.heading("Time")
    page.figure(
        drift_figure(fit),
        "Shift of the image that the stage did not make, frame after frame; the line is the drift.",
    )
    page.heading("Over the sensor")
    if fit.calibration.stage_map.field_px_per_mm is None:
        page.text("The shift is the same everywhere, as far as this scan can tell.")
    else:
        page.figure(
            field_figure(fit),
            f"How the shift differs from its mean when the stage moves the image by {_MOVE_PX} px "
            "along one axis.",
        )


@styled()
def residual_figure(fit: ScanFit) -> Figure:
    """Draw what the calibration leaves: arrows over the stage range, and histograms."""
    figure = new_figure(9.0, 3.6)
    arrows, spread = figure.subplots(1, 2, width_ratios=(1.25, 1.0))
    _draw_residuals(arrows, fit)
    _draw_spread(spread, fit.residual_px)
    return figure


@styled()
def drift_figure(fit: ScanFit) -> Figure:
    """Draw the shift that neither stage nor play explains, over time."""
    figure = new_figure(9.0, 2.8)
    axes = figure.subplots()
    known = fit.burst.time_s is not None
    time = np.arange(len(fit.residual_px), dtype=np.float64)
    if fit.burst.time_s is not None:
        time = fit.burst.time_s - fit.burst.time_s[0]
    for axis, colour, marker in ((0, BLUE, "o"), (1, RED, "s")):
        line = fit.calibration.drift_px_per_s[axis] * (time - time.mean())
        axes.plot(time, line, color=colour, linewidth=1.2)
        axes.plot(
            time, line + fit.residual_px[:, axis], marker, color=colour, markersize=3.5,
            label=_NAMES[axis],
        )  # fmt: skip
    axes.axhline(0.0, color=GREY, linewidth=0.7)
    axes.set(xlabel="time (s)" if known else "number of the frame", ylabel="shift (px)")
    legend_above(axes, "not made by the stage")
    return figure


@styled()
def field_figure(fit: ScanFit) -> Figure:
    """Draw how the shift varies over the sensor for a move along each axis.

    Raises
    ------
    ValueError
        If the calibration has no map over the sensor.
    """
    per_mm = fit.calibration.stage_map.field_px_per_mm
    if per_mm is None:
        raise ValueError("expected a calibration over the sensor, this one has a single map")
    mean = per_mm.mean(axis=(0, 1))
    rows, cols = per_mm.shape[:2]
    differing = []
    for axis in (0, 1):
        move_mm = np.linalg.solve(mean, _MOVE_PX * np.eye(2)[axis])
        differing.append((per_mm - mean) @ move_mm)
    largest_px = max(float(np.linalg.norm(one, axis=-1).max()) for one in differing)
    unit_px = round_number(max(largest_px, 1e-4))
    step = max(1, int(np.ceil(max(rows, cols) / _MOST_ARROWS)))
    row, col = np.arange(step // 2, rows, step), np.arange(step // 2, cols, step)
    beside = rows > cols
    high = 4.6 if beside else 1.4 + 2 * 8.4 * rows / cols + 0.9
    figure = new_figure(9.0, min(high, 9.0))
    panels = figure.subplots(1 if beside else 2, 2 if beside else 1, squeeze=False).ravel()
    place = np.stack(np.meshgrid(row, col, indexing="ij"), axis=-1).astype(np.float64)
    for axis, axes in enumerate(panels):
        part = differing[axis][np.ix_(row, col)]
        how = {"scale": unit_px / (1.6 * step), "width": 0.0022, "color": BLUE}
        _draw_arrows(axes, place, part, (0.9, 1.06), unit_px, **how)
        axes.set(aspect="equal", xlim=(-2, cols + 1), ylim=(rows + 1, -2))
        axes.set(xlabel="col (px)", ylabel="row (px)")
        worst_px = float(np.linalg.norm(differing[axis], axis=-1).max())
        axes.set_title(f"move along {_NAMES[axis]}: up to {worst_px:.4f} px")
    return figure


def _draw_residuals(axes: Axes, fit: ScanFit) -> None:
    """Draw the residuals as arrows where the stage was."""
    stage_mm = np.asarray(fit.burst.stage_mm)
    size_px = np.linalg.norm(fit.residual_px, axis=1)
    unit_px = round_number(max(float(size_px.max()), 1e-4))
    span_mm = float(np.ptp(stage_mm, axis=0).max())
    for sign, colour, label in ((1, BLUE, "col approached upwards"), (-1, RED, "downwards")):
        here = fit.direction[:, 1] >= 0 if sign > 0 else fit.direction[:, 1] < 0
        if not np.any(here):
            continue
        how: dict[str, Any] = {"color": colour, "label": label, "width": 0.005}
        how["scale"] = unit_px / (0.16 * span_mm)
        key = (0.86, 1.04) if sign > 0 else None
        _draw_arrows(axes, stage_mm[here], fit.residual_px[here], key, unit_px, **how)
        axes.plot(stage_mm[here, 1], stage_mm[here, 0], ".", color=colour, markersize=3.0)
    axes.set(xlabel="stage, col (mm)", ylabel="stage, row (mm)", aspect="equal")
    axes.margins(0.15)
    axes.invert_yaxis()
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=2, frameon=False)
    axes.set_title("residual")


def _draw_arrows(
    axes: Axes,
    at: Floats,
    by_px: Floats,
    key: tuple[float, float] | None,
    unit_px: float,
    **how: Any,
) -> None:
    """Draw arrows at places (row, col) [... 2], and how long a unit is at a key."""
    places = (at[..., 1], at[..., 0], by_px[..., 1], by_px[..., 0])
    arrows = axes.quiver(*places, angles="xy", scale_units="xy", **how)
    if key is not None:
        words: Any = {"labelpos": "E", "color": INK, "fontproperties": {"size": SMALL_PT}}
        axes.quiverkey(arrows, *key, unit_px, f"{unit_px:g} px", **words)


def _draw_spread(axes: Axes, residual_px: Floats) -> None:
    """Draw the histogram of the residuals along both axes, and the budget."""
    reach_px = max(float(np.abs(residual_px).max()), 1.3 * BUDGET_PX)
    bins = np.linspace(-reach_px, reach_px, 2 * max(5, round(len(residual_px) ** 0.5)) + 2)
    for axis, colour in ((0, BLUE), (1, RED)):
        rms_px = float(np.sqrt(np.mean(residual_px[:, axis] ** 2)))
        axes.hist(
            residual_px[:, axis], bins=list(bins), histtype="step", linewidth=1.6, color=colour,
            label=f"{_NAMES[axis]}, {rms_px:.4f} px rms",
        )  # fmt: skip
    for sign in (-1, 1):
        axes.axvline(sign * BUDGET_PX, color=INK, linestyle="--", linewidth=0.9)
    axes.set(xlabel=f"residual (px); dashed: {BUDGET_PX} px", ylabel="frames")
    legend_above(axes, "spread")


def _rows(fit: ScanFit) -> list[dict[str, str]]:
    found = fit.calibration
    sigma, turn, cross = found.px_per_mm_sigma, found.rotation_sigma_rad, found.cross_talk_sigma
    numbers: list[tuple[str, float, float | None, str, int]] = []
    for (i, j), value in np.ndenumerate(found.stage_map.px_per_mm):
        error = None if sigma is None else float(sigma[i, j])
        numbers += [(f"image {_NAMES[i]} per stage {_NAMES[j]}", value, error, "px per mm", 4)]
    error = None if turn is None else float(np.rad2deg(turn))
    numbers += [("rotation of the stage", np.rad2deg(found.rotation_rad), error, "degrees", 3)]
    for i, name in enumerate(_NAMES):
        error = None if cross is None else 100 * cross[i]
        numbers += [(f"cross-talk of stage {name}", 100 * found.cross_talk[i], error, "%", 2)]
    for name, play, error in zip(_NAMES, found.play_mm, found.play_sigma_mm, strict=True):
        if error > 0:
            numbers += [(f"play of {name}", 1e3 * play, 1e3 * error, "um", 2)]
    if fit.burst.time_s is not None:
        drifts = zip(_NAMES, found.drift_px_per_s, found.drift_sigma_px_per_s, strict=True)
        for name, drift, error in drifts:
            numbers += [(f"drift along {name}", 60 * drift, 60 * error, "px per minute", 4)]
    if found.psf_sigma_px is not None:
        what = "width of the blur, optics and pixel"
        numbers += [(what, found.psf_sigma_px, found.psf_sigma_sigma_px, "px", 3)]
    numbers += [("residual, rms along each axis", found.stage_map.sigma_px, None, "px", 4)]
    numbers += [("frames", fit.burst.frame_count, None, "", 0)]
    return [
        {"what": what, "value": f"{value:.{digits}f}",
         "standard error": "-" if error is None else f"{error:.{digits}f}", "unit": unit}
        for what, value, error, unit, digits in numbers
    ]  # fmt: skip
