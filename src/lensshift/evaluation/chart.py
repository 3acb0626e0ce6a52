"""Many edges of photographs as one lens: over the field, through focus, as an eye sees it."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from scipy.special import ndtri, stdtrit

from lensshift.core.arrays import Floats
from lensshift.core.optical import MtfCurve
from lensshift.evaluation.slanted_edge import EdgeResult, Interval, average_interval

Direction = Literal["sagittal", "tangential"]
DIRECTIONS: tuple[Direction, ...] = ("sagittal", "tangential")

# Zones of the field, by distance from the middle over half the diagonal.
ZONES = (("centre", 0.0, 0.3), ("part way", 0.3, 0.7), ("corners", 0.7, 1.01))
# Contrast sensitivity of the eye in the acutance of CPIQ (IEEE 1858), f^c exp(-b f) up to a
# factor, f in cycles per degree.
_EYE_POWER, _EYE_FALL = 0.8, 0.2
_MOST_CPD, _CPD_STEP = 80.0, 0.05
_UPPER = 0.975  # the upper end of a 95 % interval
_LEAN, _FLAT = 0.3, 0.5  # spreads of both over lenses, of the fall of MTF50 to 0.7
_LEAST_LEANING = 6  # photographs: two are left over of a cubic


@dataclass(frozen=True, slots=True, eq=False)
class ChartEdge:
    """One edge, and where in the field it lies.

    Parameters
    ----------
    result : the measurement
    image : name of the photograph
    focus : of the photograph: position of the focus, in any unit, or its number
    row_px, col_px : middle of the edge
    field : its distance from the middle of the image over half the diagonal
    direction : "sagittal" if the lines that it measures point to the middle, else "tangential"
    """

    result: EdgeResult
    image: str
    focus: float
    row_px: float
    col_px: float
    field: float
    direction: Direction


def chart_edges(
    results: Sequence[EdgeResult], shape: tuple[int, int], *, image: str = "", focus: float = 0.0
) -> list[ChartEdge]:
    """Return the edges of an image of a shape (rows, cols) with their places in the field.

    Lines that point to the middle (sagittal) are blurred across the radius: edges along the radius
    measure them, edges across it the tangential ones.
    """
    rows, cols = shape
    half = 0.5 * np.hypot(rows, cols)
    edges = []
    for one in results:
        row_px, col_px = one.middle_px
        away = np.array([row_px - 0.5 * (rows - 1), col_px - 0.5 * (cols - 1)])
        radius, turn = float(np.hypot(*away)), one.angle_rad.value
        along = np.array([np.cos(turn), -np.sin(turn)])  # col = -row tan(turn)
        along = along if one.orientation == "vertical" else along[::-1]
        share = abs(float(along @ away)) / radius if radius > 0 else 1.0
        direction: Direction = "sagittal" if share >= np.sqrt(0.5) else "tangential"
        edges.append(ChartEdge(one, image, focus, row_px, col_px, radius / half, direction))
    return edges


def modulation_at(curve: MtfCurve, frequency_lpmm: float) -> Interval:
    """Return the modulation of a curve at a frequency, with its 95 % interval; NaN beyond it."""
    if not 0.0 <= frequency_lpmm <= curve.frequency_lpmm[-1]:
        return Interval(float("nan"))
    value = float(np.interp(frequency_lpmm, curve.frequency_lpmm, curve.modulation))
    if curve.std is None:
        return Interval(value)
    half = 1.96 * float(np.interp(frequency_lpmm, curve.frequency_lpmm, curve.std))
    return Interval(value, max(value - half, 0.0), value + half)


def acutance(curve: MtfCurve, height_mm: float, eye_heights: float) -> float:
    """Return how sharp a whole picture looks, 0 to 1 (more if it is sharpened).

        A = integral of MTF(f) C(f) df / integral of C(f) df,   C(f) = f^0.8 exp(-0.2 f)

    with f in cycles per degree at the eye: a picture of height H (in the unit of the curve), seen
    from n H, has f = frequency H n pi / 180. Without the frame and the print: those of the display
    are 1. The curve is 0 beyond its last frequency. ValueError if a length is not positive.

    Source: IEEE 1858 (CPIQ), contrast sensitivity and acutance.
    """
    if not (height_mm > 0 and eye_heights > 0):
        raise ValueError(f"expected positive lengths, got {height_mm} and {eye_heights}")
    per_degree = np.arange(0.0, _MOST_CPD, _CPD_STEP)
    eye = per_degree**_EYE_POWER * np.exp(-_EYE_FALL * per_degree)
    frequency_lpmm = per_degree / (height_mm * eye_heights * np.pi / 180.0)
    seen = np.interp(frequency_lpmm, curve.frequency_lpmm, curve.modulation, right=0.0)
    return float(np.sum(seen * eye) / np.sum(eye))


def zone_rows(edges: Sequence[ChartEdge]) -> list[dict[str, Any]]:
    """Return the summary over the field: usable edges, mean, spread of each zone and direction.

    The interval of `mtf50_lpmm` holds the scatter of the places; a single edge keeps its own.
    """
    rows = []
    for zone, low, high in ZONES:
        for direction in DIRECTIONS:
            here = [
                one.result.mtf50_lpmm
                for one in edges
                if one.result.usable and one.direction == direction and low <= one.field < high
            ]
            if here:
                row = {"zone": zone, "direction": direction, "edges": len(here)}
                known = [one.value for one in here if np.isfinite(one.value)]
                worst = min(known, default=float("nan"))  # of edges too sharp to fall to a half
                told = {"mtf50_lpmm": average_interval(here), "worst_mtf50_lpmm": worst}
                rows.append(row | told)
    return rows


@dataclass(frozen=True, slots=True)
class FocusFit:
    """Where the MTF50 of a series of photographs is largest.

    Parameters
    ----------
    focus, sigma : place, and its standard error by the scatter about the curve; of three
        photographs by their own errors
    low, high : 95 % interval; NaN where nothing tells it
    mtf50_lpmm : there
    """

    focus: float
    sigma: float
    low: float
    high: float
    mtf50_lpmm: float

    def __str__(self) -> str:
        return str(Interval(self.focus, self.low, self.high))


def best_focus(
    focus: Sequence[float], mtf50_lpmm: Sequence[float], std_lpmm: Sequence[float] | None = None
) -> FocusFit:
    """Return where a lens is sharpest, from MTF50 at three or more positions of the focus.

    Blur grows with the distance z from the best focus as s^2 = s_0^2 + (k (z - z_0))^2, and MTF50
    is inversely proportional to s: 1 / MTF50^2 is a parabola. It is fitted to the largest MTF50 and
    two neighbours on each side; a parabola through MTF50 itself, which wave optics may be nearer
    to, is taken where it leaves less. More neighbours are taken as long as the interval meets those
    of fewer: the law holds, then. The largest of many photographs is largest by its noise. A
    curve that surely falls faster on one side has the maximum of a cubic; the interval holds by how
    much lenses do so unseen, and what another law would tell: of few photographs it is wide.

    Parameters
    ----------
    focus, mtf50_lpmm : [n] in any order; MTF50 that was not reached is NaN
    std_lpmm : [n] standard errors, which tell the interval of three photographs, and that of four
        where it is the smaller one: one that is left over says little of the scatter

    Raises
    ------
    ValueError
        If there are fewer than three positions, or the largest value is the first or last one.

    Source: Lepski, Theory Probab. Appl. 35 (1991) 454, for the choice of neighbours.
    """
    x, y = np.asarray(focus, dtype=np.float64), np.asarray(mtf50_lpmm, dtype=np.float64)
    std = np.full(len(y), np.nan) if std_lpmm is None else np.asarray(std_lpmm, dtype=np.float64)
    known = np.isfinite(y)
    x, y, std = np.array([x, y, std])[:, known][:, np.argsort(x[known])]
    if len(np.unique(x)) < 3:
        raise ValueError(f"expected three positions of the focus or more, got {len(np.unique(x))}")
    top = int(np.argmax(y))
    if x[top] in (x[0], x[-1]):  # of which there may be several
        raise ValueError("the sharpest photograph is the first or last of the series; go on there")
    fit, low, high = None, -np.inf, np.inf
    for reach in range(2, max(top, len(x) - 1 - top, 2) + 1):
        near = slice(max(top - reach, 0), top + reach + 1)
        used, powers = (x[near], y[near], std[near]), (-2, 1) if y[near].min() > 0.0 else (1,)
        found = [(*_extremum(*used, power), power) for power in powers]
        rest, wider, _, power = min(found, key=lambda one: one[0])
        low, high = np.fmax(low, wider.low), np.fmin(high, wider.high)
        if low > high:
            break
        fit = _leaning(wider, *used, power) if np.isfinite(rest) else fit
    if fit is None:
        raise ValueError("MTF50 has no maximum over the focus")
    return fit


def _leaning(fit: FocusFit, x: Floats, y: Floats, std: Floats, power: int) -> FocusFit:
    """Return the maximum of a cubic where it surely leans; a parabola is then off.

    By how much they differ counts in the interval: the fourth power is not known.
    """
    if len(x) < _LEAST_LEANING:
        return fit
    _, cubic, leans = _extremum(x, y, std, power, degree=3)
    reach = np.hypot(cubic.high - cubic.focus, cubic.focus - fit.focus)
    low, high = cubic.focus - reach, cubic.focus + reach
    return replace(cubic, low=float(low), high=float(high)) if leans else fit


def _extremum(
    x: Floats, y: Floats, std: Floats, power: int, degree: int = 2
) -> tuple[float, FocusFit, bool]:
    """Return what a polynomial through y^power leaves of y, squared, and its maximum.

    And whether its highest power is surely there. Three points leave nothing of a parabola: the
    order of the laws decides. Infinite where y has no maximum.
    """
    middle, span = float(x.mean()), float(np.ptp(x))
    place = (x - middle) / span
    slopes = power * y ** (power - 1)  # of y^power: every y is as well known
    design = np.vander(place, degree + 1)
    solving = np.linalg.pinv(design / slopes[:, None]) / slopes
    law = solving @ y**power
    bend = np.polyder(law, 2)
    tops = [one.real for one in np.roots(np.polyder(law)) if one.imag == 0.0]
    tops = [one for one in tops if np.polyval(bend, one) * power < 0.0]
    at = min(tops, key=lambda one: abs(one - place[np.argmax(y)]), default=np.nan)
    highest = float(np.polyval(law, at))
    if np.isnan(at) or (power < 0 and highest <= 0.0):
        return np.inf, FocusFit(*5 * [np.nan]), False
    left, free = (y**power - design @ law) / slopes, len(x) - degree - 1
    rest = float(left @ left) if free else 0.0
    scatter = np.sqrt(rest / free) if free else np.nan
    powers = np.arange(degree, -1, -1)
    lean = powers * at ** np.maximum(powers - 1, 0) / np.polyval(bend, at) @ solving * slopes
    own = span * float(np.sqrt(lean**2 @ std**2))
    sigma = span * float(np.linalg.norm(lean)) * scatter if free else own
    many = stdtrit(free, _UPPER) if free else np.nan
    half = many * sigma
    half = np.fmin(half, stdtrit(np.inf, _UPPER) * own) if free < 2 else half
    if degree == 2:  # what one side of a lens steeper than the other, and another law, would move
        fall = (0.5 ** (0.5 * power) - 1.0) * highest
        away = (place - at) * np.sqrt(law[0] / fall)
        terms = _LEAN * away**3 / np.hypot(1.0, away), _FLAT * away**4 / (1.0 + away**2)
        moved = fall * (lean / slopes) @ np.transpose(terms)
        half = np.hypot(half, stdtrit(np.inf, _UPPER) * span * float(np.linalg.norm(moved)))
    focus, there = middle + span * float(at), float(highest ** (1.0 / power))
    fit = FocusFit(focus, float(sigma), float(focus - half), float(focus + half), there)
    return rest, fit, bool(abs(law[0]) > many * scatter * np.linalg.norm(solving[0] * slopes))


def rises_again(x: Floats, y: Floats, std: Floats) -> tuple[float, float] | None:
    """Return two places, the outer one sharper than the inner by more than their errors.

    Blur only grows on either side of the focus. Chance finds none in 99 of 100 series.
    """
    top, pairs = int(np.argmax(y)), itertools.combinations(np.argsort(x), 2)
    least = float(ndtri(1.0 - 0.01 / len(x) ** 2))
    for one, other in pairs:
        inner, outer = (one, other) if x[one] >= x[top] else (other, one)
        between = (x[one] - x[top]) * (x[other] - x[top]) >= 0.0
        if between and y[outer] - y[inner] > least * np.hypot(std[inner], std[outer]):
            return float(x[inner]), float(x[outer])
    return None


def edge_rows(
    edges: Sequence[ChartEdge], at_lpmm: Sequence[float] = (), factor: float = 1.0
) -> Iterator[dict[str, Any]]:
    """Yield a flat row for each edge, frequencies times `factor`; no name of a column says that."""
    for one in edges:
        found = one.result
        row: dict[str, Any] = {"image": one.image, "focus": one.focus}
        row |= {"row_px": one.row_px, "col_px": one.col_px, "field": one.field}
        row |= {"direction": one.direction, "orientation": found.orientation}
        row |= {"angle_deg": float(np.rad2deg(found.angle_rad.value))}
        for name in ("mtf50", "mtf30", "mtf10"):
            row |= _three(name, getattr(found, f"{name}_lpmm").scaled(factor))
        row |= {"mtf_at_nyquist": found.mtf_at_nyquist.value, "contrast": found.contrast}
        row |= {"snr": found.snr, "beyond_nyquist": found.beyond_nyquist, "usable": found.usable}
        for at in at_lpmm:
            row |= _three(f"mtf_at_{at * factor:g}", modulation_at(found.mtf, at))
        yield row | {"notes": "; ".join(found.notes)}


def _three(name: str, number: Interval) -> dict[str, float]:
    return {name: number.value, f"{name}_low": number.low, f"{name}_high": number.high}
