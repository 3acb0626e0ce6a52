"""Several starting forms for `refine`, which goes downhill from one."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from lensshift.core.errors import QualityWarning
from lensshift.optics.lens import Lens
from lensshift.optics.refine import merit, refine, tell_missed
from lensshift.optics.task import Task
from lensshift.optics.variables import Freedom

_SPREAD = 0.7  # of a curvature that is drawn, over 1 / focal length
_FIRST_SHARE, _FIRST_STEPS = 0.4, 15  # of aperture and field, and of the solver, at a first look
_MOST_DRAWN = 10  # forms that are drawn for each that light gets through
_FOLLOWED = 3  # forms that are refined to the end


def refine_from_several(
    lens: Lens,
    task: Task,
    freedom: Freedom,
    *,
    starts: int = 12,
    seed: int = 0,
    grow: tuple[float, ...] = (1.0,),
    steps: int = 60,
    on_progress: Callable[[int, int], None] | None = None,
) -> Lens:
    """Return the best lens that `refine` reaches from a form and from random ones like it.

    In the others the curvatures of what is made are drawn about those of the form. All are refined
    a little at 0.4 of aperture and field; the given one and the three with the least errors are
    refined to the end. The same seed gives the same lens, and no worse one than `refine` does.

    Parameters
    ----------
    lens, task, freedom, grow, steps : as for `refine`
    starts : forms that are looked at, the given one among them
    seed : of those that are drawn
    on_progress : is told how many refinements of how many are done

    Raises
    ------
    ValueError
        If `starts` is less than 1, or as `refine`, of the given form.

    Warns
    -----
    QualityWarning
        As `refine`, of the lens returned.
    """
    if starts < 1:
        raise ValueError(f"expected at least one starting form, got {starts}")
    rng, looked = np.random.default_rng(seed), []
    total = starts + min(_FOLLOWED, starts - 1)
    told = on_progress or (lambda done, of: None)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", QualityWarning)  # of forms that nobody keeps
        for done in range(1, starts):
            found = _looked_at(lens, task, freedom, rng)
            looked += [] if found is None else [found]
            told(done, total)
        looked.sort(key=lambda pair: pair[0])
        ends = []
        for number, form in enumerate((lens, *(one for _, one in looked[:_FOLLOWED]))):
            try:
                end = refine(form, task, freedom, grow=grow, steps=steps)
            except ValueError:
                if number == 0:
                    raise
                continue
            ends.append((merit(end, task, freedom), end))
            told(starts + number, total)
    best = min(ends, key=lambda pair: pair[0])[1]
    tell_missed(best, task)
    return best


def _looked_at(
    lens: Lens, task: Task, freedom: Freedom, rng: np.random.Generator
) -> tuple[float, Lens] | None:
    """Return a random form after a few steps with its errors; None if light gets through none."""
    for _ in range(_MOST_DRAWN):
        try:
            form = _drawn(lens, task, freedom, rng)
            near = refine(form, task, freedom, grow=(_FIRST_SHARE,), steps=_FIRST_STEPS)
            return merit(near, task, freedom, _FIRST_SHARE), near
        except ValueError:  # edges cross, no power, no light
            continue
    return None


def _drawn(lens: Lens, task: Task, freedom: Freedom, rng: np.random.Generator) -> Lens:
    """Return the lens with other curvatures of the elements that are made."""
    elements = list(lens.elements)
    for number, element in enumerate(elements):
        curved = any(surface.curvature_per_mm for surface in element.surfaces)
        if not (curved if freedom.elements is None else number in freedom.elements):
            continue
        bends = rng.normal(0.0, _SPREAD / task.focal_length_mm, len(element.surfaces)).tolist()
        shapes = (
            replace(one, radius_mm=1.0 / (one.curvature_per_mm + bend), semi_diameter_mm=np.inf)
            for one, bend in zip(element.surfaces, bends, strict=True)
        )
        elements[number] = replace(element, surfaces=tuple(shapes))
    return replace(lens, elements=tuple(elements))
