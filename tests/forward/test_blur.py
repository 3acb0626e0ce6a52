import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from independent_matrix import on_image, response

from lensshift.forward.blur import ApertureBlur, GaussianBlur, sees_image, varying_taps

blurs = st.one_of(
    st.builds(GaussianBlur, st.floats(0, 1)),
    st.builds(ApertureBlur, st.floats(0.05, 1), st.just(0.0) | st.floats(0.02, 0.6)),
)


def moments(start, weight, position):
    at = start[..., None] + np.arange(weight.shape[-1]) - np.asarray(position)[..., None]
    return (weight * at).sum(-1), (weight * at**2).sum(-1)


def row_of(start, weight, size):
    line = np.zeros(size)
    line[start + np.arange(weight.size)] = weight
    return line


@pytest.mark.parametrize("sigma_hr_px", [0.0, 0.1, 0.3, 0.45, 0.5, 0.6, 0.69, 0.7, 1.0, 2.4, 8.0])
def test_gaussian_has_the_width_and_centroid_it_claims_at_every_phase(sigma_hr_px):
    phase = np.linspace(0, 1, 97)
    position = 300 + phase
    start, weight = GaussianBlur(sigma_hr_px).taps(position, 1, 601)
    mean, variance = moments(start, weight, position)
    np.testing.assert_allclose(mean, 0, atol=1e-12)
    linear_interpolation = phase * (1 - phase)
    np.testing.assert_allclose(
        variance, np.maximum(sigma_hr_px**2, linear_interpolation), rtol=1e-11
    )
    assert weight.min() >= 0


@given(sigma_hr_px=st.floats(0, 12), position=st.floats(90, 110))
@settings(deadline=None, max_examples=100)
def test_gaussian_moments_hold_for_any_width(sigma_hr_px, position):
    start, weight = GaussianBlur(sigma_hr_px).taps(position, 1, 201)
    mean, variance = moments(start, weight, position)
    p = position - np.floor(position)
    assert mean == pytest.approx(0, abs=1e-11)
    assert variance == pytest.approx(max(sigma_hr_px**2, p * (1 - p)), rel=1e-10, abs=2e-12)


def test_many_positions_are_looked_up_and_keep_their_moments():
    position = np.random.default_rng(0).uniform(20, 80, (50, 200))
    for blur in (GaussianBlur(0.3), ApertureBlur(0.9, 0.2)):
        start, weight = blur.taps(position, 2, 100)
        mean, variance = moments(start, weight, position)
        few_start, few_weight = blur.taps(position[0], 2, 100)
        few_mean, few_variance = moments(few_start, few_weight, position[0])
        np.testing.assert_allclose(weight.sum(-1), 1, atol=1e-13)
        np.testing.assert_allclose(mean[0], few_mean, atol=2e-5)
        np.testing.assert_allclose(variance[0], few_variance, atol=2e-4)
    start, weight = GaussianBlur(0.3).taps(position, 2, 100)
    mean, variance = moments(start, weight, position)
    np.testing.assert_allclose(mean, 0, atol=1e-11)
    np.testing.assert_allclose(variance, 0.36, atol=3e-8)


def test_gaussian_on_the_hr_grid_is_the_kernel_of_the_toolbox_with_its_true_width():
    start, weight = GaussianBlur(0.3).taps(10.0, 2, 21)
    assert start == 8
    np.testing.assert_allclose(weight, [0.003, 0.168, 0.658, 0.168, 0.003], atol=2e-3)


def test_gaussian_of_no_width_is_linear_interpolation():
    start, weight = GaussianBlur(0.0).taps([3.0, 3.25], 4, 9)
    np.testing.assert_array_equal(start, 3)
    np.testing.assert_allclose(weight, [[1, 0], [0.75, 0.25]])


def test_open_aperture_between_half_pixels_is_a_quarter_a_half_a_quarter():
    for position in (10.0, 2 * (5 - 0.25) + 0.5, 2 * (5 + 0.25) + 0.5):
        start, weight = ApertureBlur().taps(position, 2, 40)
        assert start == position - 1
        np.testing.assert_array_equal(weight, [0.25, 0.5, 0.25])
    start, weight = ApertureBlur().taps(10.5, 2, 40)
    assert start == 10
    np.testing.assert_array_equal(weight, [0.5, 0.5])


