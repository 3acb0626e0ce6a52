"""The report of the reproduction: what a researcher reads first, then the figures."""

from __future__ import annotations

from datetime import UTC, datetime
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import lensshift
from lensshift.camera import named_pattern_px
from lensshift.evaluation.limits import pixel_aperture_mtf
from lensshift.optics.lens_file import load_lens
from lensshift.optics.otf import diffraction_limit
from lensshift.pipeline.paper.bench import PITCH_MM
from lensshift.pipeline.paper.beyond import remark
from lensshift.pipeline.paper.box_claims import BRANCHES
from lensshift.pipeline.paper.claims import VERDICTS, criterion
from lensshift.pipeline.paper.edge_claims import FREQUENCY_LPMM, KINDS, limit, mean_curve
from lensshift.pipeline.paper.gratings import frequencies, mean_gratings
from lensshift.report.claims import curves_figure, gains_figure, profiles_figure, sampling_figure
from lensshift.report.lenses import layout_figure
from lensshift.report.page import Page
from lensshift.report.shots import shots_figure

if TYPE_CHECKING:
    from lensshift.pipeline.paper.reproduce import Reproduction

_PAPER = (
    "Optical lens-shift design for increasing spatial resolution of 3D ToF cameras. Research "
    "article, Advanced Optical Technologies."
)
# Through the left small cube: LR row and columns.
_ROW, _COLS = 11, (1, 17)
_UNITS = {"px": "px", "lpmm": "LP/mm", "mm": "mm"}
_TABLES = {
    "patterns": "Finer patterns, every frame exposed alike, gratings of 5 LP/mm",
    "errors": "Shifts that are not where they were planned, gratings of 5 LP/mm",
    "responses": "What the pixel is assumed to be, by the error of the amplitude of the boxes over "
    "its mean, and by that of the distance at their edges",
}


def write_page(found: Reproduction, path: Path) -> None:
    """Write the report."""
    page = Page("Lens-shift super-resolution of a time-of-flight camera, measured")
    counts = ", ".join(
        f"{sum(claim.verdict == verdict for claim in found.claims)} {verdict}"
        for verdict in VERDICTS
    )
    when = datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC")
    page.text(f"The paper: {_PAPER}")
    page.text(
        f"This report: {when}, lensshift {lensshift.__version__}, {found.seconds:.0f} s"
        + (f", {found.command}" if found.command else "")
    )
    if found.not_done:
        page.text("A quick look. Not done: " + "; ".join(found.not_done) + ".")
    page.text(
        f"Of {len(found.claims)} claims of the paper: {counts}. All numbers come from simulated "
        "bursts with shot noise, read noise, quantisation and shift errors of 0.02 px rms that the "
        "reconstruction does not know. The simulator traces the lens, casts rays at the scene and "
        "averages phasors over pixels; it shares no code with the model that the reconstruction "
        "inverts. The reconstruction assumes a pixel of "
        f"{found.response_px:.3f} +- {found.response_error_px:.3f} px, which calibrate measures "
        "on the edge card of this bench (the default undoes a square pixel "
        "at most, 0.289 px, and leaves the lens); what the paper's 0.30 px gives stands beside it. "
        "Intervals are 95 % over noise, shift errors and places of the edge on the pixels; where "
        "chance plays no part, the range over what was tried."
    )
    _claim_tables(page, found)
    page.figure(
        sampling_figure(named_pattern_px("square")),
        "Figure 1, redrawn as the principle: four frames, each with the lens a quarter pixel off "
        "in rows and columns, see the scene at four places of every pixel. Together they sample "
        "it at half the pitch, each sample still averaged over a whole pixel.",
    )
    _lens_section(page, found)
    _edge_section(page, found)
    _box_section(page, found)
    _gradient_section(page, found)
    _beyond_section(page, found)
    page.save(path)


