"""Patterns sample a pixel evenly, about its middle, in steps to neighbours."""

import numpy as np
import pytest

from lensshift.core.pattern import grid_pattern_px, named_pattern_px


@pytest.mark.parametrize("per_side", [1, 2, 3, 5])
def test_places_are_even_central_and_neighbours(per_side: int) -> None:
    offset_px = grid_pattern_px(per_side)
    assert offset_px.shape == (per_side**2, 2)
    np.testing.assert_allclose(offset_px.mean(axis=0), 0.0, atol=1e-15)
    for axis in (0, 1):
        places = np.unique(offset_px[:, axis].round(9))
        assert len(places) == per_side
        np.testing.assert_allclose(np.diff(places), 1 / per_side, atol=1e-8)
    steps = np.abs(np.diff(offset_px, axis=0))
    np.testing.assert_allclose(steps.max(axis=1, initial=0), 1 / per_side, atol=1e-12)
    assert np.all((steps > 1e-9).sum(axis=1) == 1)


def test_the_square_is_a_quarter_pixel_to_all_sides() -> None:
    square = {tuple(place) for place in named_pattern_px("square")}
    assert square == {(a, b) for a in (-0.25, 0.25) for b in (-0.25, 0.25)}
    np.testing.assert_array_equal(named_pattern_px("still"), np.zeros((1, 2)))
    with pytest.raises(ValueError, match="spiral"):
        named_pattern_px("spiral")