@pytest.mark.parametrize("scale", range(1, 9))
def test_unshifted_open_aperture_is_the_mean_of_its_block(scale):
    start, weight = ApertureBlur().taps(np.arange(5) * scale + (scale - 1) / 2, scale, 5 * scale)
    np.testing.assert_array_equal(start, scale * np.arange(5))
    np.testing.assert_allclose(weight, 1 / scale, rtol=1e-14)


@given(fill=st.floats(0.05, 1), sigma_px=st.floats(0, 0.6), scale=st.integers(1, 8))
@settings(deadline=None, max_examples=20)
def test_aperture_is_on_average_as_wide_as_pixel_box_spot_and_hr_pixel(fill, sigma_px, scale):
    position = 200 + (np.arange(512) + 0.5) / 512
    start, weight = ApertureBlur(fill, sigma_px).taps(position, scale, 401)
    mean, variance = moments(start, weight, position)
    claimed = (fill * scale) ** 2 / 12 + (sigma_px * scale) ** 2 + 1 / 12
    assert mean.mean() == pytest.approx(0, abs=1e-6)
    assert variance.mean() == pytest.approx(claimed, rel=2e-3)


@pytest.mark.parametrize("spot_px2", [-0.05, 0.0, 0.11, 3.0])
def test_spots_add_in_variance_and_none_is_sharper_than_a_point(spot_px2):
    position = 200 + (np.arange(512) + 0.5) / 512
    for blur in (GaussianBlur(0.6), ApertureBlur(0.8, 0.6), ApertureBlur(0.8, 0.1)):
        there, more = (moments(*b.taps(position, 2, 401), position)[1].mean()
                       for b in (blur, blur.widened(spot_px2)))  # fmt: skip
        own_px2 = blur.sigma_px**2 if isinstance(blur, GaussianBlur) else blur.optics_sigma_px**2
        grown = max(spot_px2, -own_px2)
        assert more - there == pytest.approx(4 * grown, rel=5e-3, abs=1e-9)


@pytest.mark.parametrize("skew_px3", [-0.2, 0.02, 0.1])
@pytest.mark.parametrize("scale", [2, 3, 4])
def test_a_third_moment_turns_phases_and_nothing_else(scale, skew_px3):
    position = 200 + (np.arange(64) + 0.5) / 64
    spot_px2, seen = np.full(64, 0.09), {}
    for skew in (0.0, skew_px3):
        start, weight = varying_taps(GaussianBlur(0.3), position, spot_px2, scale, 401,
                                     np.full(64, skew))  # fmt: skip
        at = start[:, None] + np.arange(weight.shape[1]) - position[:, None]
        w = 2 * np.pi * np.array([0.05, 0.15, 0.3])  # per LR pixel
        seen[skew] = np.einsum("pt,ptf->pf", weight, np.exp(1j * at[..., None] * w / scale))
        np.testing.assert_allclose(weight.sum(axis=1), 1.0, atol=1e-12)
    np.testing.assert_allclose(np.abs(seen[skew_px3]), np.abs(seen[0.0]), atol=5e-3)
    turned = np.angle(seen[skew_px3] / seen[0.0])
    expected = np.broadcast_to(skew_px3 * w**3 / 6, turned.shape)
    np.testing.assert_allclose(turned, expected, rtol=0.02, atol=8e-3)


@given(blur=blurs, scale=st.integers(1, 4), size=st.integers(1, 12), position=st.floats(-6, 18))
@settings(deadline=None, max_examples=40, derandomize=True)
def test_taps_equal_quadrature_and_optimisation_anywhere(blur, scale, size, position):
    position = round(position * 64) / 64
    start, weight = blur.taps(position, scale, size)
    assert 0 <= start <= start + weight.size - 1 < size
    expected = np.zeros(size)
    for n, w in on_image(response(blur, position, scale), size).items():
        expected[n] = w
    np.testing.assert_allclose(row_of(int(start), weight, size), expected, atol=2e-5)


