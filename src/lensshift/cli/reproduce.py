"""`lensshift reproduce`: every experiment of the paper, measured."""

from __future__ import annotations

import shlex
import sys
from dataclasses import asdict, dataclass
from pathlib import Path

from lensshift.cli.session import Progress, Session
from lensshift.cli.verbs import option, verb
from lensshift.core.threads import core_count


@dataclass(frozen=True, slots=True)
class _ReproduceOptions:
    out: Path = option(Path("lensshift-paper"), "Folder for results.json and report.html.", "-o")
    quick: bool = option(False, "Fewer draws, about a minute.")
    processes: int | None = option(None, "Side by side; default: all cores.", min=1)


@verb()
def reproduce(current: Session, asked: _ReproduceOptions) -> None:
    """Repeat the experiments of the paper: each claim confirmed, qualified or refuted.

    \b
    Example:
      lensshift reproduce --quick --out paper
    """
    from lensshift.pipeline.paper import reproduce as reproduce_paper

    with Progress("experiments of the paper", preparing=True) as progress:
        found = reproduce_paper(
            asked.out, quick=asked.quick, processes=asked.processes or core_count(),
            on_step=progress.count, command=shlex.join(["lensshift", *sys.argv[1:]]),
        )  # fmt: skip
    for claim in found.claims:
        current.say(f"{claim.verdict:<10} {claim.id:<32} paper: {claim.paper}; {claim.said}")
    if found.not_done:
        current.say("not done: " + "; ".join(found.not_done))
    current.say(f"{found.seconds:.0f} s, wrote " + ", ".join(map(str, found.files)))
    claims = [asdict(claim) | {"verdict": claim.verdict} for claim in found.claims]
    current.result["claims"] = claims
    current.tell(found, "not_done seconds files")
