"""`lensshift reproduce`: every experiment of the paper, measured."""

from __future__ import annotations

import os
import shlex
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from lensshift.cli.session import DebugOption, JsonOption, Progress, session

FolderOption = Annotated[
    Path, typer.Option("--out", "-o", help="Folder for results.json and report.html.")
]
QuickOption = Annotated[bool, typer.Option("--quick", help="Fewer draws, under a minute.")]
ProcessesOption = Annotated[
    int | None, typer.Option("--processes", min=1, help="Side by side; default: all cores.")
]


def reproduce(
    out: FolderOption = Path("lensshift-paper"),
    quick: QuickOption = False,
    processes: ProcessesOption = None,
    as_json: JsonOption = False,
    debug: DebugOption = False,
) -> None:
    """Repeat the experiments of the paper: each claim confirmed, qualified or refuted.

    \b
    Example:
      lensshift reproduce --quick --out paper
    """
    with session(as_json=as_json, debug=debug) as current:
        from lensshift.pipeline.paper import reproduce as reproduce_paper

        progress = Progress("measuring")
        try:
            found = reproduce_paper(
                out, quick=quick, processes=processes or _cores(), on_step=progress.count,
                command=shlex.join(["lensshift", *sys.argv[1:]]),
            )  # fmt: skip
        finally:
            progress.close()
        for claim in found.claims:
            low, high = claim.interval
            current.say(
                f"{claim.verdict:<10} {claim.id:<32} paper: {claim.paper}; "
                f"ours: {claim.ours:.3g} ({low:.3g} to {high:.3g})"
            )
        if found.not_done:
            current.say("not done: " + "; ".join(found.not_done))
        current.say(f"{found.seconds:.0f} s, wrote " + ", ".join(map(str, found.files)))
        current.result |= {
            "claims": [asdict(claim) | {"verdict": claim.verdict} for claim in found.claims],
            "not_done": found.not_done,
            "seconds": found.seconds,
            "files": found.files,
        }


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
