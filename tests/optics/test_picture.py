"""The closed form of what a reconstruction leaves, against drawn scenes and limits."""

import numpy as np
import pytest

from lensshift.core.grid import Grid
from lensshift.core.pattern import named_pattern_px
from lensshift.optics.lens_file import load_lens
from lensshift.optics.picture import format_scores, linear_rmse, picture_score

SENSOR = Grid((16, 64), (0.155, 0.155))


def clear(frames: int):  # type: ignore[no-untyped-def]
    return lambda frequency: np.ones((frames, *frequency.shape[:-1]), dtype=complex)


def test_limits() -> None:
    square, dense = named_pattern_px("square"), named_pattern_px("4x4")
    # Sixteen places see all sixteen aliases; without noise nothing is lost.
    assert linear_rmse(dense, clear(16), 1e-9) < 1e-5
    # Drowned in noise the best guess is the mean: the whole scene is lost.
    lost = linear_rmse(square, clear(4), 1e6)
    assert lost == pytest.approx(linear_rmse(square, clear(4), 1e7), rel=1e-6)
    assert 0.8 * 0.2 < lost < 0.2
    errors = [linear_rmse(square, clear(4), 0.005, px) for px in (0.0, 0.01, 0.03, 0.1)]
    assert errors == sorted(errors)
    still = linear_rmse(named_pattern_px("still"), clear(1), 0.0025)
    assert errors[0] < 0.8 * still
    # Moving everything by the same amount changes nothing.
    moved = linear_rmse(square + np.array([0.13, -0.2]), clear(4), 0.005, 0.01)
    assert moved == pytest.approx(errors[1], rel=1e-9)


def test_score_prefers_the_element_that_is_less_sensitive() -> None:
    lens = load_lens("petzval_a")
    exact = [picture_score(lens, element, SENSOR, actuator_um=0.0) for element in (0, 1)]
    rough = [picture_score(lens, element, SENSOR, actuator_um=0.5) for element in (0, 1)]
    assert exact[0].rmse == exact[0].rmse_exact
    assert exact[0].rmse == pytest.approx(exact[1].rmse, rel=0.01)
    # What the actuator adds goes with the square of the sensitivity.
    added = [one.rmse**2 - one.rmse_exact**2 for one in rough]
    ratio = (rough[1].shift_error_px / rough[0].shift_error_px) ** 2
    assert added[1] / added[0] == pytest.approx(ratio, rel=0.05)
    assert rough[0].shift_error_px == pytest.approx(0.5 * 0.0056, rel=0.02)
    assert len(format_scores(["a", "b"], rough).splitlines()) == 3
    with pytest.raises(ValueError, match="noise > 0"):
        picture_score(lens, 0, SENSOR, noise=0.0)
