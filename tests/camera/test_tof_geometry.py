"""Where things appear: shifts, apertures, blur, mixed pixels, the truth."""

from dataclasses import replace

import numpy as np
import pytest
from tof_worlds import (
    EXACT,
    FOCAL_MM,
    HZ,
    ODD,
    make_camera,
    near_edge,
    phasors,
    still,
    stripes,
    wall,
    wave_of,
)

from lensshift.camera import Pixels, PlainOptics, camera_preset, simulate_tof, simulate_tof_burst
from lensshift.camera.flat import QUARTER_SQUARE_PX
from lensshift.core.grid import Grid
from lensshift.scene import Edge, Plane, Rectangle, Scene, cast, four_boxes

SHIFTS_PX = np.array([(0.25, -0.25), (0.113, 0.387), (-0.731, 0.0401), (0.0, 0.9999)])


@pytest.mark.parametrize("down", [False, True])
def test_waves_move_by_exactly_the_offset(down: bool) -> None:
    per_px = 0.23
    scene = wall(3.5, stripes(per_px, 3.5, down=down))
    burst, _ = simulate_tof_burst(scene, make_camera(), SHIFTS_PX, **EXACT)
    lines = burst.amplitude.mean(axis=2) if down else burst.amplitude.mean(axis=1)
    moved_px = [-np.angle(wave_of(line, per_px)) / (2 * np.pi * per_px) for line in lines]
    # Positive: down and right.
    np.testing.assert_allclose(moved_px, SHIFTS_PX[:, 0 if down else 1], atol=2e-4)


@pytest.mark.parametrize("slant_deg", [0.0, 3.0, 10.0, -37.0])
def test_edges_move_by_the_offset(slant_deg: float) -> None:
    square = Grid((9, 13), (0.2, 0.2))
    slant_rad = np.deg2rad(slant_deg)
    scene = wall(3.5, Edge(slant_rad, 0.1, 0.9))
    burst, _ = simulate_tof_burst(scene, make_camera(square), SHIFTS_PX, **EXACT)
    share = (burst.amplitude / burst.amplitude.max() - 1 / 9) / (1 - 1 / 9)
    edge_px = 12.5 - share.sum(axis=2)  # of each row of each frame
    row_px = np.arange(9) - 4.0
    expected = 6.0 + SHIFTS_PX[:, None, 1] + np.tan(slant_rad) * (row_px - SHIFTS_PX[:, None, 0])
    inside = np.abs(expected - 6.0) < 5.0
    error_px = (edge_px - expected)[inside]
    assert np.abs(error_px).max() < 0.002
    assert np.abs(error_px.mean()) < 1e-4


def test_shift_errors_are_as_large_as_said_and_unknown_to_the_burst() -> None:
    planned = np.tile(QUARTER_SQUARE_PX, (60, 1))
    tiny = make_camera(Grid((1, 3), (0.1, 0.1)))
    burst, truth = simulate_tof_burst(wall(), tiny, planned, shift_error_px=0.03, seed=3)
    np.testing.assert_array_equal(burst.offset_px, planned)
    np.testing.assert_array_equal(burst.offset_sigma_px, 0.03)
    error_px = truth.offset_px - planned
    assert error_px.std() == pytest.approx(0.03, rel=0.12)
    assert np.abs(error_px.mean(axis=0)).max() < 0.01


def test_the_truth_knows_the_offset() -> None:
    per_px = 0.21
    scene = wall(3.5, stripes(per_px, 3.5))
    burst, truth = simulate_tof_burst(scene, make_camera(), shift_error_px=0.1, seed=1)
    lines = burst.amplitude.mean(axis=1)
    moved_px = [-np.angle(wave_of(line, per_px)) / (2 * np.pi * per_px) for line in lines]
    np.testing.assert_allclose(moved_px, truth.offset_px[:, 1], atol=2e-4)
    assert np.abs(truth.offset_px - burst.offset_px).max() > 0.05


@pytest.mark.parametrize(("fill", "sigma_px"), [(1.0, 0.0), (0.36, 0.0), (0.6, 0.25), (1.0, 0.05)])
def test_contrast_is_aperture_times_blur(fill: float, sigma_px: float) -> None:
    per_px = 0.41
    optics = PlainOptics(FOCAL_MM, 2.0, blur_sigma_px=sigma_px)
    camera = make_camera(optics=optics, pixels=Pixels(fill_factor=fill))
    seen = still(wall(3.5, stripes(per_px, 3.5)), camera).burst.amplitude[0].mean(axis=0)
    contrast = 0.5 * np.sinc(per_px * fill**0.5) * np.exp(-2 * (np.pi * per_px * sigma_px) ** 2)
    # Cells of 1/16 pixel: (f / 16)^2 is the share of their first alias.
    assert wave_of(seen, per_px) == pytest.approx(contrast, abs=2 * (per_px / 16) ** 2)