def _claim_tables(page: Page, found: Reproduction) -> None:
    told = {"claim": "statement", "paper": "paper", "measured": "said"}
    told |= {"verdict": "verdict", "why": "why"}
    page.table([{k: getattr(claim, name) for k, name in told.items()} for claim in found.claims])
    page.text(
        "What decides: the same ranges for every run. A claim is confirmed if the intervals of "
        "all its numbers lie in the range claimed, refuted if a number lies beyond the range "
        "tolerated and its interval beyond the one claimed, and qualified otherwise: so, too, "
        "where few draws tell neither. Claims on resolution need edge and grating. What tikhonov "
        "gives, with a fixed weight and so linear, stands below the default: it shows how much of "
        "a verdict is the prior's, and decides nothing."
    )
    rows: list[dict[str, Any]] = []
    for claim in found.claims:
        for name, (ours, interval) in claim.numbers.items():
            by = criterion(claim.id, name)
            row = {"claim": claim.id, "number": f"{name}: {by.meaning}", "ours": ours}
            row |= {"interval": "" if len(set(interval)) == 1 else interval}
            row |= {"claimed": by.claimed, "tolerated": by.tolerated}
            rows.append(row | {"verdict": by.judge((ours, interval))})
    page.table(rows)


def _lens_section(page: Page, found: Reproduction) -> None:
    page.heading("The lens")
    first = found.lenses[0]
    page.figure(
        layout_figure(load_lens(first.name), 0, first.travel_mm),
        "Figure 2: the lens with its first element at rest and moved, rays at 0 and 6.5 degrees.",
    )
    for lens in found.lenses:
        diffraction = diffraction_limit(load_lens(lens.name), lens.frequency_lpmm)
        curves = {
            f"{place} {state}": values[number]
            for number, place in enumerate(("centre,", "6.5/1.6 degrees,"))
            for state, values in (("at rest", lens.rest), ("moved", lens.moved))
        }
        limits = {
            "|sinc| of a pixel": pixel_aperture_mtf(lens.frequency_lpmm, PITCH_MM),
            "|sinc| of half a pixel": pixel_aperture_mtf(lens.frequency_lpmm, PITCH_MM / 2),
            "diffraction": diffraction.modulation,
        }
        page.figure(
            curves_figure(lens.frequency_lpmm, curves, limits, f"MTF of {lens.name}", paired=True),
            f"Figure 3: MTF along columns of {lens.name}, first element at rest and a quarter "
            "pixel away in rows and columns, exact from the traced wavefront.",
        )
    page.table([
        {"lens": lens.name, "element": f"{mover.element + 1} ({mover.name})",
         "travel for a quarter pixel (um)": 1e3 * mover.stroke_mm,
         "largest shift error (px)": mover.max_shift_error_px, "loss of MTF": mover.mtf_loss}
        for lens in found.lenses
        for mover in lens.movers
    ])  # fmt: skip


def _edge_section(page: Page, found: Reproduction) -> None:
    page.heading("The slanted edge")
    run = found.edges[0]
    shown = {kind: {"amplitude": _doubled(run.images[kind])} for kind in KINDS}
    page.figure(
        shots_figure(shown, "Edge card at 3.5 m, SNR 50", wide_in=8.0),
        "Figure 4: the card as one frame shows it and as it is reconstructed.",
    )
    runs = list(found.edges)
    curves = {kind: mean_curve(runs, kind) for kind in KINDS}
    bands = {
        kind: tuple(np.percentile([one.edges[kind].mtf.modulation for one in runs], (0, 100), 0))
        for kind in ("one frame", "lens shift")
    }
    limits = {"|sinc| of a pixel": limit(1.0), "|sinc| of half a pixel": limit(0.5)}
    page.figure(
        curves_figure(FREQUENCY_LPMM, curves, limits, "MTF along the normal", bands=bands),
        f"Figure 5: mean MTF of {len(runs)} bursts, measured by maximum likelihood on the card; "
        "bands: all bursts.",
    )
    waves = list(found.gratings)
    page.figure(
        curves_figure(
            frequencies(waves),
            {kind: mean_gratings(waves, kind) for kind in KINDS},
            {
                name: np.interp(frequencies(waves), FREQUENCY_LPMM, curve)
                for name, curve in limits.items()
            },
            "What is left of gratings, same camera and solvers",
        ),
        "Figure 5, with gratings: sine waves over the whole sensor, across the same direction as "
        "the edge, read in the phase in which they were drawn. A solver that is not linear may "
        "show an edge steep and a grating not at all: only where both agree is there resolution.",
    )
    page.table([_edge_beside_grating(runs, waves, kind) for kind in KINDS])
    page.table(
        [
            {
                "image": kind,
                "MTF50 (LP/mm)": float(np.mean([r.edges[kind].mtf50_lpmm.value for r in runs])),
                "10-90 width (um)": 1e3
                * float(np.mean([r.edges[kind].rise_mm.value for r in runs])),
                "noise / contrast": float(np.mean([r.edges[kind].noise for r in runs])),
            }
            for kind in KINDS
        ]
    )


