"""The verbs of `lensshift`, put together."""

from __future__ import annotations

from typing import Annotated

import typer

from lensshift.cli.calibrate import calibrate
from lensshift.cli.capture import capture
from lensshift.cli.convert import convert
from lensshift.cli.doctor import doctor
from lensshift.cli.emulate import emulate
from lensshift.cli.evaluate import evaluate
from lensshift.cli.info import info
from lensshift.cli.lens import lens_verbs
from lensshift.cli.live import live
from lensshift.cli.methods import methods
from lensshift.cli.reconstruct import reconstruct
from lensshift.cli.register import register
from lensshift.cli.run import reproduce, run
from lensshift.cli.simulate import simulate
from lensshift.cli.verbs import verb_group

app = verb_group(name="lensshift", pretty_exceptions_enable=False)


def _show_version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version

        typer.echo(f"lensshift {version('lensshift')}")
        raise typer.Exit


@app.callback()
def root(
    context: typer.Context,
    version: Annotated[
        bool,
        typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version."),
    ] = False,
    max_memory: Annotated[
        float | None,
        typer.Option(
            "--max-memory", min=0.001, help="GiB that the arrays of an input file may take."
        ),
    ] = None,
) -> None:
    """Super-resolution from frames whose content moved by a fraction of a pixel.

    \b
    Example:
      lensshift reconstruct burst.nc --scale 2 -o sharp.nc
    """
    if max_memory is not None:
        from lensshift.io.reading import memory_limit

        context.with_resource(memory_limit(round(max_memory * 2**30)))


for verb in (
    run, simulate, reproduce, doctor, capture, live, register, calibrate, reconstruct, methods,
    convert, info,
):  # fmt: skip
    app.command()(verb)
app.add_typer(evaluate, name="evaluate")
app.add_typer(emulate, name="emulate")
app.add_typer(lens_verbs, name="lens")