@given(blur=blurs, scale=st.integers(1, 8), size=st.integers(1, 40))
@settings(deadline=None)
def test_taps_are_mirrored_with_the_image(blur, scale, size):
    position = np.array([0.0, 0.25, 3.5, size - 1.0, -0.75, size / 2])
    there, back = (blur.taps(at, scale, size) for at in (position, size - 1 - position))
    for k in range(position.size):
        line, mirrored = (row_of(s[k], w[k], size) for s, w in (there, back))
        np.testing.assert_allclose(line, mirrored[::-1], atol=1e-9)


@pytest.mark.parametrize("blur", [GaussianBlur(0.3), GaussianBlur(0.4), ApertureBlur(0.8, 0.2)])
@pytest.mark.parametrize("scale", [1, 2, 3])
def test_taps_equal_quadrature_and_optimisation_to_eight_digits(blur, scale):
    for position in (10.0, 10.25, 10.6875, 0.5, -0.375):
        start, weight = blur.taps(position, scale, 21)
        expected = np.zeros(21)
        for n, w in on_image(response(blur, position, scale), 21).items():
            expected[n] = w
        np.testing.assert_allclose(row_of(int(start), weight, 21), expected, atol=3e-8)


def test_a_pixel_that_sees_nothing_takes_the_nearest_edge():
    start, weight = GaussianBlur(0.3).taps([-50.0, 50.0], 2, 20)
    np.testing.assert_array_equal(row_of(start[0], weight[0], 20), np.eye(20)[0])
    np.testing.assert_array_equal(row_of(start[1], weight[1], 20), np.eye(20)[19])


def test_sees_image_ends_where_the_outer_hr_pixels_end():
    np.testing.assert_array_equal(
        sees_image([-0.6, -0.5, 0, 9, 9.5, 9.6], 10), [False, True, True, True, True, False]
    )


@pytest.mark.parametrize("sigma_px", [-0.1, np.nan, np.inf])
def test_bad_widths_are_refused(sigma_px):
    with pytest.raises(ValueError, match="sigma_px"):
        GaussianBlur(sigma_px)
    with pytest.raises(ValueError, match="optics_sigma_px"):
        ApertureBlur(1.0, sigma_px)


@pytest.mark.parametrize("fill_factor", [0.0, 1.1, np.nan])
def test_bad_fill_factors_are_refused(fill_factor):
    with pytest.raises(ValueError, match="fill_factor"):
        ApertureBlur(fill_factor)


def test_positions_must_be_finite():
    with pytest.raises(ValueError, match="finite"):
        GaussianBlur().taps([0.0, np.nan], 2, 10)


def test_responses_between_nodes_keep_contrast_and_third_moment():
    """Of third moments of which hardly any is at a node."""
    scale, skews_px3 = 2, np.linspace(-0.11, 0.17, 64)
    position = 200 + (np.arange(64) + 0.5) / 64
    w, seen = 2 * np.pi * np.array([0.15, 0.3, 0.4]), []
    for skew_px3 in (np.zeros(64), skews_px3):
        start, weight = varying_taps(
            GaussianBlur(0.3), position, np.full(64, 0.09), scale, 401, skew_px3
        )
        at = start[:, None] + np.arange(weight.shape[1]) - position[:, None]
        seen.append(np.einsum("pt,ptf->pf", weight, np.exp(1j * at[..., None] * w / scale)))
    even, skewed = seen
    np.testing.assert_allclose(np.abs(skewed), np.abs(even), atol=5e-3)
    turned = np.angle(skewed / even)[:, :2]
    np.testing.assert_allclose(turned, skews_px3[:, None] * w[:2] ** 3 / 6, atol=8e-3)


@pytest.mark.parametrize("skew_px3", [-0.3, 0.3])
def test_skewed_responses_that_are_cut_off_stay_means(skew_px3):
    position, count = np.linspace(-3.0, 12.0, 301), 301
    _, weight = varying_taps(GaussianBlur(0.2), position, np.full(count, 0.05), 2, 10,
                             np.full(count, skew_px3))  # fmt: skip
    np.testing.assert_allclose(weight.sum(axis=1), 1.0, atol=1e-12)
    beyond = (position < 0) | (position > 9)
    assert weight[beyond].min() >= 0.0
