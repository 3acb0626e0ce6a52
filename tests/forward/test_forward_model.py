import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from independent_matrix import system_matrix
from operator_laws import check_linear_operator

from lensshift.forward.blur import ApertureBlur, GaussianBlur
from lensshift.forward.model import forward_model

BLURS = [GaussianBlur(0.3), GaussianBlur(0.0), ApertureBlur(), ApertureBlur(0.7, 0.2)]
SQUARE = [[0.25, 0.25], [0.25, -0.25], [-0.25, 0.25], [-0.25, -0.25]]


def a_field(shape, frames=2, seed=0, size_px=1.5):
    """Smooth, different along row and col, on a grid that no rounding touches."""
    rows, cols = np.meshgrid(*(np.linspace(-1, 1, n) for n in shape), indexing="ij")
    rng = np.random.default_rng(seed)
    a, b, c = rng.uniform(-size_px / 3, size_px / 3, (3, frames, 1, 1, 2))
    return np.round(16 * (a + b * rows[..., None] + c * (rows * cols)[..., None])) / 16


@pytest.mark.parametrize("blur", BLURS, ids=str)
@pytest.mark.parametrize("scale", range(1, 9))
def test_laws_for_constant_shifts(scale, blur, rng):
    offset_px = rng.uniform(-2, 2, (3, 2))
    model = forward_model((5, 7), scale, offset_px, blur=blur)
    assert model.hr_shape == (5 * scale, 7 * scale)
    check_linear_operator(model.operator, rng)


@pytest.mark.parametrize("blur", BLURS, ids=str)
@pytest.mark.parametrize("scale", range(1, 9))
def test_laws_for_shift_fields(scale, blur, rng):
    model = forward_model((5, 7), scale, shift_field_px=a_field((5, 7)), blur=blur)
    check_linear_operator(model.operator, rng)


@given(
    shape=st.tuples(st.integers(1, 9), st.integers(1, 9)),
    scale=st.integers(1, 8),
    offset=st.lists(st.tuples(*[st.floats(-4, 4)] * 2), min_size=1, max_size=3),
    blur=st.one_of(
        st.builds(GaussianBlur, st.floats(0, 1)),
        st.builds(ApertureBlur, st.floats(0.05, 1), st.floats(0, 0.6)),
    ),
)
@settings(deadline=None, max_examples=30)
def test_laws_for_anything(shape, scale, offset, blur):
    rng = np.random.default_rng(0)
    check_linear_operator(forward_model(shape, scale, offset, blur=blur).operator, rng)
    field = np.broadcast_to(np.array(offset)[:, None, None], (len(offset), *shape, 2))
    check_linear_operator(
        forward_model(shape, scale, shift_field_px=field, blur=blur).operator, rng
    )


@pytest.mark.parametrize("blur", BLURS, ids=str)
@pytest.mark.parametrize("scale", range(1, 9))
def test_constant_shifts_equal_the_independent_matrix(scale, blur, rng):
    shape = (4, 5)
    offset_px = np.round(64 * rng.uniform(-1.5, 1.5, (2, 2))) / 64
    A = forward_model(shape, scale, offset_px, blur=blur).operator
    field = np.broadcast_to(offset_px[:, None, None], (2, *shape, 2))
    matrix = system_matrix(shape, scale, field, blur)
    check_same(A, matrix, rng)


@pytest.mark.parametrize("blur", BLURS, ids=str)
@pytest.mark.parametrize("scale", [1, 2, 3, 5])
def test_shift_fields_equal_the_independent_matrix(scale, blur, rng):
    shape = (3, 4)
    field = a_field(shape, seed=scale)
    A = forward_model(shape, scale, shift_field_px=field, blur=blur).operator
    check_same(A, system_matrix(shape, scale, field, blur), rng)


def check_same(A, matrix, rng):
    x, y = rng.standard_normal(A.in_shape), rng.standard_normal(A.out_shape)
    np.testing.assert_allclose(A(x).ravel(), matrix @ x.ravel(), atol=3e-7)
    np.testing.assert_allclose(A.adjoint(y).ravel(), matrix.T @ y.ravel(), atol=3e-7)


