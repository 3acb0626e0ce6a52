"""Where pixels look, and the points that follow: closed forms, inverses, properties."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lensshift.core.errors import DataError, QualityWarning
from lensshift.core.grid import Grid
from lensshift.core.intrinsics import Pinhole, PixelDirections, points_m
from lensshift.core.point_cloud import PointCloud, make_cloud
from lensshift.core.types import Burst, Estimate, Reconstruction

SHAPE = (15, 21)
GRID = Grid(SHAPE, (0.15, 0.1))
BENT = Pinhole(30.0, 25.0, 9.3, 7.7, -0.2, 0.05, 0.003, -0.002, 0.01)
small = st.floats(-0.02, 0.02)


def projected(one: Pinhole, direction: np.ndarray) -> np.ndarray:
    """Return (col, row) of directions as OpenCV's manual has it, complex: x + i y."""
    z = (direction[..., 0] + 1j * direction[..., 1]) / direction[..., 2]
    square = abs(z) ** 2
    bent = z * (1 + one.k1 * square + one.k2 * square**2 + one.k3 * square**3)
    across = z.real * z.imag
    bent += 2 * one.p1 * across + one.p2 * (square + 2 * z.real**2)
    bent += 1j * (one.p1 * (square + 2 * z.imag**2) + 2 * one.p2 * across)
    return one.fx_px * bent.real + one.cx_px + 1j * (one.fy_px * bent.imag + one.cy_px)


@given(small, small, small, small, small, st.floats(20, 60), st.floats(20, 60))
def test_distortion_is_undone(
    k1: float, k2: float, k3: float, p1: float, p2: float, fx_px: float, fy_px: float
) -> None:
    one = Pinhole(fx_px, fy_px, 9.3, 7.7, k1, k2, p1, p2, k3)
    direction = one.directions(SHAPE)
    np.testing.assert_allclose(np.linalg.norm(direction, axis=-1), 1.0, rtol=1e-12)
    rows, cols = np.indices(SHAPE)
    np.testing.assert_allclose(projected(one, direction), cols + 1j * rows, atol=1e-9)


def test_distortion_that_folds_is_refused() -> None:
    with pytest.raises(ValueError, match="does not fold an image of 21 x 15"):
        Pinhole(12.0, 12.0, 10.0, 7.0, k1=-1.0).directions(SHAPE)
    with pytest.raises(ValueError, match="focal lengths above 0"):
        Pinhole(0.0, 12.0, 10.0, 7.0)


@pytest.mark.parametrize("one", [BENT, PixelDirections(BENT.directions(SHAPE))])
@pytest.mark.parametrize("scale", [2, 3])
def test_finer_pixels_look_between(one: Pinhole | PixelDirections, scale: int) -> None:
    fine = one.refine(scale).directions((SHAPE[0] * scale, SHAPE[1] * scale))
    rows, cols = np.indices(fine.shape[:2])
    place = ((cols + 0.5) + 1j * (rows + 0.5)) / scale - (0.5 + 0.5j)
    # Splines between pixels 2 degrees apart err by 1e-6 rad, half a pixel beyond the last by most.
    np.testing.assert_allclose(projected(BENT, fine), place, atol=1e-9 if one is BENT else 3e-4)


@pytest.mark.parametrize("one", [BENT, PixelDirections(BENT.directions(SHAPE))])
def test_a_part_of_the_image_looks_as_before(one: Pinhole | PixelDirections) -> None:
    part = one.crop(slice(3, 8), slice(5, 17)).directions((5, 12))
    np.testing.assert_allclose(part, one.directions(SHAPE)[3:8, 5:17], atol=1e-12)
    with pytest.raises(ValueError, match="from 0 on"):
        one.crop(slice(-3, None), slice(None))