def _edge_beside_grating(runs: list[Any], waves: list[Any], kind: str) -> dict[str, Any]:
    edge = np.interp(frequencies(waves), FREQUENCY_LPMM, mean_curve(runs, kind))
    both = zip(frequencies(waves), edge, mean_gratings(waves, kind), strict=True)
    told = {f"{at:g}": f"{one:.2f} / {round(other, 2) + 0.0:.2f}" for at, one, other in both}
    return {"edge / grating at LP/mm": kind} | told


def _box_section(page: Page, found: Reproduction) -> None:
    page.heading("The four boxes")
    run = found.boxes[0]
    shown = {
        label: {channel: _doubled(image) for channel, image in images.items()}
        for label, images in run.images.items()
    }
    page.figure(
        shots_figure(shown, "Four boxes, amplitude and distance"),
        "Figure 6: the boxes in one frame, reconstructed in two branches, as phasors, and as "
        "pixels of half the size would see them.",
    )
    profiles: dict[str, dict[str, Any]] = {"amplitude": {}, "distance (m)": {}}
    for label, images in run.images.items():
        for axis, channel in (("amplitude", "amplitude"), ("distance (m)", "distance")):
            if channel not in images or (channel == "amplitude" and label == "phasor branch"):
                continue
            image = images[channel]
            per_px = image.shape[1] // found.boxes[0].images["one frame"]["amplitude"].shape[1]
            cols = np.arange(_COLS[0] * per_px, _COLS[1] * per_px)
            # The content of the first frame lies a quarter pixel to the left.
            moved_px = named_pattern_px("square")[0, 1] if per_px == 1 else 0.0
            place_px = (cols + 0.5) / per_px - 0.5 - moved_px
            profiles[axis][label] = (place_px, image[_ROW * per_px, cols])
    page.figure(
        profiles_figure(profiles, "Across the left small cube"),
        "Figure 7: one line of the images above.",
    )
    page.text("Errors of the distance against the truth, by draw, in millimetres:")
    places = (("edge", "edge_rmse_m"), ("elsewhere", "flat_rmse_m"))
    rows: list[dict[str, Any]] = [{"draw": number} for number in range(len(found.depth))]
    for row, one in zip(rows, found.depth, strict=True):
        for (where, key), branch in product(places, ("distance", "phasor")):
            row[f"{where}, {branch} branch"] = 1e3 * one[branch][key]
    page.table(rows)


def _gradient_section(page: Page, found: Reproduction) -> None:
    page.heading("Amplitude twice, distance three times: the open question")
    page.text(
        "A leaning strip before a wall shows its edge at 64 places within a pixel. For each line "
        "the slope between the paper's limits is compared with that of one frame. A single line "
        "may give almost any ratio; the mean and its interval do not depend on luck."
    )
    page.figure(
        gains_figure(found.gradients, BRANCHES, "Gain of the gradient by strip"),
        "Contrast of strip to wall in amplitude, width of the strip in LR pixels, SNR of one "
        "frame. Dashed: the paper's three.",
    )
    rows = []
    for row in found.gradients:
        told = {"contrast": row["contrast"], "width (px)": row["width_px"], "SNR": row["snr"]}
        for branch in BRANCHES:
            told[f"{branch} gain"] = row[branch]["mean"]
            told[f"{branch} above 3"] = row[branch]["above_three"]
        rows.append(told | {"step seen by one frame": row["distance"]["reach"]})
    page.table(rows)


def _beyond_section(page: Page, found: Reproduction) -> None:
    page.heading("Beyond the paper")
    for name, rows in found.beyond.items():
        page.text(_TABLES[name])
        page.table([{_in_words(key): value for key, value in row.items()} for row in rows])
        page.text(remark(name, rows))


def _in_words(key: str) -> str:
    """Return the name of a number of a table with its unit, as people write them."""
    name, _, unit = key.rpartition("_")
    return f"{name} ({_UNITS[unit]})".replace("_", " ") if unit in _UNITS else key.replace("_", " ")


def _doubled(image: Any) -> Any:
    """Return an image of single pixels as large as those of half pixels."""
    return np.kron(image, np.ones((2, 2))) if image.shape[0] < 20 else image