@pytest.mark.parametrize("shift", [(1, 0), (0, 1), (-2, 0), (0, -2), (1, 2)])
@pytest.mark.parametrize("scale", [1, 2, 3])
def test_a_whole_pixel_moves_the_content_down_and_right(shift, scale, rng):
    still, moved = forward_model((9, 11), scale, [(0, 0), shift]).operator(
        rng.standard_normal((9 * scale, 11 * scale))
    )
    rolled = np.roll(still, shift, axis=(0, 1))
    inner = (slice(4, -4), slice(4, -4))
    np.testing.assert_allclose(moved[inner], rolled[inner], atol=1e-12)


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("scale", range(2, 9))
def test_one_hr_pixel_of_shift_equals_a_rolled_scene(scale, axis, rng):
    offset_px = np.zeros(2)
    offset_px[axis] = 1 / scale
    x = rng.standard_normal((7 * scale, 9 * scale))
    (moved,) = forward_model((7, 9), scale, [offset_px]).operator(x)
    (expected,) = forward_model((7, 9), scale).operator(np.roll(x, 1, axis=axis))
    np.testing.assert_allclose(moved[2:-2, 2:-2], expected[2:-2, 2:-2], atol=1e-5)


@pytest.mark.parametrize("fill_factor", [1.0, 0.5])
def test_aperture_equals_brute_force_integration_of_the_light(fill_factor, rng):
    scale, fine, shape = 2, 40, (5, 6)
    x = rng.standard_normal((shape[0] * scale, shape[1] * scale))
    light = np.kron(x, np.ones((fine, fine)))
    offset_px = np.array([0.2, -0.3])  # whole samples of the fine light
    blur = ApertureBlur(fill_factor)
    (frame,) = forward_model(shape, scale, [offset_px], blur=blur).operator(x)
    pitch = scale * fine
    margin = round((1 - fill_factor) * pitch / 2)
    for u, v in ((1, 1), (2, 4), (3, 2)):
        top, left = (
            round((at - shift) * pitch) for at, shift in zip((u, v), offset_px, strict=True)
        )
        seen = light[top + margin : top + pitch - margin, left + margin : left + pitch - margin]
        assert frame[u, v] == pytest.approx(seen.mean(), abs=2e-6)


def test_centroid_of_a_bright_point_moves_with_the_offset():
    x = np.zeros((40, 60))
    x[20, 30] = 1.0
    offset_px = np.array([[0.0, 0.0], [0.3, -0.4]])
    # Four frames of the half-pixel comb, so that the point is sampled without aliasing.
    comb = np.array([(r, c) for r in (0, 0.5) for c in (0, 0.5)])
    centroids = []
    for offset in offset_px:
        frames = forward_model((20, 30), 2, offset + comb, blur=GaussianBlur(0.5)).operator(x)
        rows, cols = np.mgrid[:20, :30]
        at = [
            sum((f * (grid - c[axis])).sum() for f, c in zip(frames, comb, strict=True))
            for axis, grid in enumerate((rows, cols))
        ]
        centroids.append(np.array(at) / frames.sum())
    np.testing.assert_allclose(centroids[1] - centroids[0], offset_px[1], atol=0.01)


def test_a_constant_field_equals_a_constant_shift(rng):
    offset_px = np.array([[0.3, -0.7], [1.1, 0.2], [-0.25, 0.25]])
    field = np.broadcast_to(offset_px[:, None, None], (3, 6, 9, 2))
    for scale in (1, 2, 4):
        x = rng.standard_normal((6 * scale, 9 * scale))
        shifted = forward_model((6, 9), scale, offset_px)
        warped = forward_model((6, 9), scale, shift_field_px=field)
        np.testing.assert_allclose(warped.operator(x), shifted.operator(x), atol=1e-5)
        np.testing.assert_array_equal(warped.inside, shifted.inside)


@pytest.mark.parametrize("dense", [False, True])
@pytest.mark.parametrize("kind", [np.float32, np.complex64])
def test_single_precision_stays_single_and_agrees_with_double(dense, kind, rng):
    shift = {"shift_field_px": a_field((6, 9))} if dense else {"offset_px": SQUARE}
    A = forward_model((6, 9), 2, **shift).operator
    x, y = (rng.standard_normal(shape).astype(kind) for shape in (A.in_shape, A.out_shape))
    assert A(x).dtype == kind
    assert A.adjoint(y).dtype == kind
    wide = np.result_type(kind, np.float64)
    np.testing.assert_allclose(A(x), A(x.astype(wide)), atol=2e-6)
    np.testing.assert_allclose(A.adjoint(y), A.adjoint(y.astype(wide)), atol=4e-6)


def test_whole_numbers_and_strided_images_are_welcome(rng):
    A = forward_model((6, 9), 2, SQUARE).operator
    x = rng.integers(0, 255, (18, 12), dtype=np.uint8).T
    np.testing.assert_array_equal(A(x), A(np.ascontiguousarray(x, dtype=np.float64)))


