"""Measure the edges of many photographs, on all cores."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context
from multiprocessing.context import BaseContext
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lensshift.core.errors import QualityWarning, warn_quality
from lensshift.core.processes import one_thread_each
from lensshift.evaluation.chart import (
    ChartEdge,
    FocusFit,
    best_focus,
    chart_edges,
    rises_again,
    zone_rows,
)
from lensshift.evaluation.slanted_edge import EdgeResult, Region, find_regions, measure_edge

Pitch = float | tuple[float, float]
Task = tuple[int, Region]  # number of the photograph, and where in it
Told = tuple[int, EdgeResult | str]  # that number, and what was found or why not
Work = Callable[[Task], Told]
_WORTH_WORKERS = 8  # edges: below, starting processes takes longer than it saves


@dataclass(frozen=True, slots=True, eq=False)
class Photograph:
    """One picture of a chart.

    Parameters
    ----------
    name : of it
    image : [row col], or [frame row col] with `offset_px`, of linear light
    focus : position of the focus, in any unit
    offset_px : [frame 2] of frames, as of the green pixels of a mosaic
    jpeg_steps : [8 8] of a JPEG, as of `measure_edges`
    """

    name: str
    image: NDArray[Any]
    focus: float = 0.0
    offset_px: ArrayLike | None = None
    jpeg_steps: ArrayLike | None = None

    @property
    def first(self) -> NDArray[Any]:
        """The picture that is shown [row col]."""
        return self.image if self.image.ndim == 2 else self.image[0]


def measure_chart(
    pictures: Sequence[Photograph],
    pitch_mm: Pitch = 1.0,
    *,
    workers: int | None = None,
    on_edge: Callable[[int, int], None] | None = None,
    context: BaseContext | None = None,
    **options: Any,
) -> list[ChartEdge]:
    """Measure every slanted edge of photographs, and say where in the field each lies.

    What speaks against an edge is in the notes of its result.

    Parameters
    ----------
    pictures : of one lens; the middle of each is that of the field
    pitch_mm : of the pixels; 1 gives cycles per pixel
    workers : processes, by default one a core if there are edges enough; 1: none
    on_edge : told how many edges are done, and how many there are
    context : how processes start, spawned by default; see `core.processes`
    options : of `measure_edges`: method, aperture_px and so on

    Raises
    ------
    ValueError
        If no photograph shows a slanted edge that can be measured.

    Warns
    -----
    QualityWarning
        If a photograph shows no edge, or regions that look like edges could not be measured.
    """
    tasks: list[Task] = []
    blank: list[str] = []
    for number, one in enumerate(pictures):
        try:
            tasks += [(number, place) for place in find_regions(np.asarray(one.first, float))]
        except ValueError:
            blank.append(one.name)  # another photograph may show some
    if workers is None:
        workers = (os.cpu_count() or 1) if len(tasks) >= _WORTH_WORKERS else 1
    found: list[list[EdgeResult]] = [[] for _ in pictures]
    refused: list[str] = []
    work = partial(_one, pictures, pitch_mm, options)
    with _measured(work, tasks, workers, context or get_context("spawn")) as results:
        for done, (number, result) in enumerate(results, start=1):
            if isinstance(result, str):
                refused.append(f"{pictures[number].name}: {result}")
            else:
                found[number].append(result)
            if on_edge is not None:
                on_edge(done, len(tasks))
    edges = [
        edge
        for one, results in zip(pictures, found, strict=True)
        for edge in chart_edges(results, one.first.shape, image=one.name, focus=one.focus)
    ]
    if not edges:
        names = ", ".join(one.name for one in pictures)
        why = f" ({refused[0]})" if refused else ""
        raise ValueError(
            f"expected a slanted edge that can be measured, found none in {names}{why}"
        )
    if blank:
        warn_quality(f"no slanted edge was found in {', '.join(blank)}")
    if refused:
        warn_quality(f"{len(refused)} regions could not be measured, the first: {refused[0]}")
    return edges


def focus_series(edges: Sequence[ChartEdge]) -> tuple[list[dict[str, Any]], dict[str, FocusFit]]:
    """Return the MTF50 of each zone and position of the focus, and where each zone is sharpest.

    Sagittal and tangential lines of a zone are apart, as "corners sagittal": a lens with
    astigmatism is sharpest for them at different places. Zones whose best position is not within
    the series have no fit.

    Warns
    -----
    QualityWarning
        If a zone has none, and why, or MTF50 rises again away from the focus.
    """
    rows: list[dict[str, Any]] = []
    told: dict[str, list[tuple[float, float, float]]] = {}
    for focus in sorted({one.focus for one in edges}):
        for row in zone_rows([one for one in edges if one.focus == focus]):
            zone, number = f"{row['zone']} {row['direction']}", row["mtf50_lpmm"]
            rows.append({"zone": zone, "focus": focus, "mtf50_lpmm": number.value})
            std = (number.high - number.low) / (2 * 1.96)
            if np.isfinite(number.value):
                told.setdefault(zone, []).append((focus, number.value, std))
    fits = {}
    again = {zone: rises_again(*np.transpose(here)) for zone, here in told.items()}
    for zone, here in told.items():
        try:
            fits[zone] = best_focus(*np.transpose(here))
        except ValueError as error:
            warn_quality(f"no best focus {zone}: {error}")
    if twice := {zone: places for zone, places in again.items() if places is not None}:
        zone, (inner, outer) = next(iter(twice.items()))
        warn_quality(
            f"away from the focus MTF50 rises again in {len(twice)} of {len(told)} zones, {zone} "
            f"from {inner:g} to {outer:g}: are the positions in the order of the photographs?"
        )
    return rows, fits


@contextmanager
def _measured(
    work: Work, tasks: Sequence[Task], workers: int, context: BaseContext
) -> Iterator[Iterator[Told]]:
    """Yield the results in the order of the tasks."""
    if workers <= 1:
        yield map(work, tasks)
        return
    pool = ProcessPoolExecutor(workers, context, _begin, (work,))
    try:
        with one_thread_each():
            results = pool.map(_task, tasks)  # starts the processes
        yield results
    finally:
        pool.shutdown(cancel_futures=True)


_work: Work


def _begin(work: Work) -> None:
    """Keep what every task of this process needs."""
    global _work
    _work = work


def _task(task: Task) -> Told:
    return _work(task)


def _one(
    pictures: Sequence[Photograph], pitch_mm: Pitch, options: dict[str, Any], task: Task
) -> Told:
    number, place = task
    one = pictures[number]
    own = {"offset_px": one.offset_px, "jpeg_steps": one.jpeg_steps, **options}
    # The notes say what is warned of.
    with warnings.catch_warnings(action="ignore", category=QualityWarning):
        try:
            return number, measure_edge(one.image, pitch_mm, region=place, **own)
        except ValueError as error:
            return number, str(error)
