"""`lensshift lens refine`: make a starting form sharp."""

from __future__ import annotations

import math
from dataclasses import MISSING, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from lensshift.cli.inputs import parse_numbers
from lensshift.cli.lens_design import BestOption, check_out, write_lens
from lensshift.cli.optics import BandOption, LensOptions, band_of, element_of, opened
from lensshift.cli.ranges import in_range
from lensshift.cli.session import Progress, Session
from lensshift.cli.verbs import option, verb

if TYPE_CHECKING:
    from lensshift.optics.lens import Lens
    from lensshift.optics.task import Task


@dataclass(frozen=True, slots=True)
class _RefineOptions:
    of: LensOptions
    focal_length_mm: float = option(MISSING, "Kept.")
    f_number: float = option(MISSING, "Kept, by the stop.")
    made: str = option("", "Elements made to order, from 1: 1,3. All but plates if not given.")
    thicknesses: bool = option(True, "Also thicknesses of glass.", "--thicknesses/--radii-only")
    aspheres: int = option(0, "Terms A4, A6, ... of aspheric elements.", min=0)
    aspheric: str = option("", "Elements with aspheres, from 1. All that are made.")
    conics: bool = option(False, "Conics of aspheric elements too.", "--conics")
    move_stop: bool = option(
        True, "The place of a stop between elements.", "--move-stop/--keep-stop"
    )
    grow: str = option("1", "Shares of aperture and field to go through: 0.4,0.7,1.")
    steps: int = option(60, "Of the solver, each time.", min=1)
    starts: int = option(1, "Forms to begin from, all but the first drawn at random.", min=1)
    seed: int = option(0, "Of these.", min=0)
    glass_mm: str = option("0.8,inf", "Least and most thickness of glass: 0.8,5.")
    edge_mm: float = option(0.4, "Least at its edge.")
    air_mm: float = option(0.05, "Least between elements.")
    back_focal_mm: float = option(0.3, "Least in front of the sensor.")
    track_mm: float = option(math.inf, "Most from first vertex to sensor.")
    distortion: float = option(math.inf, "Most in the corner, as a share.")
    band_nm: BandOption = None
    temperatures_c: str = option("", "Sharp at each of these with one focus: -10,60.")
    out: BestOption = None


@verb("refining the lens")
def refine(current: Session, asked: _RefineOptions) -> None:
    """Find curvatures, thicknesses, gaps and aspheres of a lens from a starting form.

    Least squares of ray errors over the sensor, the light and the temperatures. Elements that are
    not made to order are stock lenses and stay whole; plates in front of the sensor stay, too.
    A rough form needs --grow, and spheres before aspheres; --starts looks at random forms beside
    the one given, and refines that and the best three. The least MTF is that of `lens which`.

    \b
    Example:
      lensshift lens refine form.toml --focal-length-mm 5.2 --f-number 1.2 --sensor 320x240 \\
        --pitch-mm 0.015 --track-mm 25 --grow 0.4,0.5,0.6,0.7,0.8,0.9,1 -o spheres.toml
      lensshift lens refine petzval_a.toml --focal-length-mm 42.7 --f-number 2.1 --made 3
    """
    from lensshift.optics.starts import refine_from_several
    from lensshift.optics.task import Limits, Task
    from lensshift.optics.variables import Freedom

    check_out(asked.out, Path(asked.of.lens))
    start, grid = opened(asked.of)
    grow = _numbers(asked.grow)
    if grow[-1:] != (1.0,):
        raise typer.BadParameter(f"expected --grow to end with 1, got {asked.grow!r}")
    low_mm, high_mm = parse_numbers(asked.glass_mm, 2, "two thicknesses like 0.8,5", ends=False)
    limits = Limits(
        (in_range("glass_mm", low_mm), high_mm), asked.edge_mm, asked.air_mm,
        asked.back_focal_mm, asked.track_mm, asked.distortion,
    )  # fmt: skip
    task = Task(
        grid, asked.focal_length_mm, asked.f_number, limits,
        band_of(start.wavelength_nm, asked.band_nm),
        tuple(in_range("temperatures_c", one) for one in _numbers(asked.temperatures_c)),
    )  # fmt: skip
    numbers, of_aspheres = _elements(start, asked.made), _elements(start, asked.aspheric)
    freedom = Freedom(
        numbers, thicknesses=asked.thicknesses, conics=asked.conics, aspheres=asked.aspheres,
        aspheric=of_aspheres, stop=asked.move_stop,
    )  # fmt: skip
    with Progress("refining", preparing=True) as progress:
        found = refine_from_several(
            start, task, freedom, starts=asked.starts, seed=asked.seed,
            grow=grow, steps=asked.steps, on_progress=progress.count,
        )  # fmt: skip
    _say(current, start, found, task)
    if asked.out is not None:
        write_lens(found, asked.out)
        current.say(f"wrote {asked.out}")


def _say(current: Session, start: Lens, found: Lens, task: Task) -> None:
    from lensshift.optics.paraxial import paraxial
    from lensshift.optics.refine import ray_error_um
    from lensshift.optics.which import judged_lpmm, least_mtf

    data, errors = paraxial(found), {}
    shares = ", ".join(f"{share:g}" for share in task.shares)
    current.say(f"rms of rays in um, from the centre to the corner ({shares} of the way)")
    for name, lens in (("start", start), ("found", found)):
        errors[name] = ray_error_um(lens, task)
        current.say(f"  {name:<8}" + " ".join(f"{value:8.2f}" for value in errors[name]))
    length_mm = float(found.positions_mm()[-1])
    current.say(
        f"focal length {data.focal_length_mm:.4g} mm, f/{data.f_number:.3g}, "
        f"{length_mm:.4g} mm from the first vertex to the sensor"
    )
    highest_lpmm = judged_lpmm(task.grid)  # the Nyquist frequency of twice as many pixels
    least = {
        lpmm: least_mtf(found, task.grid, frequency_lpmm=lpmm, band=task.band)[0]
        for lpmm in (0.5 * highest_lpmm, highest_lpmm)
    }
    current.say(
        "least MTF over the sensor: "
        + ", ".join(f"{value:.3f} at {lpmm:.4g} LP/mm" for lpmm, value in least.items())
    )
    current.result |= {"ray_error_um": errors, "focal_length_mm": data.focal_length_mm}
    current.result |= {"f_number": data.f_number, "track_mm": length_mm}
    current.result["least_mtf"] = [{"lpmm": lpmm, "mtf": mtf} for lpmm, mtf in least.items()]


def _numbers(text: str) -> tuple[float, ...]:
    return parse_numbers(text, text.count(",") + 1, "numbers like 0.4,1") if text else ()


def _elements(lens: Lens, text: str) -> tuple[int, ...] | None:
    """Return numbers from 0, None if there are none."""
    numbers = _numbers(text)
    if not all(number.is_integer() and number >= 1 for number in numbers):
        raise typer.BadParameter(f"expected elements counted from 1, got {text!r}")
    return tuple(element_of(lens, int(number)) for number in numbers) or None
