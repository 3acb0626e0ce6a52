"""What becomes of a lens as it is built: many builds at once, each refocused."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from lensshift.core.arrays import Floats
from lensshift.core.errors import warn_quality
from lensshift.core.grid import Grid
from lensshift.optics.lens import Lens
from lensshift.optics.paraxial import paraxial
from lensshift.optics.pupil import pupil_quadrature
from lensshift.optics.refocus import COARSE, FocusScan
from lensshift.optics.shift import decenter_for_shift
from lensshift.optics.spots import obstruction
from lensshift.optics.trace import Build, trace
from lensshift.optics.which import DIAGONALS, POSITIONS, edge_fields, judged_lpmm

# Rings of rays: a build gets more until none of its MTF changes by as much.
_RINGS, _SURE = (3, 4, 6, 9, 14, 20), 5e-3
# Builds with less have hardly any contrast, and get no more than a few rays: most of the time would
# go into how little it is. ROUGH is the most it was off, of 144 builds of eight lenses.
ROUGH_BELOW, ROUGH, _FEW_RINGS = 0.1, 0.1, 6
_CHUNK = 100  # builds looked at at once
_MOST_RAYS = 1e6  # traced at once
# Rows of the random numbers [build row element] that each tolerance uses.
_KINDS = {"decentre": (0, 1), "tilt": (2, 3), "gap": (4,), "focal length": (5,), "index": (6,)}
_OF_GLASS = ("focal length", "index")  # what mirrors do not have
_ROWS = 7


@dataclass(frozen=True, slots=True)
class Tolerances:
    """How far each element may be off: limits of even distributions about the nominal value.

    Parameters
    ----------
    decenter_mm : along rows and along columns
    tilt_rad : towards rows and towards columns; not of mirrors, which turn what is behind them
    gap_mm : of the air between elements
    focal_share : of the focal length, as a share of it; taken as a change of index - 1, so that
        mirrors keep theirs
    index : of the refractive index of the glass

    Raises
    ------
    ValueError
        If a limit is negative or not finite.
    """

    decenter_mm: float = 0.05
    tilt_rad: float = math.radians(0.1)
    gap_mm: float = 0.05
    focal_share: float = 0.01
    index: float = 0.0005

    def __post_init__(self) -> None:
        limits = (self.decenter_mm, self.tilt_rad, self.gap_mm, self.focal_share, self.index)
        if not all(math.isfinite(limit) and limit >= 0 for limit in limits):
            raise ValueError(f"expected limits of at least 0, got {limits}")


@dataclass(frozen=True, slots=True, eq=False)
class ToleranceResult:
    """What many builds of a lens do.

    Positions are that at rest and the four diagonal moves; fields are the centre, the ends of the
    axes and the corners of the sensor.

    Parameters
    ----------
    frequency_lpmm : of the MTF
    mtf : [build position field azimuth], azimuths 0, 45, 90 and 135 degrees
    shift_px : [build move field 2] (row, col) of the image from rest
    refocus_mm : [build] how far the sensor was moved away from the lens
    nominal_mtf : [position field azimuth] of the lens as drawn, refocused in the same way
    nominal_shift_px : [move field 2]
    """

    frequency_lpmm: float
    mtf: Floats
    shift_px: Floats
    refocus_mm: Floats
    nominal_mtf: Floats
    nominal_shift_px: Floats

    @property
    def worst_mtf(self) -> Floats:
        """[build] least MTF over positions, fields and azimuths."""
        return np.asarray(self.mtf.min(axis=(1, 2, 3)))

    @property
    def shift_error_px(self) -> Floats:
        """[build] largest distance from the shifts of the lens as drawn."""
        error = np.linalg.norm(self.shift_px - self.nominal_shift_px, axis=-1)
        return np.asarray(error.max(axis=(1, 2)))

    def yield_at(self, mtf: float) -> float:
        """Return the share of builds whose MTF is nowhere below a limit."""
        return float(np.mean(self.worst_mtf >= mtf))

    def percentiles(self, percent: tuple[float, ...] = (5.0, 50.0, 95.0)) -> tuple[float, ...]:
        """Return percentiles of the least MTF of a build."""
        return tuple(float(value) for value in np.percentile(self.worst_mtf, percent))


def tolerance_analysis(
    lens: Lens,
    element: int,
    grid: Grid,
    tolerances: Tolerances,
    *,
    builds: int = 1000,
    seed: int = 0,
    shift_px: float = 0.25,
    frequency_lpmm: float | None = None,
    refocus_mm: float = math.inf,
    on_progress: Callable[[int, int], None] | None = None,
) -> ToleranceResult:
    """Return the sharpness and the shifts of randomly built lenses (Monte Carlo).

    Each element of each build is off by evenly distributed random amounts within the tolerances;
    then the sensor is moved to where the least MTF over the field and all positions of the
    moving element is largest.
    The moving element is driven as the lens as drawn needs it.

    Parameters
    ----------
    element : number of the one that moves, from 0
    grid : of the sensor
    builds : how many
    seed : of the random numbers
    shift_px : by which the image is moved along both axes
    frequency_lpmm : of the MTF; by default the Nyquist frequency of twice as many pixels
    refocus_mm : how far the sensor may move either way; as far as it must by default
    on_progress : is told how many builds of how many are done

    Raises
    ------
    ValueError
        If a number is out of range, or as in `decenter_for_shift`.

    Warns
    -----
    QualityWarning
        If builds would need more than `refocus_mm`, or mirrors are left untilted.
    """
    if builds < 1:
        raise ValueError(f"expected at least 1 build, got {builds}")
    bench = _Bench(lens, element, grid, shift_px, frequency_lpmm, refocus_mm)
    drawn = bench.measure(_deviations(lens, Tolerances(0, 0, 0, 0, 0), np.zeros((1, _ROWS, 1))))
    rng = np.random.default_rng(seed)
    draws = rng.uniform(-1.0, 1.0, (builds, _ROWS, len(lens.elements)))
    parts = []
    for start in range(0, builds, _CHUNK):
        chunk = draws[start : start + _CHUNK]
        parts.append(bench.measure(_deviations(lens, tolerances, chunk)))
        if on_progress is not None:
            on_progress(start + len(chunk), builds)
    mtf, moved_px, away_mm = (np.concatenate(values) for values in zip(*parts, strict=True))
    if tolerances.tilt_rad and any(one.folds for one in lens.elements):
        warn_quality("no mirror is tilted: all behind it, which is drawn unfolded, would turn too")
    beyond = int(np.sum(np.abs(away_mm) > refocus_mm - bench.coarse_mm))
    if beyond:
        warn_quality(
            f"{beyond} of {builds} builds would need a refocus of more than {refocus_mm} mm"
        )
    return ToleranceResult(bench.frequency_lpmm, mtf, moved_px, away_mm, drawn[0][0], drawn[1][0])


@dataclass(frozen=True, slots=True)
class Sensitivity:
    """What one tolerance of one element does at its limit.

    Parameters
    ----------
    kind : decentre, tilt, gap, focal length or index
    element : its number, from 0; a gap is behind it
    name : of the element
    mtf_loss : fall of the least MTF, worst sign and direction, after refocus
    shift_error_px : largest change of a shift
    refocus_mm : largest distance the sensor was moved, against the lens as drawn
    """

    kind: str
    element: int
    name: str
    mtf_loss: float
    shift_error_px: float
    refocus_mm: float


def sensitivity_table(
    lens: Lens,
    element: int,
    grid: Grid,
    tolerances: Tolerances,
    *,
    shift_px: float = 0.25,
    frequency_lpmm: float | None = None,
    refocus_mm: float = math.inf,
) -> tuple[Sensitivity, ...]:
    """Return what each tolerance of each element does alone, the largest MTF loss first.

    Each is set to its limits: both signs, and for decentre and tilt all four corners of the
    square. Parameters as in `tolerance_analysis`.

    Raises
    ------
    ValueError
        As in `tolerance_analysis`.
    """
    bench = _Bench(lens, element, grid, shift_px, frequency_lpmm, refocus_mm)
    count = len(lens.elements)
    cases, draws = [("", 0)], [np.zeros((_ROWS, count))]
    for kind, number in product(_KINDS, range(count)):
        one, last_gap = lens.elements[number], kind == "gap" and number == count - 1
        if last_gap or (kind in _OF_GLASS and not one.glass) or (kind == "tilt" and one.folds):
            continue
        for signs in product((-1.0, 1.0), repeat=len(_KINDS[kind])):
            cases.append((kind, number))
            draws.append(np.zeros((_ROWS, count)))
            draws[-1][list(_KINDS[kind]), number] = signs
    mtf, moved_px, away_mm = bench.measure(_deviations(lens, tolerances, np.array(draws)))
    loss = mtf[0].min() - mtf.min(axis=(1, 2, 3))
    error_px = np.linalg.norm(moved_px - moved_px[0], axis=-1).max(axis=(1, 2))
    table = []
    for kind, element in dict.fromkeys(cases[1:]):
        mine = [number for number, one in enumerate(cases) if one == (kind, element)]
        worst = (float(of[mine].max()) for of in (loss, error_px, np.abs(away_mm - away_mm[0])))
        table.append(Sensitivity(kind, element, lens.elements[element].name, *worst))
    return tuple(sorted(table, key=lambda row: -row.mtf_loss))


def format_sensitivity(table: tuple[Sensitivity, ...]) -> str:
    """Return the table of `sensitivity_table` as lines of text."""
    lines = ["tolerance     element               MTF loss  shift error   refocus"]
    lines += [
        f"{row.kind:<13} {row.element + 1} {row.name:<18.18} {row.mtf_loss:9.4f} "
        f"{row.shift_error_px:9.5f} px {row.refocus_mm:6.3f} mm"
        for row in table
    ]
    return "\n".join(lines)


def _deviations(lens: Lens, tolerances: Tolerances, draws: Floats) -> Build:
    """Return builds [build 1 1] from numbers [build row element] in -1 .. 1."""
    draws = np.broadcast_to(draws, (*draws.shape[:2], len(lens.elements)))
    gap_mm = tolerances.gap_mm * draws[:, 4]
    gap_mm[:, -1] = 0.0  # the sensor is refocused anyway
    # The mean index of an element tells how n - 1 follows from a change of n.
    power = np.array([np.mean(of) - 1.0 if of else math.inf for of in lens.indices()])
    factor = 1.0 / (1.0 + tolerances.focal_share * draws[:, 5])
    factor = factor + tolerances.index * draws[:, 6] / power
    turning = np.array([[not one.folds] for one in lens.elements])
    spread = (slice(None), None, None)
    return Build(
        decenter_mm=tolerances.decenter_mm * np.moveaxis(draws[:, 0:2], 1, -1)[spread],
        tilt_rad=tolerances.tilt_rad * (turning * np.moveaxis(draws[:, 2:4], 1, -1))[spread],
        gap_mm=gap_mm[spread],
        index_factor=factor[spread],
    )


class _Bench:
    """Measures builds of one lens: MTF and shifts after refocusing each."""

    def __init__(
        self,
        lens: Lens,
        element: int,
        grid: Grid,
        shift_px: float,
        frequency_lpmm: float | None,
        refocus_mm: float,
    ) -> None:
        if not (shift_px > 0 and refocus_mm > 0):
            raise ValueError(
                f"expected positive shift_px and refocus_mm, got {shift_px} and {refocus_mm}"
            )
        self.lens, self.pitch_mm = lens, np.asarray(grid.pitch_mm)
        self.frequency_lpmm, self.refocus_mm = judged_lpmm(grid, frequency_lpmm), refocus_mm
        self.coarse_mm = COARSE * (paraxial(lens).working_f_number / self.frequency_lpmm)
        self.fields = edge_fields(lens, grid)
        self.moves = np.zeros((len(POSITIONS), 1, len(lens.elements), 2))
        self.moves[1:, 0, element] = decenter_for_shift(lens, element, shift_px * DIAGONALS, grid)
        self.inner = obstruction(lens)

    def measure(self, build: Build) -> tuple[Floats, Floats, Floats]:
        """Return MTF [build position field azimuth], shifts [build move field 2], refocus."""
        moved = self.moves if build.decenter_mm is None else build.decenter_mm + self.moves
        build = replace(build, decenter_mm=moved)
        look = self._look(build, _RINGS[0])
        away_mm = look.sharpest_mm(self.refocus_mm)
        mtf, at_mm = look.at(away_mm)
        left = np.arange(len(away_mm))
        for rings in _RINGS[1:]:
            at_once = max(1, int(_MOST_RAYS / (mtf[0, ..., 0].size * 4 * rings**2)))
            parts = np.split(left, range(at_once, len(left), at_once))
            differ = [self._closer(build, one, rings, mtf, at_mm, away_mm) for one in parts]
            left = np.concatenate(differ)
        return mtf, (at_mm[:, 1:] - at_mm[:, :1]) / self.pitch_mm, away_mm

    def _closer(
        self, build: Build, some: NDArray[np.intp], rings: int, mtf: Floats, at_mm: Floats,
        away_mm: Floats,
    ) -> NDArray[np.intp]:  # fmt: skip
        """Look at some builds with more rays; refocus and return those of which these tell more."""
        if not some.size:
            return some
        look = self._look(_part(build, some), rings)
        found, at_mm[some] = look.at(away_mm[some])
        differs = np.abs(found - mtf[some]).max(axis=(1, 2, 3)) > _SURE
        mtf[some], some = found, some[differs]
        if some.size:
            look = look.part(differs)
            away_mm[some] = look.sharpest_mm(self.refocus_mm)
            mtf[some], at_mm[some] = look.at(away_mm[some])
        if rings >= _FEW_RINGS:
            some = some[mtf[some].min(axis=(1, 2, 3)) > ROUGH_BELOW]
        return some

    def _look(self, build: Build, rings: int) -> FocusScan:
        points, weight = pupil_quadrature(rings, inner=self.inner)
        rays = trace(self.lens, self.fields, points, build=build)
        light = (self.frequency_lpmm, self.lens.wavelength_nm)
        return FocusScan(rays, weight, rings, *light, self.coarse_mm, self.inner)


def _part(build: Build, chosen: NDArray[np.intp]) -> Build:
    """Return some of the builds."""
    parts = (getattr(build, one.name) for one in fields(build))
    return Build(*(None if one is None else one[chosen] for one in parts))
