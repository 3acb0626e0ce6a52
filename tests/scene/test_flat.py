"""Targets: what they look like where geometry says so."""

import numpy as np
import pytest

from lensshift.scene import (
    BACKGROUND,
    Box,
    boxes,
    demo_target,
    in_a_row,
    line_pairs,
    siemens_star,
    slanted_edge,
)


def test_slanted_edge_moves_right_as_it_goes_down() -> None:
    slant_rad = np.deg2rad(10)
    edge = slanted_edge(slant_rad, dark=0.2, bright=0.8)
    row_mm = np.array([-1.0, 0.0, 2.0])
    on_edge_mm = row_mm * np.tan(slant_rad)
    np.testing.assert_array_equal(edge(row_mm, on_edge_mm - 1e-6), 0.2)
    np.testing.assert_array_equal(edge(row_mm, on_edge_mm + 1e-6), 0.8)


def test_siemens_star_has_its_cycles_on_every_circle_and_ends_at_its_radius() -> None:
    star = siemens_star(2.0, cycles=7, dark=0.1, bright=0.9)
    angle_rad = np.linspace(0, 2 * np.pi, 7000, endpoint=False) + 1e-4
    for radius_mm in (0.3, 1.9):
        ring = star(radius_mm * np.sin(angle_rad), radius_mm * np.cos(angle_rad))
        assert set(np.unique(ring)) == {0.1, 0.9}
        assert np.count_nonzero(ring != np.roll(ring, 1)) == 14
        assert ring.mean() == pytest.approx(0.5, abs=1e-3)
    assert star(np.array([0.0]), np.array([2.01]))[0] == BACKGROUND


def test_line_pairs_have_their_periods_from_top_to_bottom() -> None:
    lines = line_pairs((0.5, 0.25), size_mm=4.0, dark=0.0, bright=1.0)
    col_mm = np.linspace(-1.5, 1.5, 3001)[:-1] + 1e-5
    for row_mm, period_mm in ((-1.0, 0.5), (1.0, 0.25)):
        band = lines(np.full_like(col_mm, row_mm), col_mm)
        changes = np.count_nonzero(band != np.roll(band, 1))
        assert changes == round(2 * 3.0 / period_mm)


def test_boxes_hide_each_other_and_turn_from_rows_to_columns() -> None:
    long_and_thin = Box((0.5, -0.25), (4.0, 0.2), 0.6, turn_rad=np.deg2rad(30))
    target = boxes([long_and_thin, Box((0.5, -0.25), (0.1, 0.1), 0.9)])
    step_mm = 1.8
    end = (0.5 + step_mm * np.cos(np.deg2rad(30)), -0.25 + step_mm * np.sin(np.deg2rad(30)))
    row_mm, col_mm = np.array([0.5, end[0], end[0]]), np.array([-0.25, end[1], -0.25])
    np.testing.assert_array_equal(target(row_mm, col_mm), [0.9, 0.6, BACKGROUND])


@pytest.mark.parametrize("downwards", [False, True])
def test_cells_keep_their_targets_upright(downwards: bool) -> None:
    edge = slanted_edge(0.0, dark=0.0, bright=1.0)
    row_mm, col_mm = np.meshgrid([-1.2, -0.8, 0.8, 1.2], [-1.2, -0.8, 0.8, 1.2], indexing="ij")
    seen = in_a_row([edge, edge], 2.0, downwards=downwards)(row_mm, col_mm)
    # Side by side, the edges lie at col -1 and +1; below each other, both at col 0.
    right_of_edge = col_mm > 0 if downwards else np.isin(col_mm, (-0.8, 1.2))
    outside = np.abs(col_mm if downwards else row_mm) > 1
    expected = np.where(outside, BACKGROUND, right_of_edge.astype(float))
    np.testing.assert_array_equal(seen, expected)


@pytest.mark.parametrize("size_mm", [(2.5, 9.9), (9.9, 2.5), (5.0, 4.0)])
def test_demo_target_fits_any_sensor(size_mm: tuple[float, float]) -> None:
    row_mm = np.linspace(-0.5, 0.5, 301)[:, None] * size_mm[0]
    col_mm = np.linspace(-0.5, 0.5, 303)[None, :] * size_mm[1]
    seen = demo_target(size_mm)(row_mm, col_mm)
    assert seen.shape == (301, 303)
    assert seen.min() >= 0
    assert seen.max() <= 0.9
    assert np.unique(seen).size >= 8
    with pytest.raises(ValueError, match="positive size_mm"):
        demo_target((0.0, 1.0))
