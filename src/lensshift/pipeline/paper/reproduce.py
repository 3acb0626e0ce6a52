"""Every experiment of the paper, measured: claims, figures and one page."""

from __future__ import annotations

import multiprocessing
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

from lensshift.core.atomic import write_text
from lensshift.core.settings import to_json
from lensshift.pipeline.paper.bench import SNR, Response, calibrated_response
from lensshift.pipeline.paper.beyond import (
    ERRORS_PX,
    PATTERNS,
    Strip,
    error_row,
    mean_rows,
    pattern_row,
    shift_claim,
    study_strip,
)
from lensshift.pipeline.paper.box_claims import BoxRun, box_claims, response_rows, take_boxes
from lensshift.pipeline.paper.claims import CRITERIA, Claim
from lensshift.pipeline.paper.edge_claims import EdgeRun, edge_claims, take_edge
from lensshift.pipeline.paper.gratings import GRATINGS_LPMM, GratingRun, take_grating
from lensshift.pipeline.paper.optics_claims import LensResult, optics_claims, study_lens
from lensshift.pipeline.paper.page import write_page
from lensshift.pipeline.run import made_folder, writable_folder

# What its result is filed under, and a call of a function of a module: another process finds it.
Job = tuple[str, Callable[[], Any]]

# Contrast, width in LR pixels, SNR of one frame.
_QUICK_STRIPS = ((3.0, 12.0, 400.0), (0.15, 1.0, 400.0))
_STRIPS = (
    *((contrast, 12.0, 400.0) for contrast in (0.15, 0.5, 3.0, 8.0)),
    *((contrast, width, 400.0) for contrast in (0.15, 0.3, 3.0) for width in (1.0, 1.5, 2.0)),
    (3.0, 12.0, 100.0),
    (0.15, 1.0, 100.0),
)
# Of a reproduction, beside claims and gratings, for results.json.
_WRITTEN = (
    "response_px", "response_error_px", "gradients", "depth", "beyond", "not_done", "command",
    "seconds",
)  # fmt: skip
_DRAWS = {"edge": 6, "grating": 2, "boxes": 8, "errors": 3}
_QUICK_DRAWS = {"edge": 2, "grating": 1, "boxes": 3, "errors": 1}
_NOT_DONE = (
    "the second reconstruction of the lens, and two thirds of the frequencies of the first",
    f"{len(_STRIPS) - len(_QUICK_STRIPS)} of {len(_STRIPS)} strips of the gradient question",
    *(
        f"{_DRAWS[kind] - _QUICK_DRAWS[kind]} of {_DRAWS[kind]} draws of {what}"
        for kind, what in (("edge", "the edge card"), ("grating", "each grating"),
                           ("boxes", "the boxes"), ("errors", "wrong shifts"))
    ),
    "finer patterns, beyond the paper",
)  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class Reproduction:
    """What came out."""

    claims: tuple[Claim, ...]  # the paper's, with our numbers and verdicts
    response_px: float  # assumed width of a pixel, as `calibrate` finds it here
    response_error_px: float
    gradients: tuple[dict[str, Any], ...]  # one row per strip, see `study_strip`
    beyond: dict[str, list[dict[str, Any]]]  # table -> rows: what the paper did not try
    depth: tuple[dict[str, Any], ...]  # errors of the distance on the boxes, by branch, per draw
    lenses: tuple[LensResult, ...]
    edges: tuple[EdgeRun, ...]
    gratings: tuple[GratingRun, ...]
    boxes: tuple[BoxRun, ...]
    not_done: tuple[str, ...]  # what the quick run left out
    command: str  # how it was asked for, or empty
    seconds: float  # for everything
    files: tuple[Path, ...]  # what was written


