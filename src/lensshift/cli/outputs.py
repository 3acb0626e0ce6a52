"""Where verbs write their numbers and figures, beside the screen."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from csv import writer as csv_writer
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lensshift.cli.inputs import check_files

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from lensshift.cli.session import Session

CsvOption = Annotated[Path | None, typer.Option("--csv", help="Write the table there.")]
PlotOption = Annotated[
    Path | None, typer.Option("--plot", help="Draw the result: a .png, .svg or .pdf file.")
]


@dataclass(frozen=True, slots=True)
class Outputs:
    """Where the numbers go, beside the screen."""

    csv: CsvOption = None
    plot: PlotOption = None


def check(inputs: Sequence[Path | None], *files: Path | None, plot: Path | None = None) -> None:
    """Complain before the work about files that cannot be written."""
    check_files(inputs, [path for path in (*files, plot) if path is not None])
    if plot is not None:
        from lensshift.report.save import check_ending

        check_ending(plot)


def write_table(current: Session, csv: Path | None, columns: Mapping[str, Any]) -> None:
    """Write columns of one length under their names."""
    if csv is None:
        return
    from lensshift.core.atomic import written_whole

    rows = zip(*columns.values(), strict=True)
    with written_whole(csv) as part, part.open("w", encoding="utf-8", newline="") as file:
        writer = csv_writer(file, lineterminator="\n")  # quotes what holds a comma
        writer.writerow(columns)
        writer.writerows(
            [cell if isinstance(cell, str) else f"{cell:.8g}" for cell in row] for row in rows
        )
    current.say(f"wrote {csv}")


def write_plot(current: Session, plot: Path | None, name: str, *of: Any, **options: Any) -> None:
    """Draw a figure and write it, see `drawn`."""
    if plot is None:
        return
    from lensshift.report.save import save_figure

    save_figure(drawn(name, *of, **options), plot)
    current.say(f"wrote {plot}")


def drawn(name: str, *of: Any, **options: Any) -> Figure:
    """Draw one of the figures of `lensshift.report`, as in "edges.gain_figure"."""
    module, _, draw = name.partition(".")
    figure: Figure = getattr(import_module(f"lensshift.report.{module}"), draw)(*of, **options)
    return figure
