"""The slanted edge: one frame, bicubic, sensor shift and lens shift against the limits."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lensshift.camera import named_pattern_px, simulate_tof
from lensshift.evaluation.gain import ratio_of, resolution_gain
from lensshift.evaluation.limits import pixel_aperture_mtf
from lensshift.evaluation.slanted_edge import EdgeResult
from lensshift.pipeline.paper.bench import CARD_LIGHT, PITCH_MM, SHIFT_ERROR_PX, paper_camera
from lensshift.pipeline.paper.claims import Claim, pooled_interval, span
from lensshift.pipeline.paper.measure import as_published, measured_edge, reconstructed
from lensshift.scene import slanted_edge_card

Floats = NDArray[np.float64]

SNR = 50.0
FREQUENCY_LPMM = np.linspace(0.0, 8.0, 81)
KINDS = ("one frame", "bicubic", "sensor shift", "lens shift", "lens shift, as published")
_TO_LPMM = 6.0


@dataclass(frozen=True, slots=True, eq=False)
class EdgeRun:
    """One draw of noise and shift errors.

    Parameters
    ----------
    edges : kind -> measurement
    images : kind -> [row col]
    """

    edges: dict[str, EdgeResult]
    images: dict[str, Floats]


def take_edge(seed: int) -> EdgeRun:
    """Simulate the edge card with both ways of shifting, and measure all images of it."""
    images: dict[str, Floats] = {}
    for kind, element in (("lens shift", 0), ("sensor shift", None)):
        capture = simulate_tof(
            slanted_edge_card(),
            paper_camera(SNR, CARD_LIGHT, CARD_LIGHT, optics="petzval_a", element=element),
            named_pattern_px("square"),
            shift_error_px=SHIFT_ERROR_PX,
            seed=seed,
        )
        burst = capture.burst
        images[kind] = reconstructed(burst, "amplitude")["amplitude"]
        if element is None:
            continue
        images["one frame"] = np.asarray(burst.amplitude[0])
        alone = burst.select((0,))
        images["bicubic"] = reconstructed(alone, "amplitude", method="bicubic")["amplitude"]
        images["lens shift, as published"] = as_published(burst)
    edges = {
        kind: measured_edge(images[kind], 1 if kind == "one frame" else 2, FREQUENCY_LPMM)
        for kind in KINDS
    }
    return EdgeRun(edges, {kind: images[kind] for kind in KINDS})


def edge_claims(runs: list[EdgeRun]) -> list[Claim]:
    """Return the claims of the paper's second experiment."""
    return [
        _frame_at_limit(runs),
        _bicubic_below(runs),
        _both_shifts_equal(runs),
        _near_half_pixel(runs),
        _width(runs),
    ]


def mean_curve(runs: list[EdgeRun], kind: str) -> Floats:
    """Return the MTF of a kind at `FREQUENCY_LPMM`, averaged over the runs."""
    return np.asarray(np.mean([run.edges[kind].mtf.modulation for run in runs], axis=0))


def limit(share: float, angle_rad: float = np.deg2rad(10.0)) -> Floats:
    """Return what a pixel of a share of the pitch lets through along the normal of the edge."""
    return pixel_aperture_mtf(FREQUENCY_LPMM, share * PITCH_MM, angle_rad=angle_rad)


def _frame_at_limit(runs: list[EdgeRun]) -> Claim:
    upto = FREQUENCY_LPMM <= 4.0
    away = [
        float(np.sqrt(np.mean((run.edges["one frame"].mtf.modulation - limit(1.0))[upto] ** 2)))
        for run in runs
    ]
    mean, interval = float(np.mean(away)), span(away)
    apart = (mean_curve(runs, "one frame") - limit(1.0))[~upto]
    beyond = float(np.sqrt(np.mean(apart**2)))
    return Claim(
        id="frame-at-full-pixel-limit",
        statement="The MTF of one frame is close to the limit of a full pixel and leaves it near "
        "4 LP/mm.",
        paper="close up to 4 LP/mm (figure 5)",
        ours=mean,
        interval=interval,
        verdict="qualified" if mean < 0.1 else "refuted",
        why=f"Up to 4 LP/mm it is {mean:.3f} rms from |sinc| along the normal of the edge, and "
        f"from there to 8 LP/mm {beyond:.3f}: it does not leave the limit of a pixel, which is "
        "not the sinc^2 of the paper.",
    )


def _bicubic_below(runs: list[EdgeRun]) -> Claim:
    ratios = [
        ratio_of(run.edges["bicubic"].mtf50_lpmm, run.edges["one frame"].mtf50_lpmm) for run in runs
    ]
    mean, interval = pooled_interval([(r.value, r.low, r.high) for r in ratios])
    return Claim(
        id="bicubic-below-frame",
        statement="Bicubic interpolation is worse than the frame that it interpolates.",
        paper="curve below (figure 5)",
        ours=mean,
        interval=interval,
        verdict="confirmed" if interval[1] < 1 else "refuted" if mean > 1 else "qualified",
        why=f"Its MTF50 is {mean:.3f} times that of the frame: interpolation adds a blur and no "
        "sample.",
    )