def reproduce(
    out_dir: str | Path,  # made if it is missing
    *,
    quick: bool = False,  # fewer draws and strips, one lens, nothing beyond the paper
    processes: int = 2,  # that work side by side; 1 stays in this one
    command: str = "",  # line that asked for it, for the report
    on_step: Callable[[int, int], None] | None = None,  # called with jobs finished, and all of them
) -> Reproduction:
    """Repeat the experiments of the paper and write results.json and report.html.

    DataError if the folder or a file cannot be written. ValueError without a process.
    """
    start_s = time.perf_counter()
    folder = writable_folder(out_dir)
    response, error_px = calibrated_response()
    done = carry_out_jobs(_jobs(quick, response), processes, on_step)
    lenses, edges, gratings, boxes = (
        _of_kind(done, kind) for kind in ("lens", "edge", "grating", "boxes")
    )
    beyond = {name: _of_kind(done, name) for name in ("patterns", "errors")}
    claims = [*optics_claims(lenses), *edge_claims(edges, gratings), *box_claims(boxes)]
    claims.append(shift_claim(beyond["errors"]))
    beyond["errors"] = mean_rows(beyond["errors"], "shift_error_px")
    beyond["responses"] = response_rows(boxes)
    found = Reproduction(
        claims=tuple(claims),
        response_px=response[1],
        response_error_px=error_px,
        gradients=tuple(_of_kind(done, "strip")),
        beyond={name: rows for name, rows in beyond.items() if rows},
        depth=tuple(run.depth for run in boxes),
        lenses=tuple(lenses),
        edges=tuple(edges),
        gratings=tuple(gratings),
        boxes=tuple(boxes),
        not_done=_NOT_DONE if quick else (),
        command=command,
        seconds=time.perf_counter() - start_s,
        files=(folder / "results.json", folder / "report.html"),
    )
    made_folder(folder)
    _write_results(found, found.files[0])
    write_page(found, found.files[1])
    return found


def _jobs(quick: bool, response: Response) -> list[Job]:
    """Return all work, the longest first."""
    draws = _QUICK_DRAWS if quick else _DRAWS
    lenses = ("petzval_a",) if quick else ("petzval_a", "petzval_b")
    strips = _QUICK_STRIPS if quick else _STRIPS
    errors_px = (0.05, 0.1) if quick else ERRORS_PX
    jobs: list[Job] = [("lens", partial(study_lens, name, 9 if quick else 27)) for name in lenses]
    jobs += [("boxes", partial(take_boxes, n, SNR, response)) for n in range(draws["boxes"])]
    jobs += [("edge", partial(take_edge, seed, response)) for seed in range(draws["edge"])]
    jobs += [("strip", partial(study_row, *strip, response)) for strip in strips]
    jobs += [
        ("grating", partial(take_grating, frequency_lpmm, seed, response))
        for frequency_lpmm in GRATINGS_LPMM
        for seed in range(draws["grating"])
    ]
    jobs += [
        ("errors", partial(error_row, error_px, seed, response))
        for error_px in errors_px
        for seed in range(draws["errors"])
    ]
    if not quick:
        jobs += [("patterns", partial(pattern_row, *arguments, response)) for arguments in PATTERNS]
    return jobs


def carry_out_jobs(
    jobs: Sequence[Job], processes: int, on_step: Callable[[int, int], None] | None = None
) -> list[tuple[str, Any]]:
    """Return kind and result of each job, in their order; one process is this one.

    ValueError if there is not at least one; whatever a job raises. `on_step` hears how many jobs
    of all are done.
    """
    if processes < 1:
        raise ValueError(f"expected at least one process, got {processes}")
    said = on_step or (lambda done, total: None)
    if processes == 1:
        found: list[tuple[str, Any]] = []
        for kind, job in jobs:
            found.append((kind, job()))
            said(len(found), len(jobs))
        return found
    # Fresh processes: a forked one may inherit locks of numerical libraries.
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(processes, mp_context=context) as pool:
        futures = [pool.submit(job) for _, job in jobs]
        try:
            for done, future in enumerate(as_completed(futures), start=1):
                future.result()
                said(done, len(jobs))
        finally:
            pool.shutdown(cancel_futures=True)  # after a failure the rest is not wanted
        return [(kind, one.result()) for (kind, _), one in zip(jobs, futures, strict=True)]


def study_row(contrast: float, width_px: float, snr: float, response: Response) -> dict[str, Any]:
    """Return the gains over one strip as plain numbers."""
    strip = Strip(contrast, width_px, snr)
    gains = study_strip(strip, 0, response)
    return asdict(strip) | {branch: asdict(gain) for branch, gain in gains.items()}


def _of_kind(done: list[tuple[str, Any]], kind: str) -> list[Any]:
    return [result for name, result in done if name == kind]


def _write_results(found: Reproduction, path: Path) -> None:
    told = ("id", "statement", "paper", "ours", "interval", "numbers", "verdict", "why")
    claims: Any = [
        {name: getattr(one, name) for name in told}
        | {"criteria": {k: asdict(c) for k, c in CRITERIA[one.id].items()}}
        for one in found.claims
    ]
    content = {"claims": claims} | {name: getattr(found, name) for name in _WRITTEN}
    content["gratings"] = [asdict(one) for one in found.gratings]
    write_text(path, to_json(content) + "\n")
