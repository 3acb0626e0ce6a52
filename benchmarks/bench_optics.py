"""How fast the lens is computed, one process, one thread.

    pytest benchmarks/bench_optics.py

Beside it, where Optiland is installed: its geometric MTF of a single field.
"""

import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from lensshift.core.grid import Grid
from lensshift.core.pattern import named_pattern_px
from lensshift.forward.model import forward_model
from lensshift.optics.field import lens_field
from lensshift.optics.lens_file import load_lens
from lensshift.optics.mtf import fast_mtf, sensor_mtf
from lensshift.optics.otf import exact_mtf, exact_otf
from lensshift.optics.pupil import pupil_quadrature
from lensshift.optics.shift import shift_map
from lensshift.optics.tolerance import Tolerances, tolerance_analysis
from lensshift.optics.trace import Build, trace
from lensshift.optics.which import which_element
from lensshift.optics.zmx_writer import save_zmx

SENSOR = Grid((16, 64), (0.155, 0.155))
FREQUENCY_LPMM = np.linspace(0.9, 13.0, 15)
SQUARE_PX = named_pattern_px("square")
LENS = load_lens("petzval_a")


def fastest_s(work: Callable[[], object], rounds: int = 9) -> float:
    """Return the shortest wall time after one call to compile; other work only adds to it."""
    work()
    taken_s = []
    for _ in range(rounds):
        start_s = time.perf_counter()
        work()
        taken_s.append(time.perf_counter() - start_s)
    return min(taken_s)


def test_lens_field(report: list[str]) -> None:
    vga = Grid((480, 640), (0.0155, 0.0155))
    taken_s = fastest_s(lambda: lens_field(LENS, vga, 0), rounds=3)
    field = lens_field(LENS, vga, 0)
    shown_s = fastest_s(lambda: field.at(field.states(SQUARE_PX)))
    report.append(
        f"lens field of VGA fitted / evaluated {taken_s:8.3f} / {shown_s:.3f} s   wanted 0.5"
    )


@pytest.mark.parametrize("shape", [(16, 64), (120, 160), (480, 640)])
def test_blur_that_varies(report: list[str], shape: tuple[int, int]) -> None:
    # The same fields in pixels: smaller pixels would see wider spots.
    field = replace(lens_field(LENS, SENSOR, 0), grid=Grid(shape, SENSOR.pitch_mm))
    shown = field.at(field.states(SQUARE_PX))
    shifts = {"shift_field_px": shown.offset_px}
    models = (
        forward_model(shape, 2, SQUARE_PX),
        forward_model(shape, 2, **shifts),
        forward_model(shape, 2, **shifts, spot_px2=shown.spot_px2),
    )
    x = np.random.default_rng(0).random(models[0].hr_shape).astype(np.float32)
    operators = [model.operator for model in models]
    one_s, shifts_s, spots_s = (fastest_s(lambda A=A: A.adjoint(A(x))) for A in operators)
    report.append(
        f"blur over {shape[1]} x {shape[0]} pixels: {spots_s / one_s:.2f} times one blur and "
        f"shift, {spots_s / shifts_s:.2f} times one blur with the same shifts"
    )


def test_blur_that_leans(report: list[str]) -> None:
    field = lens_field(load_lens("al2550"), Grid((48, 64), SENSOR.pitch_mm), 0)
    shown = replace(field, grid=Grid((120, 160), SENSOR.pitch_mm)).at(field.states(SQUARE_PX))
    known = {"shift_field_px": shown.offset_px, "skew_px3": shown.skew_px3}
    leaning, upright = (
        forward_model((120, 160), 2, **known, spot_px2=spot_px2).operator
        for spot_px2 in (shown.spot_px2, shown.spot_px2[..., :2])
    )
    x = np.random.default_rng(0).random((240, 320)).astype(np.float32)
    leaning_s, upright_s = (fastest_s(lambda A=A: A.adjoint(A(x))) for A in (leaning, upright))
    report.append(
        f"blur that leans behind a singlet {leaning_s / upright_s:.2f} times upright blur"
    )


def test_shift_map(report: list[str]) -> None:
    taken_s = fastest_s(lambda: shift_map(LENS, 0, [0.0, 0.0444], SENSOR))
    report.append(f"shift map of 64 x 16 pixels          {taken_s:8.3f} s   wanted 0.1")


def test_mtf_over_the_sensor(report: list[str]) -> None:
    taken_s = fastest_s(lambda: sensor_mtf(LENS, SENSOR, FREQUENCY_LPMM))
    report.append(f"MTF of 1024 pixels, 15 frequencies   {taken_s:8.3f} s   wanted 0.5")


def test_exact_mtf_of_a_field(report: list[str]) -> None:
    taken_s = fastest_s(lambda: exact_mtf(LENS, [0.0, 0.11], FREQUENCY_LPMM))
    report.append(f"exact MTF of a field, 15 frequencies {taken_s:8.3f} s")


def test_exact_mtf_of_a_finely_sampled_pupil(report: list[str]) -> None:
    taken_s = fastest_s(lambda: exact_otf(LENS, [0.0, 0.11], [6.452], 0.0, samples=1024), rounds=3)
    report.append(f"the same, one frequency, 1024 across {taken_s:8.3f} s   wanted 0.5")


def test_builds(report: list[str]) -> None:
    taken_s = fastest_s(
        lambda: tolerance_analysis(LENS, 0, SENSOR, Tolerances(), builds=1000), rounds=1
    )
    report.append(f"1000 builds x 5 x 9 x 4, refocused   {taken_s:8.3f} s   wanted 10")


def test_which_element(report: list[str]) -> None:
    taken_s = fastest_s(lambda: which_element(LENS, SENSOR), rounds=1)
    report.append(f"which element to move, 3 elements    {taken_s:8.3f} s")


def test_rays_of_many_builds(report: list[str]) -> None:
    rng = np.random.default_rng(0)
    points, _ = pupil_quadrature(5, 15)
    decenter = rng.uniform(-0.05, 0.05, (250, 5, 1, 3, 2))
    tilt = rng.uniform(-0.002, 0.002, (250, 1, 1, 3, 2))
    fields = rng.uniform(-0.1, 0.1, (9, 2))
    build = Build(decenter_mm=decenter, tilt_rad=tilt)
    taken_s = fastest_s(lambda: trace(LENS, fields, points, build=build), rounds=3)
    rays = 250 * 5 * 9 * len(points)
    report.append(f"{rays} rays, 250 builds x 5 x 9     {taken_s:8.3f} s   {rays / taken_s:.2g}/s")


@pytest.mark.filterwarnings("ignore")  # theirs
def test_optiland_one_field(report: list[str], tmp_path: object) -> None:
    reading = pytest.importorskip("optiland.fileio")
    mtf = pytest.importorskip("optiland.mtf")
    save_zmx(LENS, f"{tmp_path}/lens.zmx")
    optic = reading.load_zemax_file(f"{tmp_path}/lens.zmx")
    taken_s = fastest_s(
        lambda: mtf.GeometricMTF(optic, fields=[(0, 0)], wavelength=0.85, num_rays=64), rounds=3
    )
    ours_s = fastest_s(lambda: fast_mtf(LENS, [(0.0, 0.0)], FREQUENCY_LPMM))
    report.append(
        f"geometric MTF of one field, Optiland {taken_s:8.3f} s, here {ours_s:.4f} s, "
        f"ratio {taken_s / ours_s:.0f}"
    )