@pytest.mark.parametrize("dense", [False, True])
def test_gain_is_part_of_the_operator_and_bias_only_of_the_prediction(dense, rng):
    shift = {"shift_field_px": a_field((5, 7))} if dense else {"offset_px": SQUARE[:2]}
    plain = forward_model((5, 7), 2, **shift)
    model = forward_model((5, 7), 2, **shift, gain=[2.0, 0.5], bias=[0.1, -0.3])
    check_linear_operator(model.operator, rng, flat=None)
    x = rng.standard_normal(model.hr_shape)
    y = plain.predict(x)
    np.testing.assert_allclose(model.operator(x), y * np.array([2.0, 0.5])[:, None, None])
    np.testing.assert_allclose(model.predict(x)[0], 2.0 * y[0] + 0.1)
    np.testing.assert_allclose(model.predict(x)[1], 0.5 * y[1] - 0.3)
    assert model.predict(x.astype(np.complex64)).dtype == np.complex64


def test_pixels_that_look_outside_are_marked():
    model = forward_model((5, 7), 2, [(0, 0), (0.25, 0.25), (1.0, 0), (0, -0.75)])
    assert model.inside.shape == (4, 5, 7)
    assert model.inside[:2].all()
    assert not model.inside[2, 0].any()
    assert model.inside[2, 1:].all()
    assert not model.inside[3, :, 6].any()
    assert model.inside[3, :, :6].all()
    field = np.broadcast_to(np.array([1.0, 0.0]), (1, 5, 7, 2))
    warped = forward_model((5, 7), 2, shift_field_px=field)
    np.testing.assert_array_equal(warped.inside[0], model.inside[2])


def test_without_shifts_there_is_one_frame_in_place():
    model = forward_model((4, 6), 2)
    assert model.frames == 1
    np.testing.assert_array_equal(model.offset_px, [[0, 0]])


def test_calls_leave_no_trace(rng):
    A = forward_model((5, 7), 2, SQUARE).operator
    x, y = rng.standard_normal(A.in_shape), rng.standard_normal(A.out_shape)
    first, back = A(x), A.adjoint(y)
    np.testing.assert_array_equal(A(x), first)
    np.testing.assert_array_equal(A.adjoint(y), back)


def test_a_model_cannot_spoil_those_that_come_after(rng):
    x = rng.random((8, 12))
    before = forward_model((4, 6), 2, SQUARE)
    seen = before.predict(x)
    for taps in (before.rows, before.cols):
        for values in (taps.position_hr_px, taps.start, taps.weight):
            with pytest.raises(ValueError, match="read-only"):
                values[:] = 0
    np.testing.assert_array_equal(forward_model((4, 6), 2, SQUARE).predict(x), seen)


@pytest.mark.parametrize("field", [False, True])
def test_a_part_of_the_frames_is_made_of_the_part_of_the_picture(field, rng):
    shape, scale, offset_px = (14, 19), 2, np.array([[0.3, -0.2], [-0.4, 0.1]])
    shifts = {"offset_px": offset_px}
    if field:
        px = np.broadcast_to(offset_px[:, None, None], (2, *shape, 2)).copy()
        px += 0.1 * rng.standard_normal(px.shape)
        shifts = {"shift_field_px": px}
    model = forward_model(shape, scale, blur=GaussianBlur(0.3), **shifts)
    rows, cols = slice(3, 12), slice(5, 18)
    x = rng.standard_normal((28, 38))
    whole = model.operator.forward(x)[:, rows, cols]
    part = model.crop(rows, cols).operator.forward(x[6:24, 10:36])
    inner = (slice(None), slice(2, -2), slice(2, -2))
    np.testing.assert_allclose(part[inner], whole[inner], atol=1e-12)


def a_spot(shape, frames=2, seed=0):
    rows, cols = np.meshgrid(*(np.linspace(-1, 1, n) for n in shape), indexing="ij")
    a, b = np.random.default_rng(seed).uniform(0, 0.1, (2, frames, 1, 1, 2))
    return a * (rows**2 + cols)[..., None] ** 2 + b - 0.02


@pytest.mark.parametrize("blur", BLURS, ids=str)
@pytest.mark.parametrize("scale", [1, 2, 3, 5])
def test_laws_for_spots_that_differ(scale, blur, rng):
    field, spot = a_field((5, 7)), a_spot((5, 7))
    model = forward_model((5, 7), scale, shift_field_px=field, spot_px2=spot, blur=blur)
    check_linear_operator(model.operator, rng)
    check_linear_operator(model.crop(slice(1, 4), slice(2, 7)).operator, rng)