def test_field_of_view_reaches_from_border_to_border() -> None:
    wide = Pinhole.of_field(GRID, np.deg2rad(70.0))
    border = np.array([-0.5, 20.5])
    angles = np.rad2deg(np.arctan((border - wide.cx_px) / wide.fx_px))
    np.testing.assert_allclose(angles, [-35.0, 35.0])
    # One lens: equal lengths in mm give equal tangents.
    assert wide.fy_px * GRID.pitch_mm[0] == pytest.approx(wide.fx_px * GRID.pitch_mm[1])
    assert wide == Pinhole.of_focal_length(GRID, wide.fx_px * GRID.pitch_mm[1])
    both = Pinhole.of_field(GRID, np.deg2rad(70.0), np.deg2rad(50.0))
    assert both.fy_px == pytest.approx(7.5 / np.tan(np.deg2rad(25.0)))
    assert wide.refine(2) == Pinhole.of_field(GRID.refine(2), np.deg2rad(70.0))
    with pytest.raises(ValueError, match="below 180 degrees"):
        Pinhole.of_field(GRID, np.pi)


def test_directions_of_another_sensor_are_refused() -> None:
    one = PixelDirections(BENT.directions((4, 5)))
    with pytest.raises(DataError, match="intrinsics: expected directions for"):
        Burst.from_arrays(np.ones((1, 5, 5)), offset_px=[[0, 0]], pitch_mm=0.1, intrinsics=one)
    with pytest.raises(ValueError, match="with a length"):
        PixelDirections(np.zeros((4, 5, 3)))
    with pytest.raises(ValueError, match=r"\[row col 3\]"):
        PixelDirections(np.ones((4, 5)))
    with pytest.raises(ValueError, match="two rows and columns"):
        PixelDirections(np.ones((1, 5, 3))).refine(2)


def wall_m(normal: np.ndarray, far_m: float, one: Pinhole = BENT) -> np.ndarray:
    """Return radial distances to the plane normal . point = far_m."""
    return np.asarray(far_m / (one.directions(SHAPE) @ normal))


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_wall_is_flat_and_has_its_normal(seed: int) -> None:
    rng = np.random.default_rng(seed)
    normal = np.array([*rng.uniform(-0.3, 0.3, 2), 1.0])
    normal /= np.linalg.norm(normal)
    distance_m = wall_m(normal, 3.0)
    distance_m[4, 7] = np.nan
    distance_m[5, 7] = 0.0
    cloud = make_cloud(distance_m, BENT, normals=True)
    assert len(cloud) == 15 * 21 - 2
    np.testing.assert_allclose(cloud.point_m @ normal, 3.0, rtol=1e-12)
    assert cloud.normal is not None
    known = np.isfinite(cloud.normal).all(axis=1)
    assert np.count_nonzero(~known) == 0
    np.testing.assert_allclose(cloud.normal[known], np.tile(-normal, (known.sum(), 1)), atol=1e-9)
    distances_m = np.linalg.norm(cloud.point_m, axis=1)
    np.testing.assert_allclose(distances_m, distance_m[cloud.row, cloud.col])


def test_normals_keep_to_their_surface_at_a_step() -> None:
    ahead = np.array([0.0, 0.0, 1.0])
    distance_m = np.where(np.arange(21) < 10, wall_m(ahead, 2.0), wall_m(ahead, 3.0))
    normal = make_cloud(distance_m, BENT, normals=True).normal
    assert normal is not None
    assert normal[:, 2].max() < -0.999


def make_result(**fields: object) -> Reconstruction:
    distance_m = wall_m(np.array([0.0, 0.0, 1.0]), 2.0)
    complete = {
        "amplitude": Estimate(np.full(SHAPE, 0.5)),
        "distance_m": Estimate(distance_m, uncertainty=0.01 * distance_m),
        "grid": GRID,
        "scale": 1,
        "method": "auto",
        "flying": np.arange(15 * 21).reshape(SHAPE) % 7 == 0,
        "intrinsics": BENT,
    }
    return Reconstruction(**(complete | fields))  # type: ignore[arg-type]


def test_flying_pixels_stay_out_unless_they_are_asked_for() -> None:
    result = make_result()
    assert result.flying is not None
    cloud, whole = result.point_cloud(), result.point_cloud(keep_flying=True)
    assert len(whole) - len(cloud) == np.count_nonzero(result.flying)
    assert cloud.flying is not None
    assert whole.flying is not None
    assert not cloud.flying.any()
    np.testing.assert_array_equal(whole.flying, result.flying.ravel())
    assert result.distance_m is not None
    assert result.distance_m.std is not None
    assert cloud.std_m is not None
    np.testing.assert_array_equal(cloud.std_m, result.distance_m.std[cloud.row, cloud.col])
    assert cloud.amplitude is not None
    assert np.all(cloud.amplitude == 0.5)
    np.testing.assert_array_equal(
        whole.point_m, points_m(result.distance_m.image, BENT).reshape(-1, 3)
    )


