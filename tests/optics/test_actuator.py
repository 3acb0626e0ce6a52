"""What an actuator's errors do to the shifts, and what wrong shifts cost."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lensshift.core.errors import QualityWarning
from lensshift.core.grid import Grid
from lensshift.optics.actuator import (
    Actuator,
    actuator_budget,
    format_budget,
    reconstruction_loss,
)
from lensshift.optics.lens_file import load_lens
from lensshift.optics.shift import shift_map

SENSOR = Grid((5, 17), (0.5, 0.6))
LENS = load_lens("petzval_a")
BURSTS = 40_000


def errors_of_bursts(name: str) -> np.ndarray:
    """Return [burst frame] what an error of 3 um does to four frames, played through."""
    rng = np.random.default_rng(1)
    if name == "repeatability":
        return rng.normal(0.0, 3.0, (BURSTS, 4))
    if name == "backlash":
        return np.where(rng.random((BURSTS, 4)) < 0.5, 0.0, 3.0)
    if name == "encoder":
        wanted_um = rng.uniform(-100.0, 100.0, (BURSTS, 4))
        return 3.0 * np.round(wanted_um / 3.0) - wanted_um
    return np.tile(np.arange(4) / 3.0 * 3.0, (BURSTS, 1))


@pytest.mark.parametrize("name", ["repeatability", "backlash", "encoder", "drift"])
def test_each_error_alone_spreads_the_frames_of_a_burst(name: str) -> None:
    actuator = Actuator(**{f"{name}_um": 3.0})
    spread_um = math.sqrt(errors_of_bursts(name).var(axis=1, ddof=1).mean())
    rms_um = actuator.rms_um()
    assert rms_um[name] == pytest.approx(spread_um, rel=0.01)
    budget = actuator_budget(LENS, 0, SENSOR, actuator)
    assert budget.shift_error_px == pytest.approx(rms_um[name] * budget.largest_px_per_um)
    assert sum(budget.parts_px.values()) == pytest.approx(budget.shift_error_px)


@given(*[st.floats(0.0, 50.0)] * 4)
def test_variances_add(repeat_um: float, backlash_um: float, step_um: float, drift: float) -> None:
    actuator = Actuator(repeat_um, backlash_um, step_um, drift)
    variance = repeat_um**2 + backlash_um**2 / 4 + step_um**2 / 12 + drift**2 * 5 / 27
    assert math.hypot(*actuator.rms_um().values()) == pytest.approx(math.sqrt(variance))


def test_a_budget_adds_its_parts_in_quadrature() -> None:
    budget = actuator_budget(LENS, 0, SENSOR, Actuator(0.5, 1.0, 2.0, 3.0))
    assert budget.shift_error_px == pytest.approx(math.hypot(*budget.parts_px.values()))
    assert (budget.psnr_loss_db, budget.mtf50_loss) == reconstruction_loss(
        budget.shift_error_px, 0.005
    )


@pytest.mark.parametrize("element", [0, 1])
def test_a_micrometre_shifts_the_image_by_the_sensitivity(element: int) -> None:
    budget = actuator_budget(LENS, element, SENSOR, Actuator())
    steps_mm = [[1e-3, 0.0], [0.0, 1e-3]]
    traced_px = np.linalg.norm(shift_map(LENS, element, steps_mm, SENSOR).offset_px, axis=-1)
    assert budget.largest_px_per_um == pytest.approx(traced_px.max(), rel=1e-3)


@pytest.mark.parametrize(("name", "stroke_um"), [("petzval_a", 44.4), ("petzval_b", 44.1)])
def test_the_stroke_of_a_quarter_pixel(name: str, stroke_um: float) -> None:
    grid = Grid((16, 64), (0.155, 0.155))
    budget = actuator_budget(load_lens(name), 0, grid, Actuator())
    assert budget.stroke_um == pytest.approx(stroke_um, abs=0.3)


def test_no_error_costs_nothing() -> None:
    budget = actuator_budget(LENS, 1, SENSOR, Actuator())
    assert set(budget.parts_px.values()) == {0.0}
    assert (budget.shift_error_px, budget.psnr_loss_db, budget.mtf50_loss) == (0.0, 0.0, 0.0)


def test_losses_grow_with_the_error_and_hide_in_noise() -> None:
    for noise in (0.005, 0.02):
        small, large = (np.array(reconstruction_loss(error_px, noise)) for error_px in (0.02, 0.1))
        assert np.all(large > small)
    assert reconstruction_loss(0.1, 0.02)[0] < reconstruction_loss(0.1, 0.005)[0]
    # The geometric mean of the two noises lies half way, and so does the mean of two errors.
    ends = [reconstruction_loss(0.1, noise) for noise in (0.005, 0.02)]
    assert reconstruction_loss(0.1, 0.01) == pytest.approx(np.mean(ends, axis=0))
    ends = [reconstruction_loss(error_px, 0.02) for error_px in (0.05, 0.1)]
    assert reconstruction_loss(0.075, 0.02) == pytest.approx(np.mean(ends, axis=0))


def test_the_budget_is_told_in_full() -> None:
    text = format_budget(actuator_budget(LENS, 1, SENSOR, Actuator(repeatability_um=4.0)))
    first, *parts, together, cost = text.splitlines()
    assert first.startswith("element 2: stroke ")
    assert [part.split()[0] for part in parts] == ["repeatability", "backlash", "encoder", "drift"]
    assert together.split()[-3] == parts[0].split()[-3]
    assert cost.endswith("% of MTF50")


def test_an_error_that_seemed_to_help_by_chance_costs_nothing() -> None:
    """Bursts of 0.01 px measured -0.04 and -0.03 dB."""
    for noise in (0.005, 0.01, 0.02):
        for error_px in (0.004, 0.01, 0.012):
            assert min(reconstruction_loss(error_px, noise)) >= 0.0


@pytest.mark.parametrize(("error_px", "noise"), [(0.11, 0.005), (0.01, 0.001), (0.01, 0.1)])
def test_what_was_not_simulated_warns(error_px: float, noise: float) -> None:
    with pytest.warns(QualityWarning, match="outside what was simulated: up to 0.1 px, noise"):
        got = reconstruction_loss(error_px, noise)
    ends = min(error_px, 0.1), min(max(noise, 0.005), 0.02)
    assert got == pytest.approx(reconstruction_loss(*ends))


def test_bad_requests() -> None:
    for wrong in (-1.0, math.nan, math.inf):
        with pytest.raises(ValueError, match="errors of at least 0 um"):
            Actuator(backlash_um=wrong)
    for error_px, noise in ((-0.1, 0.01), (math.nan, 0.01), (0.01, 0.0), (0.01, math.nan)):
        with pytest.raises(ValueError, match="shift_error_px >= 0 and noise > 0"):
            reconstruction_loss(error_px, noise)
    with pytest.raises(ValueError, match="element from 0 to 2, got 3"):
        actuator_budget(LENS, 3, SENSOR, Actuator())