@pytest.mark.parametrize("scale", [2, 3])
def test_spots_that_differ_have_the_width_and_the_place_of_their_own(scale):
    shape, blur = (11, 13), GaussianBlur(0.3)
    field, spot = a_field(shape, size_px=0.4), a_spot(shape)
    model = forward_model(shape, scale, shift_field_px=field, spot_px2=spot, blur=blur)
    for axis, taps in enumerate((model.rows, model.cols)):
        n = taps.start[..., None] + np.arange(taps.weight.shape[-1])
        mean = np.sum(taps.weight * n, axis=-1)
        variance = np.sum(taps.weight * (n - mean[..., None]) ** 2, axis=-1)
        phase = taps.position_hr_px % 1
        expected = np.maximum(scale**2 * (0.09 + spot[..., axis]), phase * (1 - phase))
        inner = (slice(None), slice(4, -4), slice(4, -4))
        np.testing.assert_allclose(mean[inner], taps.position_hr_px[inner], atol=1e-6)
        np.testing.assert_allclose(variance[inner], expected[inner], rtol=2e-3)


def test_the_same_spot_everywhere_is_a_wider_response(rng):
    shape, field = (9, 12), a_field((9, 12), size_px=0.3)
    x = rng.standard_normal((18, 24))
    for blur in (GaussianBlur(0.25), ApertureBlur(0.8, 0.1)):
        even = forward_model(shape, 2, shift_field_px=field, spot_px2=0.04 + 0 * field, blur=blur)
        wider = forward_model(shape, 2, shift_field_px=field, blur=blur.widened(0.04))
        np.testing.assert_allclose(even.operator(x), wider.operator(x), atol=2e-3)


def test_another_grid_sees_the_same(rng):
    shape = (9, 12)
    field, spot = a_field(shape, size_px=0.3), a_spot(shape)
    fine = forward_model(shape, 4, shift_field_px=field - [0.1, -0.2], spot_px2=spot)
    model = forward_model(shape, 2, shift_field_px=field, spot_px2=spot).on_grid(4, (0.1, -0.2))
    x = rng.standard_normal(fine.hr_shape)
    np.testing.assert_allclose(model.operator(x), fine.operator(x), atol=1e-9)
    there = forward_model(shape, 4, shift_field_px=field, spot_px2=spot)
    finer = forward_model(shape, 2, shift_field_px=field, spot_px2=spot).on_grid(4)
    np.testing.assert_allclose(finer.operator(x), there.operator(x), atol=1e-9)
    offset_px = rng.uniform(-0.5, 0.5, (3, 2))
    moved = forward_model(shape, 2, offset_px).on_grid(3, (0.25, 0.0))
    there = forward_model(shape, 3, offset_px - [0.25, 0.0])
    x = rng.standard_normal(there.hr_shape)
    np.testing.assert_allclose(moved.operator(x), there.operator(x), atol=1e-9)


def test_spots_belong_to_a_shift_field():
    for field in ({"offset_px": SQUARE}, {"shift_field_px": a_field((5, 7))}):
        with pytest.raises(ValueError, match="finite spot_px2 of a shift field"):
            forward_model((5, 7), 2, spot_px2=np.zeros((2, 5, 6, 2)), **field)


@pytest.mark.parametrize("scale", [1, 2, 3])
@pytest.mark.parametrize("shape", [(1, 1), (3, 2), (6, 40), (17, 23)])
def test_slow_fields_are_summed_as_any_other(scale, shape, rng, monkeypatch):
    field = 0.2 * a_field(shape) + rng.uniform(-2, 2, (2, 1, 1, 2))
    gain = [1.0, 0.7]
    model = forward_model(shape, scale, shift_field_px=field, spot_px2=a_spot(shape), gain=gain)
    fast = model.operator
    monkeypatch.setattr("lensshift.forward.model.smooth_field", lambda *_: None)
    slow = model.operator
    x, y = rng.standard_normal(model.hr_shape), rng.standard_normal((2, *shape))
    np.testing.assert_allclose(fast(x), slow(x), atol=1e-13)
    np.testing.assert_allclose(fast.adjoint(y), slow.adjoint(y), atol=1e-13)


def test_a_part_and_another_grid_see_with_the_spots_of_their_pixels():
    rng = np.random.default_rng(8)
    field_px, shape = a_field((9, 11)), (2, 9, 11, 2)
    spots = {"spot_px2": rng.uniform(0.0, 0.1, shape), "skew_px3": rng.uniform(-0.1, 0.1, shape)}
    model = forward_model((9, 11), 2, shift_field_px=field_px, **spots)
    x = rng.standard_normal(model.hr_shape)
    again = model.on_grid(2, np.zeros(2))
    np.testing.assert_allclose(again.operator(x), model.operator(x), atol=1e-12)
    rows, cols = slice(1, 8), slice(2, 10)
    part = model.crop(rows, cols)
    one = part.on_grid(2, np.zeros(2))
    here = x[2:16, 4:20]
    np.testing.assert_allclose(one.operator(here), part.operator(here), atol=1e-12)