def test_light_is_in_proportion_to_the_sensitive_area() -> None:
    full, part = (
        still(wall(), make_camera(pixels=Pixels(fill_factor=fill))).burst.amplitude
        for fill in (1.0, 0.4)
    )
    np.testing.assert_allclose(part, 0.4 * full, rtol=1e-6)


@pytest.mark.parametrize("ratio", [0.2, 1.0, 6.0])
def test_a_mixed_pixel_averages_phasors(ratio: float) -> None:
    near_m, far_m, far = 3.2, 4.4, 0.15
    near = far * ratio * (near_m / far_m) ** 2
    edges_px = np.array([-0.5, -0.31, 0.0, 0.2, 0.44])
    for edge_px in edges_px:
        capture = still(near_edge(edge_px, near_m, far_m, near, far), make_camera())
        burst = capture.burst
        seen = phasors(burst.amplitude[0, 4, 6], burst.distance_m[0, 4, 6])
        share = 0.5 + edge_px
        mixed = share * ratio * phasors(1.0, near_m) + (1 - share) * phasors(1.0, far_m)
        unit = burst.amplitude[0, 4, 9]  # a pixel that sees the far wall alone
        step = abs(ratio * phasors(1.0, near_m) - phasors(1.0, far_m))
        assert abs(seen / unit - mixed) < 0.002 * step
        assert capture.truth.flying_in_frames[0, 4, 6] == (0 < share < 1)
        assert not capture.truth.flying_in_frames[0, 4, [3, 9]].any()
        assert burst.distance_m[0, 4, 3] == pytest.approx(near_m, abs=1e-5)


def test_distances_are_radial() -> None:
    wide = make_camera(optics=PlainOptics(1.2, 2.0))
    row = (np.arange(9) - 4) * ODD.pitch_mm[0] / 1.2
    col = (np.arange(13) - 6) * ODD.pitch_mm[1] / 1.2
    seen = still(wall(2.0), wide).burst.distance_m[0]
    expected = 2.0 * np.sqrt(1 + row[:, None] ** 2 + col**2)
    np.testing.assert_allclose(seen, expected, rtol=5e-3)


@pytest.mark.parametrize("scale", [2, 3])
def test_truth_is_what_smaller_pixels_see(scale: int) -> None:
    camera = make_camera(Grid((9, 31), (0.155, 0.155)), optics=PlainOptics(42.7, 2.1))
    capture = still(four_boxes(), camera, scale=scale)
    truth, burst = capture.truth, capture.burst
    assert truth.amplitude.shape == (9 * scale, 31 * scale)
    fine = phasors(truth.amplitude, truth.distance_m)
    binned = fine.reshape(9, scale, 31, scale).mean(axis=(1, 3))
    frame = phasors(burst.amplitude[0], burst.distance_m[0])
    np.testing.assert_allclose(binned, frame, atol=1e-9)
    np.testing.assert_array_equal(truth.sharp_amplitude, truth.amplitude)  # this lens is sharp
    np.testing.assert_array_equal(truth.sharp_distance_m, truth.distance_m)
    blurred = replace(camera, optics=replace(camera.optics, blur_sigma_px=0.3))
    through = still(four_boxes(), blurred, scale=scale).truth
    np.testing.assert_allclose(through.sharp_amplitude, truth.amplitude, rtol=1e-9)
    assert np.abs(through.amplitude - truth.amplitude).max() > 0.02 * truth.amplitude.max()
    assert truth.valid.all()
    assert truth.offset_field is None
    assert 0.02 < truth.flying.mean() < truth.flying_in_frames.mean() < 0.4


def test_flying_pixels_are_those_at_depth_edges() -> None:
    truth = still(near_edge(0.0, 3.0, 4.0, 0.3, 0.3), make_camera()).truth
    expected = np.zeros((18, 26), dtype=bool)
    np.testing.assert_array_equal(truth.flying, expected)  # the edge lies between HR pixels
    moved = still(near_edge(0.2, 3.0, 4.0, 0.3, 0.3), make_camera()).truth
    expected[:, 13] = True
    np.testing.assert_array_equal(moved.flying, expected)


def test_nothing_there_is_not_valid() -> None:
    scene = near_edge(0.0, 3.0, 4.0, 0.3, 0.3)
    capture = still(type(scene)(scene.objects), make_camera())
    assert capture.truth.valid[:, :13].all()
    assert not capture.truth.valid[:, 13:].any()
    assert capture.burst.valid[0, :, :7].all()
    assert not capture.burst.valid[0, :, 7:].any()


