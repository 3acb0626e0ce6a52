"""Design by least squares of ray errors: curvatures, thicknesses, gaps and aspheres at once."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np

from lensshift.core.arrays import Floats
from lensshift.core.errors import warn_quality
from lensshift.optics.lens import Lens, Surface
from lensshift.optics.mtf import light_of
from lensshift.optics.paraxial import paraxial
from lensshift.optics.pupil import pupil_quadrature
from lensshift.optics.sequential import trimmed
from lensshift.optics.task import Task
from lensshift.optics.trace import RayBundle, trace
from lensshift.optics.variables import Freedom, Variables

_RINGS, _ARMS = 4, 12  # of rays; the half of them that is traced
_RIM = np.array([[0.0, 1.0], [0.0, -1.0], [1.0, 0.0]])  # rays that tell how wide surfaces are
_SHARE_OF_PITCH = 0.1  # a ray error that counts as 1
_PER_MM, _PER_SHARE = 300.0, 1000.0  # what a limit costs that is missed by so much
_LOST_PITCHES = 30.0  # what a ray counts that does not arrive
_STEP = 1e-6  # of a variable, whose unit is a large step; far above rounding
_ROOM = 1.03  # of a surface over its highest ray
_AIM_STEPS, _MOST_AIM = 4, 1.1  # of fields, and by how much each at most
_KEPT = 0.01  # of a focal length or a track: missed by more it is another lens
_STEEPEST = 0.85  # sine of the largest slope of a surface


def refine(
    lens: Lens,
    task: Task,
    freedom: Freedom,
    *,
    grow: tuple[float, ...] = (1.0,),
    steps: int = 60,
    on_progress: Callable[[int, int], None] | None = None,
) -> Lens:
    """Return the lens with the least ray errors that can be reached from a starting form.

        minimise  sum w |x - x_mean|^2 / (0.1 pitch)^2  + what missed limits cost

    over fields from the centre to the corner, wavelengths, temperatures and rays through the stop;
    x_mean is the centroid of all wavelengths of a field, so colours must fall together too. All
    is symmetric about the axis; decentres and tilts of the lens are left out.

    Parameters
    ----------
    lens : the starting form; elements that are not free keep their shape and edges
    task : what it has to do
    freedom : what may change
    grow : shares of aperture and field to go through, each from what the one before found; a rough
        form needs to begin with less
    steps : of the solver, each time
    on_progress : is told how many stages of how many are done

    Returns
    -------
    the lens, its surfaces as wide as its rays need and its stop as the f-number wants

    Raises
    ------
    ValueError
        If nothing may change, no ray of the starting form arrives, or `grow` does not rise to 1
        at most.

    Warns
    -----
    QualityWarning
        If the lens does not keep focal length, track or the light of a field, as where the limits
        leave no room for it.

    Source: D. P. Feder, Appl. Opt. 2 (1963) 1209.
    """
    from scipy.optimize import least_squares

    if not grow or list(grow) != sorted(grow) or not 0 < grow[0] <= grow[-1] <= 1:
        raise ValueError(f"expected rising shares of aperture and field up to 1, got {grow}")
    straight = (replace(one, decenter_mm=(0.0, 0.0), tilt_rad=(0.0, 0.0)) for one in lens.elements)
    plain = replace(lens, elements=tuple(straight))
    for done, share in enumerate(grow, start=1):
        bench = _Bench(plain, task, freedom, share)
        start = bench.variables.start()
        if not np.any(np.abs(bench.errors(start)) < bench.lost):
            raise ValueError("expected a starting form that light gets through, got none")
        found = least_squares(
            bench.errors, start, jac=bench.slopes, x_scale="jac", method="trf", max_nfev=steps
        )
        plain = bench.finished(found.x) if done == len(grow) else bench.open(found.x)
        if on_progress is not None:
            on_progress(done, len(grow))
    tell_missed(plain, task)
    return plain


def tell_missed(lens: Lens, task: Task) -> None:
    """Warn of what a lens that was found does not keep."""
    missed, focal_mm = [], paraxial(lens).focal_length_mm
    if abs(focal_mm / task.focal_length_mm - 1.0) > _KEPT:
        missed.append(f"its focal length is {focal_mm:.4g} mm, not {task.focal_length_mm:g} mm")
    long_mm = float(lens.positions_mm()[-1])
    if long_mm > task.limits.track_mm * (1.0 + _KEPT):
        missed.append(f"it is {long_mm:.4g} mm long, not {task.limits.track_mm:g} mm")
    dark = int(np.sum(np.isinf(ray_error_um(lens, task))))
    if dark:
        missed.append(f"{dark} of {len(task.shares)} fields are dark")
    if missed:
        warn_quality(
            f"the lens found is not the one wanted: {'; '.join(missed)}. Are limits and form fit "
            "for it, and steps enough?",
            stacklevel=3,
        )


def ray_error_um(lens: Lens, task: Task) -> Floats:
    """Return the rms distance of rays from the centroid of each field, all wavelengths, [field].

    At the worst temperature of the task; infinite where no ray arrives.

    Parameters
    ----------
    lens : as it is; its stop is taken as wide as the f-number wants
    task : fields, light and temperatures
    """
    bench = _Bench(lens, task, Freedom(), 1.0)
    spread = []
    for warm in bench.at_temperatures(bench.stopped(lens)):
        error_mm, _, _ = bench.traced(warm)
        dark = np.isnan(error_mm).all(axis=(0, 2, 3))
        spread.append(1e3 * np.sqrt(np.where(dark, np.inf, np.nansum(error_mm**2, axis=(0, 2, 3)))))
    return np.asarray(np.max(spread, axis=0))


def merit(lens: Lens, task: Task, freedom: Freedom, share: float = 1.0) -> float:
    """Return what `refine` makes least of a lens, at a share of aperture and field."""
    bench = _Bench(lens, task, freedom, share)
    return float(np.sum(bench.errors(bench.variables.start()) ** 2))


class _Bench:
    """Ray errors and missed limits of lenses by their vectors."""

    def __init__(self, lens: Lens, task: Task, freedom: Freedom, share: float) -> None:
        self.task, self.share = task, share
        points, weight = pupil_quadrature(_RINGS, _ARMS)
        half = points[:, 0] > 0  # the other half is its mirror image
        self.points = np.concatenate([points[half], _RIM])
        self.weight = np.concatenate([2.0 * weight[half], np.zeros(len(_RIM))])
        self.light = light_of(task.band, lens.wavelength_nm)
        self.half_mm = 0.5 * float(np.hypot(*np.multiply(task.grid.shape, task.grid.pitch_mm)))
        self.unit_mm = _SHARE_OF_PITCH * min(task.grid.pitch_mm)
        self.count = 1  # of errors; known from the first form that has some
        self.lost = _LOST_PITCHES / _SHARE_OF_PITCH * float(np.sqrt(self.weight.max()))
        self.per_field_mm = self._per_field_mm(lens)
        scale = self.half_mm / self.per_field_mm
        self.fields = np.zeros((len(task.shares), 2))
        self.fields[:, 1] = share * np.asarray(task.shares) * scale
        self.fields = self.aimed(self.stopped(lens))
        semi_mm = np.array([one.semi_diameter_mm for one in lens.surfaces])
        if not np.all(np.isfinite(semi_mm)):
            heights_mm = self.traced(self.stopped(lens))[1]
            semi_mm = np.where(np.isfinite(semi_mm), semi_mm, _ROOM * heights_mm)
        self.variables = Variables(lens, freedom, semi_mm)
        self.owner = [n for n, element in enumerate(lens.elements) for _ in element.surfaces]
        self.edges_mm = [  # of stock lenses
            math.inf if owner in self.variables.made else surface.semi_diameter_mm
            for owner, surface in zip(self.owner, lens.surfaces, strict=True)
        ]

    def _per_field_mm(self, lens: Lens) -> float:
        """Return the image height per tangent of the field of a lens with the right focal length.

            f (1 + f / (s - f)),    s from the object to the entrance pupil of the starting form

        as if that were where the front principal plane is.
        """
        focal_mm = self.task.focal_length_mm
        if math.isinf(lens.object_mm):
            return focal_mm
        away_mm = lens.object_mm + paraxial(lens).entrance_pupil_mm
        return focal_mm * away_mm / (away_mm - focal_mm)

    def stopped(self, lens: Lens) -> Lens:
        """Return the lens with the stop that gives the f-number, at this share of it."""
        pupil_mm = self.share * self.task.focal_length_mm / self.task.f_number
        wide_mm = lens.stop.diameter_mm * pupil_mm / paraxial(lens).entrance_pupil_diameter_mm
        if any(one.inner_mm for one in lens.surfaces):
            raise ValueError(
                "expected a lens without obstructions (inner_mm): edges are not refined"
            )
        free = lens.with_surfaces(replace(one, semi_diameter_mm=math.inf) for one in lens.surfaces)
        return replace(free, stop=replace(lens.stop, diameter_mm=wide_mm))

    def aimed(self, lens: Lens) -> Floats:
        """Return the fields that are imaged at the shares of the sensor, distortion included."""
        fields = self.fields.copy()
        wanted_mm = self.share * np.asarray(self.task.shares) * self.half_mm
        for _ in range(_AIM_STEPS):
            landed_mm = np.abs(self.traced(lens, fields)[2])
            there = (landed_mm > 0) & (wanted_mm > 0)
            ratio = np.where(there, wanted_mm / np.where(there, landed_mm, 1.0), 1.0)
            fields[:, 1] *= np.clip(ratio, 1.0 / _MOST_AIM, _MOST_AIM)
        return fields

    def at_temperatures(self, lens: Lens) -> list[Lens]:
        """Return the lens at each temperature."""
        chosen = self.task.temperatures_c or (lens.temperature_c,)
        return [replace(lens, temperature_c=one) for one in chosen]

    def traced(self, lens: Lens, fields: Floats | None = None) -> tuple[Floats, Floats, Floats]:
        """Return weighted errors in mm [light field ray 2], heights [surface], centroids [field].

        NaN for rays that are lost. The fields are those of the task if none are given.
        """
        tangents = self.fields if fields is None else fields
        bundles: list[RayBundle] = [
            trace(lens, tangents, self.points, wavelength_nm=nm, crossings=True)
            for nm, _ in self.light
        ]
        at_mm = np.stack([one.position_mm for one in bundles])
        weight = np.array([share for _, share in self.light])[:, None, None] * self.weight
        there = np.isfinite(at_mm[..., 0])
        used = np.where(there, weight, 0.0)
        total = used.sum(axis=(0, 2))
        filled = np.where(there[..., None], at_mm, 0.0)
        mean_mm = np.einsum("lfr,lfr->f", used, filled[..., 1]) / np.maximum(total, 1e-12)
        error_mm = at_mm - np.stack([np.zeros_like(mean_mm), mean_mm], axis=-1)[None, :, None]
        met = [np.linalg.norm(one.crossing_mm[..., :2], axis=-1) for one in bundles
               if one.crossing_mm is not None]  # fmt: skip
        heights_mm = np.nan_to_num(np.stack(met), nan=1e-3).max(axis=(0, 1, 2))
        return error_mm * np.sqrt(weight)[..., None], heights_mm, mean_mm

    def errors(self, vector: Floats) -> Floats:
        """Return what is minimised the squares of."""
        drawn = self.variables.lens(vector)
        try:
            lens = self.stopped(drawn)
            focal_mm = paraxial(lens).focal_length_mm
        except ValueError:  # no power, or the stop in a focal plane
            return np.full(self.count, self.lost)
        warm = self.at_temperatures(lens)
        parts, heights_mm, mean_mm = [], np.zeros(1), np.zeros(1)
        for one in warm:
            error_mm, heights_mm, mean_mm = self.traced(one)
            error = error_mm[:, :, : -len(_RIM)] / self.unit_mm
            lost = np.sqrt(self.weight[: -len(_RIM), None]) * self.lost
            parts.append(np.where(np.isfinite(error), error, lost).ravel() / math.sqrt(len(warm)))
        off = _PER_SHARE * (focal_mm / self.task.focal_length_mm - 1.0)
        limits = self.task.limits
        missing_mm = self.variables.missing_mm(
            vector, np.array(limits.glass_mm), limits.air_mm, limits.back_focal_mm
        )
        missed = self._missed(drawn, heights_mm, mean_mm)
        found = np.concatenate([*parts, [off], _PER_MM * missing_mm, missed])
        self.count = found.size
        return found

    def _missed(self, lens: Lens, heights_mm: Floats, mean_mm: Floats) -> list[float]:
        """Return by how much each limit is missed, always as many of them."""
        limits, owner, found = self.task.limits, self.owner, []
        high_mm = _ROOM * heights_mm
        for place, surface in enumerate(lens.surfaces):
            wide_mm = self.edges_mm[place]
            if owner[place] in self.variables.made and surface.curvature_per_mm:
                wide_mm = _STEEPEST / abs(surface.curvature_per_mm)
            found.append(max(0.0, float(high_mm[place]) - wide_mm))
        spaces = zip(pairwise(lens.surfaces), lens.spaces_mm(), strict=False)
        for place, ((front, back), apart_mm) in enumerate(spaces):
            within = owner[place] == owner[place + 1]
            if within and owner[place] not in self.variables.made:
                continue
            room_mm = _room_mm(front, back, apart_mm, high_mm[place : place + 2])
            found.append(max(0.0, (limits.edge_mm if within else limits.air_mm) - room_mm))
        found.append(max(0.0, float(lens.positions_mm()[-1]) - limits.track_mm))
        plain_mm = abs(float(self.fields[-1, 1])) * self.per_field_mm
        off = abs(abs(float(mean_mm[-1])) / plain_mm - 1.0) if plain_mm else 0.0
        missed = [_PER_MM * one for one in found]
        return [*missed, _PER_SHARE * max(0.0, off - limits.distortion)]

    def slopes(self, vector: Floats) -> Floats:
        """Return the Jacobian by forward differences."""
        here = self.errors(vector)
        found = np.empty((here.size, vector.size))
        for number in range(vector.size):
            moved = vector.copy()
            moved[number] += _STEP
            found[:, number] = (self.errors(moved) - here) / _STEP
        return found

    def open(self, vector: Floats) -> Lens:
        """Return the lens of a vector with its stop, stock lenses with their edges."""
        lens = self.stopped(self.variables.lens(vector))
        edged = zip(lens.surfaces, self.edges_mm, strict=True)
        return lens.with_surfaces(replace(one, semi_diameter_mm=edge) for one, edge in edged)

    def finished(self, vector: Floats) -> Lens:
        """Return the lens of a vector, its made surfaces as wide as the rays to the corner need."""
        lens = self.stopped(self.variables.lens(vector))
        heights_mm = _ROOM * self.traced(lens, self.aimed(lens))[1]
        surfaces = list(lens.surfaces)
        for number, high_mm in enumerate(map(float, heights_mm)):
            one, edge_mm = surfaces[number], self.edges_mm[number]
            if self.owner[number] in self.variables.made:
                edge_mm = _within_mm(one, high_mm)
            surfaces[number] = replace(one, semi_diameter_mm=edge_mm)
        notes: list[str] = []
        for number, apart_mm in enumerate(lens.spaces_mm()[:-1]):
            surfaces[number : number + 2] = trimmed(
                surfaces[number], surfaces[number + 1], apart_mm, number + 1, notes
            )
        if notes:
            warn_quality("; ".join(notes), stacklevel=3)
        return lens.with_surfaces(surfaces)


def _within_mm(surface: Surface, high_mm: float) -> float:
    """Return a height, or where the surface ends if that is nearer."""
    bend = (1.0 + surface.conic) * surface.curvature_per_mm**2
    return min(high_mm, 0.999 / math.sqrt(bend)) if bend > 0 else high_mm


def _room_mm(front: Surface, back: Surface, apart_mm: float, high_mm: Floats) -> float:
    """Return the room between two surfaces, each at its edge and both at the lower of these."""
    edges_mm = _within_mm(front, float(high_mm[0])), _within_mm(back, float(high_mm[1]))
    at_mm = np.array([*edges_mm, min(edges_mm)])
    of_front, of_back = front.sag_mm(at_mm[[0, 2]]), back.sag_mm(at_mm[[1, 2]])
    return float((apart_mm + of_back - of_front).min())