def _both_shifts_equal(runs: list[EdgeRun]) -> Claim:
    rms = _rms_apart(mean_curve(runs, "lens shift"), mean_curve(runs, "sensor shift"))
    singles = [
        _rms_apart(run.edges["lens shift"].mtf.modulation, run.edges["sensor shift"].mtf.modulation)
        for run in runs
    ]
    return Claim(
        id="lens-shift-equals-sensor-shift",
        statement="Shifting the lens gives nearly the same MTF as shifting the sensor.",
        paper="curves nearly coincide (figure 5)",
        ours=rms,
        interval=span([rms, *singles]) if len(singles) > 1 else (rms, rms),
        verdict="confirmed" if rms < 0.02 else "qualified",
        why=f"The mean curves are {rms:.4f} rms apart up to {_TO_LPMM:g} LP/mm (single bursts: "
        f"{min(singles):.4f} to {max(singles):.4f}), with the lens traced surface by surface.",
    )


def _rms_apart(one: Floats, other: Floats) -> float:
    upto = FREQUENCY_LPMM <= _TO_LPMM
    return float(np.sqrt(np.mean((one - other)[upto] ** 2)))


def _near_half_pixel(runs: list[EdgeRun]) -> Claim:
    above = mean_curve(runs, "lens shift") - limit(0.5)
    between = (FREQUENCY_LPMM >= 2.0) & (FREQUENCY_LPMM <= 5.0)
    over = FREQUENCY_LPMM[(above > 0) & (FREQUENCY_LPMM > 0.5)]
    where = _above(runs, "lens shift")
    highest = [
        _highest_above(curve, between) for curve in (run.edges["lens shift"] for run in runs)
    ]
    mean, interval = pooled_interval(highest)
    frame = mean_curve(runs, "one frame")
    upto = (FREQUENCY_LPMM > 0.3) & (FREQUENCY_LPMM <= _TO_LPMM)
    beats = bool(np.all((mean_curve(runs, "lens shift") - frame)[upto] > 0))
    good = interval[1] > 0 and beats  # not told to be below
    where_claimed = over.size and over.min() <= 3.0 and 6.0 <= over.max() < FREQUENCY_LPMM[-1]
    like = interval[0] > 0 and beats and where_claimed
    return Claim(
        id="near-half-pixel-limit",
        statement="The super-resolved MTF is close to the limit of a half pixel, above it from "
        "about 2 to 7 LP/mm, below it beyond.",
        paper="above from 2 to 7 LP/mm (figure 5)",
        ours=mean,
        interval=interval,
        verdict="confirmed" if like else "qualified" if good else "refuted",
        why=f"It lies above the |sinc| of a half pixel at {where}, by up to {mean:.3f} between 2 "
        "and 5 LP/mm"
        + (" and above one frame everywhere up to 6 LP/mm" if beats else "")
        + f"; the published solver does so at {_above(runs, 'lens shift, as published')}.",
    )


def _highest_above(edge: EdgeResult, where: NDArray[np.bool_]) -> tuple[float, float, float]:
    """Return how far a curve gets above half a pixel's limit, with the ends of its band there."""
    above = (edge.mtf.modulation - limit(0.5))[where]
    at = int(np.argmax(above))
    if edge.low is None or edge.high is None:
        return float(above[at]), float("nan"), float("nan")
    low, high = ((band - limit(0.5))[where][at] for band in (edge.low, edge.high))
    return float(above[at]), float(low), float(high)


def _above(runs: list[EdgeRun], kind: str) -> str:
    """Say where a mean curve is above the limit of a half pixel."""
    over = FREQUENCY_LPMM[(mean_curve(runs, kind) > limit(0.5)) & (FREQUENCY_LPMM > 0.5)]
    return f"{over.min():.1f} to {over.max():.1f} LP/mm" if over.size else "no frequency"


def _width(runs: list[EdgeRun]) -> Claim:
    gains = [resolution_gain(run.edges["lens shift"], run.edges["one frame"]) for run in runs]
    mean, interval = pooled_interval(
        [(gain.width.value, gain.width.low, gain.width.high) for gain in gains]
    )
    noise = float(np.mean([gain.noise for gain in gains]))
    return Claim(
        id="resolution-nearly-doubles",
        statement="Four shifted frames resolve nearly what a sensor of half the pixel pitch would.",
        paper="about 2",
        ours=mean,
        interval=interval,
        verdict="confirmed" if interval[0] >= 1.9 else "qualified" if mean > 1.5 else "refuted",
        why=f"The 10-90 width of the edge is {mean:.2f} times narrower than in one frame, and the "
        f"noise of a pixel on the plateaus {noise:.2f} times that of a frame.",
    )