def test_a_frame_agrees_with_many_rays() -> None:
    """Compare with plain means over rays on a finer lattice, moved by hand."""
    offset_px = (0.25, -0.4)
    camera = camera_preset("o3m151").ideal()
    burst, _ = simulate_tof_burst(four_boxes(), camera, [offset_px], **EXACT)
    fill, count = 0.5**0.5, 60
    along = fill * ((np.arange(count) + 0.5) / count - 0.5)
    seen, expected = [], []
    for row, col in [(7, 10), (10, 9), (6, 24), (7, 36), (8, 39), (5, 52)]:
        down, right = np.meshgrid(
            row - 7.5 - offset_px[0] + along, col - 31.5 - offset_px[1] + along
        )
        slope = 0.155 / 42.7
        hits = cast(four_boxes(), np.stack([right * slope, down * slope, np.ones_like(down)], -1))
        light = hits.reflectance * hits.cos_incidence / hits.distance_m**2
        expected.append(np.mean(phasors(light, hits.distance_m)))
        seen.append(phasors(burst.amplitude[0, row, col], burst.distance_m[0, row, col]))
    ratio = np.array(seen) / np.array(expected)
    # One factor for all; the blur of 0.05 px of the preset stays below 1 % of the largest.
    np.testing.assert_allclose(ratio, ratio[0].real, rtol=2e-2)


def test_large_sensors_are_done_in_tiles(monkeypatch: pytest.MonkeyPatch) -> None:
    camera = make_camera(Grid((9, 31), (0.155, 0.155)), optics=PlainOptics(42.7, 2.1, 0.8, 0.2))
    whole = simulate_tof(four_boxes(), camera, seed=4)
    monkeypatch.setattr("lensshift.camera.footprints._CELLS_AT_ONCE", 40_000)
    tiled = simulate_tof(four_boxes(), camera, seed=4)
    np.testing.assert_allclose(tiled.burst.amplitude, whole.burst.amplitude, rtol=1e-9)
    np.testing.assert_allclose(tiled.burst.distance_m, whole.burst.distance_m, rtol=1e-9)
    np.testing.assert_allclose(tiled.truth.distance_m, whole.truth.distance_m, rtol=1e-9)


def test_a_shift_may_leave_but_a_corner_in_view() -> None:
    """Tiles that only a frame far away needs are beyond the reach of the others."""
    camera = make_camera(Grid((16, 64), (0.155, 0.155)))
    capture = simulate_tof(wall(), camera, [[0.0, 0.0], [15.5, 60.0]], scale=1, **EXACT)
    np.testing.assert_allclose(capture.burst.distance_m, 3.5, atol=5e-3)


def test_modulation_of_the_burst_is_that_of_the_camera() -> None:
    assert still(wall(), make_camera()).burst.modulation_hz == HZ


@pytest.mark.parametrize("seed", [1, 2])
def test_wires_thinner_than_a_cell_give_their_light(seed: int) -> None:
    """Of cards between a third of a cell and a whole one: their area, in most directions."""
    rng = np.random.default_rng(seed)
    camera, back = make_camera(Grid((12, 14), (0.1, 0.1))), Plane(centre_m=(0.0, 0.0, 4.0))
    bare = still(Scene((), back), camera).burst
    found = []
    for _ in range(15):
        length_px, width_px = rng.uniform(4, 8), rng.uniform(0.3, 0.9) / 16
        card = Rectangle(
            centre_m=(*rng.uniform(-1e-4, 1e-4, 2), 2.0),
            size_m=(1e-4 * length_px, 1e-4 * width_px),  # a pixel sees 0.1 mm there
            turn_rad=(0.0, 0.0, rng.uniform(0.0, np.pi)),
            reflectance=0.8,
        )
        wired = still(Scene((card,), back), camera).burst
        one, other = (phasors(each.amplitude[0], each.distance_m[0]) for each in (bare, wired))
        expected = length_px * width_px * (phasors(0.8 / 4, 2.0) - phasors(0.5 / 16, 4.0))
        found.append(abs((other - one).sum() / bare.amplitude.mean() * 0.5 / 16 / expected - 1.0))
    assert np.median(found) < 0.02
    assert np.percentile(found, 80) < 0.05


@pytest.mark.parametrize("turn", [0.0, 0.5])
def test_wires_along_rows_or_columns_lie_between_no_rays(turn: float) -> None:
    """Of cards of half a cell to a whole one wherever they lie: their area within 10 %."""
    rng = np.random.default_rng(int(2 * turn))
    camera, back = make_camera(Grid((12, 14), (0.1, 0.1))), Plane(centre_m=(0.0, 0.0, 4.0))
    bare = still(Scene((), back), camera).burst
    for width_px in rng.uniform(0.5, 1.0, 10) / 16:
        card = Rectangle(
            centre_m=(*rng.uniform(-1e-4, 1e-4, 2), 2.0),
            size_m=(8e-4, 1e-4 * width_px),
            turn_rad=(0.0, 0.0, np.pi * turn),
            reflectance=0.8,
        )
        wired = still(Scene((card,), back), camera).burst
        one, other = (phasors(each.amplitude[0], each.distance_m[0]) for each in (bare, wired))
        expected = 8.0 * width_px * (phasors(0.8 / 4, 2.0) - phasors(0.5 / 16, 4.0))
        seen = (other - one).sum() / bare.amplitude.mean() * 0.5 / 16
        assert abs(seen / expected - 1.0) < 0.1