def test_a_camera_matrix_is_refused_with_what_it_becomes() -> None:
    matrix = np.array([[50.0, 0, 2], [0, 51, 3], [0, 0, 1]])
    with pytest.raises(DataError, match=r"intrinsics: expected Pinhole\(K\[0, 0\], .* ndarray"):
        Burst.from_arrays(np.ones((1, 5, 5)), intrinsics=matrix)  # type: ignore[arg-type]


def test_points_need_distances_and_intrinsics() -> None:
    with pytest.raises(ValueError, match="distance channel"):
        make_result(distance_m=None).point_cloud()
    with pytest.raises(ValueError, match="expected intrinsics"):
        make_result(intrinsics=None).point_cloud()
    field = Pinhole.of_field(GRID, 1.0)
    assert len(make_result(intrinsics=None).point_cloud(field)) == len(make_result().point_cloud())
    with pytest.raises(ValueError, match="expected std_m of shape"):
        make_cloud(np.ones(SHAPE), BENT, std_m=np.ones((2, 3)))
    with pytest.raises(ValueError, match=r"distances \[row col\]"):
        points_m(np.ones(3), BENT)
    with pytest.raises(ValueError, match="expected row of shape"):
        PointCloud(np.ones((4, 3)), np.ones(3, int), np.ones(4, int))


@pytest.mark.parametrize("shape", [(2, 2), (2, 9), (3, 2), (4, 3)])
def test_directions_of_few_pixels_are_refined_too(shape: tuple[int, int]) -> None:
    """Through two pixels goes a line, through three a parabola."""
    grid = Grid(shape, (0.1, 0.1))
    pinhole = Pinhole.of_field(grid, np.deg2rad(20.0))
    fine = PixelDirections(pinhole.directions(shape)).refine(2)
    wanted = pinhole.refine(2).directions((2 * shape[0], 2 * shape[1]))
    np.testing.assert_allclose(fine.direction, wanted, atol=3e-3)


@pytest.mark.parametrize("focal_length_mm", [0.0045, 4500.0])
def test_a_focal_length_in_metres_or_micrometres_is_questioned(focal_length_mm: float) -> None:
    Pinhole.of_focal_length(GRID, 4.5)
    with pytest.warns(QualityWarning, match="right unit"):
        Pinhole.of_focal_length(GRID, focal_length_mm)
    with pytest.warns(QualityWarning, match="right unit"):
        Pinhole.centred(GRID, 0.045)


@pytest.mark.parametrize("seed", range(5))
def test_intrinsics_of_an_image_of_another_size_are_questioned(seed: int) -> None:
    rng = np.random.default_rng(seed)
    grid, scale = Grid((int(rng.integers(16, 99)), int(rng.integers(16, 99))), (0.1, 0.1)), 2
    middle = Pinhole.of_field(grid, np.deg2rad(rng.uniform(10.0, 90.0)))
    right = replace(middle, cx_px=middle.cx_px * rng.uniform(0.96, 1.04))  # as lenses are mounted
    fine = right.refine(scale)
    result = make_result(
        distance_m=Estimate(np.full(grid.refine(scale).shape, 2.0)),
        amplitude=None, grid=grid.refine(scale), intrinsics=fine, flying=None,
    )  # fmt: skip
    result.point_cloud()  # without a warning, which tests take for an error
    for wrong in (right, fine.refine(2), right.refine(7)):
        with pytest.warns(QualityWarning, match="of another size"):
            result.point_cloud(wrong)
    with pytest.warns(QualityWarning, match="focal length"):
        result.point_cloud(replace(fine, fx_px=0.05 * fine.cx_px))  # of millimetres
    with pytest.raises(DataError, match=r"Pinhole\(K"):
        result.point_cloud(np.eye(3))  # type: ignore[arg-type]
