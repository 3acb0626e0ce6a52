"""Every experiment of the paper, measured: claims, figures and one page."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from lensshift.io.atomic import written_whole
from lensshift.pipeline.paper.beyond import (
    EQUAL_LIGHT,
    ERRORS_PX,
    MAPS,
    PATTERNS,
    error_row,
    light_row,
    pattern_row,
    shift_map_row,
)
from lensshift.pipeline.paper.box_claims import BoxRun, box_claims, take_boxes
from lensshift.pipeline.paper.claims import Claim
from lensshift.pipeline.paper.edge_claims import EdgeRun, edge_claims, take_edge
from lensshift.pipeline.paper.gradient_question import Strip, as_row, study_strip
from lensshift.pipeline.paper.jobs import Job, carry_out_jobs
from lensshift.pipeline.paper.optics_claims import LensResult, optics_claims, study_lens
from lensshift.pipeline.paper.page import write_page
from lensshift.pipeline.paper.responses import RESPONSES, response_row
from lensshift.pipeline.run import made_folder, writable_folder

# Contrast, width in LR pixels, SNR of one frame.
_QUICK_STRIPS = ((3.0, 12.0, 400.0), (0.15, 1.0, 400.0))
_STRIPS = (
    *((contrast, 12.0, 400.0) for contrast in (0.15, 0.5, 3.0, 8.0)),
    *((contrast, width, 400.0) for contrast in (0.15, 0.3, 3.0) for width in (1.0, 1.5, 2.0)),
    (3.0, 12.0, 100.0),
    (0.15, 1.0, 100.0),
)
_BEYOND = ("patterns", "equal_light", "errors", "responses", "shift_map")
_DRAWS = {"edge": 6, "boxes": 8}
_QUICK_DRAWS = {"edge": 2, "boxes": 3}


@dataclass(frozen=True, slots=True, eq=False)
class Reproduction:
    """What came out.

    Parameters
    ----------
    claims : the paper's, with our numbers and verdicts
    gradients : one row per strip, see `study_strip`
    beyond : name of a table -> its rows: what the paper did not try
    depth : errors of the distance on the boxes, by branch, one row per draw
    lenses, edges, boxes : the runs behind the claims
    seconds : for everything
    files : what was written
    """

    claims: tuple[Claim, ...]
    gradients: tuple[dict[str, Any], ...]
    beyond: dict[str, list[dict[str, Any]]]
    depth: tuple[dict[str, Any], ...]
    lenses: tuple[LensResult, ...]
    edges: tuple[EdgeRun, ...]
    boxes: tuple[BoxRun, ...]
    seconds: float
    files: tuple[Path, ...]


def reproduce(
    out_dir: str | Path,
    *,
    quick: bool = False,
    processes: int = 2,
    on_step: Callable[[int, int], None] | None = None,
) -> Reproduction:
    """Repeat the experiments of the paper and write results.json and report.html.

    Parameters
    ----------
    out_dir : folder; made if it is missing
    quick : fewer draws and strips, one lens, nothing beyond the paper
    processes : that work side by side; 1 stays in this one
    on_step : called with the number of finished jobs and of all jobs

    Raises
    ------
    DataError
        If the folder or a file cannot be written.
    ValueError
        If there is not at least one process.
    """
    start_s = time.perf_counter()
    folder = writable_folder(out_dir)
    done = carry_out_jobs(_jobs(quick), processes, on_step)
    lenses, edges, boxes = (_of_kind(done, kind) for kind in ("lens", "edge", "boxes"))
    claims = [*optics_claims(lenses), *edge_claims(edges), *box_claims(boxes)]
    beyond = {name: _of_kind(done, name) for name in _BEYOND}
    found = Reproduction(
        claims=tuple(claims),
        gradients=tuple(_of_kind(done, "strip")),
        beyond={name: rows for name, rows in beyond.items() if rows},
        depth=tuple(run.depth for run in boxes),
        lenses=tuple(lenses),
        edges=tuple(edges),
        boxes=tuple(boxes),
        seconds=time.perf_counter() - start_s,
        files=(folder / "results.json", folder / "report.html"),
    )
    made_folder(folder)
    _write_results(found, found.files[0], quick=quick)
    write_page(found, found.files[1])
    return found


def _jobs(quick: bool) -> list[Job]:
    """Return all work, the longest first."""
    draws = _QUICK_DRAWS if quick else _DRAWS
    lenses = ("petzval_a",) if quick else ("petzval_a", "petzval_b")
    strips = _QUICK_STRIPS if quick else _STRIPS
    jobs = [Job("lens", study_lens, (name, 9 if quick else 27)) for name in lenses]
    jobs += [Job("edge", take_edge, (seed,)) for seed in range(draws["edge"])]
    jobs += [Job("strip", study_row, strip) for strip in strips]
    jobs += [Job("boxes", take_boxes, (seed,)) for seed in range(draws["boxes"])]
    if not quick:
        jobs += [Job("patterns", pattern_row, arguments) for arguments in PATTERNS]
        jobs += [Job("equal_light", light_row, (name,)) for name in EQUAL_LIGHT]
        jobs += [Job("errors", error_row, (error_px,)) for error_px in ERRORS_PX]
        jobs += [Job("responses", response_row, response) for response in RESPONSES]
        jobs += [Job("shift_map", shift_map_row, arguments) for arguments in MAPS]
    return jobs


def study_row(contrast: float, width_px: float, snr: float) -> dict[str, Any]:
    """Return the gains over one strip as plain numbers."""
    strip = Strip(contrast, width_px, snr)
    return as_row(strip, study_strip(strip))


def _of_kind(done: list[tuple[str, Any]], kind: str) -> list[Any]:
    return [result for name, result in done if name == kind]


def _write_results(found: Reproduction, path: Path, *, quick: bool) -> None:
    content = {
        "claims": [asdict(claim) for claim in found.claims],
        "gradients": found.gradients,
        "depth": found.depth,
        "beyond": found.beyond,
        "quick": quick,
        "seconds": found.seconds,
    }
    with written_whole(path) as part:
        part.write_text(json.dumps(_without_nan(content), indent=2) + "\n", encoding="utf-8")


def _without_nan(value: Any) -> Any:
    """Return plain values; JSON knows no NaN."""
    if isinstance(value, dict):
        return {key: _without_nan(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_without_nan(one) for one in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
