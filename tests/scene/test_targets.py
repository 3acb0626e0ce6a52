"""Targets as a camera of 64 x 16 pixels sees them from the origin."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import label

from lensshift.scene import (
    Hits,
    Scene,
    cast,
    four_boxes,
    siemens_star_card,
    slanted_depth_step,
    slanted_edge_card,
    zone_plate_card,
)

PITCH_MM, FOCAL_MM = 0.15, 42.7
SLOPE = np.tan(np.deg2rad(10))


def seen_by_pixels(scene: Scene, samples: int = 9) -> tuple[Hits, NDArray[np.float64]]:
    """Return what the middles of sub-pixels see, and their (x, y) at z = 1, [row col 2]."""
    row = (np.arange(16 * samples) + 0.5) / samples - 0.5
    col = (np.arange(64 * samples) + 0.5) / samples - 0.5
    x, y = np.meshgrid((col - 31.5) * PITCH_MM / FOCAL_MM, (row - 7.5) * PITCH_MM / FOCAL_MM)
    return cast(scene, np.stack([x, y, np.ones_like(x)], axis=-1)), np.stack([x, y], axis=-1)


def test_the_edge_card_is_600_mm_wide_and_its_edge_crosses_the_axis() -> None:
    seen, at = seen_by_pixels(slanted_edge_card())
    card = np.abs(at[..., 0]) < 0.3 / 3.5
    np.testing.assert_allclose(seen.point_m[card][:, 2], 3.5)
    np.testing.assert_allclose(seen.point_m[~card][:, 2], 4.0)
    length = np.sqrt(1 + np.sum(at**2, axis=-1))
    np.testing.assert_allclose(seen.distance_m[card], 3.5 * length[card])
    np.testing.assert_allclose(seen.cos_incidence, 1 / length)
    right_of_edge = at[..., 0] > at[..., 1] * SLOPE
    np.testing.assert_array_equal(seen.reflectance[card & right_of_edge], 0.85)
    np.testing.assert_array_equal(seen.reflectance[card & ~right_of_edge], 0.05)
    np.testing.assert_array_equal(seen.reflectance[~card], 0.04)


def test_the_depth_step_has_the_same_edge_in_distance() -> None:
    scene = slanted_depth_step(near_m=3.0, step_m=0.25, near_reflectance=0.2, far_reflectance=0.6)
    seen, at = seen_by_pixels(scene)
    right_of_edge = at[..., 0] > at[..., 1] * SLOPE
    np.testing.assert_allclose(seen.point_m[..., 2], np.where(right_of_edge, 3.25, 3.0))
    np.testing.assert_array_equal(seen.reflectance, np.where(right_of_edge, 0.6, 0.2))
    other, _ = seen_by_pixels(slanted_depth_step(-np.deg2rad(10), near_m=3.0, step_m=0.25))
    np.testing.assert_allclose(other.distance_m, seen.distance_m[::-1])


def test_four_boxes_stand_apart_before_the_wall() -> None:
    scene = four_boxes()
    seen, _ = seen_by_pixels(scene)
    wall = np.isclose(seen.point_m[..., 2], 4.0)
    boxes, count = label(~wall)
    assert count == 4
    edge_of_image = np.concatenate([boxes[0], boxes[-1], boxes[:, 0], boxes[:, -1]])
    np.testing.assert_array_equal(edge_of_image, 0)
    reflectance = [np.unique(seen.reflectance[boxes == n]) for n in range(1, 5)]
    assert all(values.size == 1 for values in reflectance)
    assert len({float(values[0]) for values in reflectance}) == 4
    volumes_m3 = {np.prod(box.size_m) for box in scene.objects}
    turns_rad = {box.turn_rad for box in scene.objects}
    assert len(volumes_m3) == len(turns_rad) == 4
    smallest = min(scene.objects, key=lambda box: np.prod(box.size_m))
    assert smallest.centre_m[0] == min(box.centre_m[0] for box in scene.objects)
    # Its front is upright: 60 mm at 3.27 m in front of the lens.
    left_most = boxes == boxes.T[boxes.T > 0][0]
    sub_px = 0.06 / 3.27 * FOCAL_MM / PITCH_MM * 9
    assert np.ptp(np.flatnonzero(left_most.any(axis=1))) + 1 == pytest.approx(sub_px, abs=1)


def test_the_star_fills_the_height_and_has_its_cycles() -> None:
    seen, at = seen_by_pixels(siemens_star_card(cycles=8, dark=0.1, bright=0.7))
    place_m = 3.5 * at
    radius_m = np.hypot(place_m[..., 0], place_m[..., 1])
    assert 0.08 < 3.5 * np.abs(at[..., 1]).max() < 0.11
    star = radius_m < 0.095
    angle_rad = np.arctan2(place_m[..., 1], place_m[..., 0])
    np.testing.assert_allclose(
        seen.reflectance[star], 0.4 + 0.3 * np.sin(8 * angle_rad[star]), atol=1e-9
    )
    sharp, _ = seen_by_pixels(siemens_star_card(binary=True, distance_m=2.0))
    assert set(np.unique(sharp.reflectance)) == {0.05, 0.85, 0.45}
    assert sharp.distance_m.min() == pytest.approx(2.0, rel=1e-4)


def test_the_zone_plate_ends_at_one_pixel_a_ring() -> None:
    x_m = np.linspace(-0.4, 0.4, 8001)
    direction = np.stack([x_m, 0 * x_m, np.full_like(x_m, 3.5)], axis=-1)
    seen = cast(zone_plate_card(dark=0.0, bright=1.0), direction)
    middle_row = seen.reflectance
    rings = (middle_row[1:-1] > middle_row[:-2]) & (middle_row[1:-1] >= middle_row[2:])
    # Phase pi r^2 / (radius finest): the rings up to the rim, right and left, and the middle.
    inside = rings & (np.abs(x_m[1:-1]) < 0.279)
    assert np.count_nonzero(inside) == 2 * np.floor(0.28 / (2 * 0.0125)) + 1


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: slanted_depth_step(1.0), "slant_rad from"),
        (lambda: slanted_depth_step(step_m=0.0), "positive step_m"),
        (lambda: slanted_depth_step(near_reflectance=3.0), "reflectance from 0 to 1"),
        (lambda: slanted_edge_card(bright=1.5), "bright from 0 to 1"),
        (lambda: slanted_edge_card(distance_m=-1.0), "positive distance_m"),
        (lambda: zone_plate_card(0.0), "positive radius_m"),
        (lambda: siemens_star_card(cycles=1.5), "whole number of cycles"),
    ],
)
def test_targets_say_what_they_expect(make, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make()
