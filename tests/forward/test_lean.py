"""Spots that lean, against waves that a Gaussian passes in closed form."""

import numpy as np
import pytest

from lensshift.forward.blur import ApertureBlur, GaussianBlur
from lensshift.forward.model import forward_model

SHAPE = (15, 22)


def even_field(spot_px2: tuple[float, float, float], frames: int = 1) -> dict:
    shift_px = np.zeros((frames, *SHAPE, 2))
    return {
        "shift_field_px": shift_px,
        "spot_px2": np.broadcast_to(spot_px2, (*shift_px.shape[:3], 3)),
    }


@pytest.mark.parametrize("scale", [2, 3])
@pytest.mark.parametrize(
    "spot_px2", [(0.1, 0.1, 0.08), (0.1, 0.16, -0.1), (0.5, 0.5, 0.4), (0.02, 0.03, -0.01)]
)
def test_waves_pass_as_behind_a_leaning_gaussian(spot_px2, scale):
    """But for the fit of the taps and for the grid: 0.015 to 0.35 cycles per pixel."""
    model = forward_model(SHAPE, scale, **even_field(spot_px2), blur=GaussianBlur(0.3))
    row, col = ((np.arange(n * scale) + 0.5) / scale - 0.5 for n in SHAPE)
    middle = (SHAPE[0] // 2, SHAPE[1] // 2)
    for f_row, f_col in ((0.35, 0.35), (0.35, -0.35), (0.2, 0.3), (0.1, -0.35), (0.0, 0.35)):
        wave = np.exp(2j * np.pi * (f_row * row[:, None] + f_col * col))
        moments = np.array([f_row**2, f_col**2, 2 * f_row * f_col])
        passed = np.exp(-2 * np.pi**2 * (spot_px2 + np.array([0.09, 0.09, 0.0])) @ moments)
        there = np.exp(2j * np.pi * (f_row * middle[0] + f_col * middle[1]))
        assert abs(model.predict(wave)[0][middle] / there - passed) < 0.015


@pytest.mark.parametrize("blur", [GaussianBlur(0.3), ApertureBlur(1.0)])
@pytest.mark.parametrize("lean_px2", [0.003, -0.05, 0.4, -2.0])
def test_a_point_has_the_second_moments_that_it_should(lean_px2, blur):
    """Exactly with Gaussian taps; those of apertures leave out tails."""
    variance_px2 = (abs(lean_px2) + 0.05, abs(lean_px2) + 0.1)
    seen = np.zeros((1, *SHAPE))
    seen[0, 7, 10] = 1.0
    row, col = np.mgrid[: 2 * SHAPE[0], : 2 * SHAPE[1]]
    moments = {}
    for lean in (0.0, lean_px2):
        model = forward_model(SHAPE, 2, **even_field((*variance_px2, lean)), blur=blur)
        spread = model.operator.adjoint(seen)
        assert spread.sum() == pytest.approx(1.0)
        r, c = (at - (spread * at).sum() for at in (row, col))
        moments[lean] = np.array([(spread * one).sum() / 4 for one in (r, c, r * r, c * c, r * c)])
    np.testing.assert_allclose(
        moments[lean_px2][:4],
        moments[0.0][:4],
        atol=1e-6 if isinstance(blur, GaussianBlur) else 1e-3,
    )
    assert moments[lean_px2][4] == pytest.approx(lean_px2, rel=2e-3)


@pytest.mark.parametrize("kind", [np.float32, np.float64, np.complex128])
def test_the_adjoint_is_exact_and_a_part_sees_the_same(kind, rng):
    frames = 3
    shift_px = rng.uniform(-0.5, 0.5, (frames, *SHAPE, 2))
    variance_px2 = rng.uniform(0.05, 0.3, (frames, *SHAPE, 2))
    lean_px2 = rng.uniform(-0.9, 0.9, (*SHAPE, 1)) * variance_px2.min(axis=(0, 3))[..., None]
    spot_px2 = np.concatenate([variance_px2, np.broadcast_to(lean_px2, (frames, *SHAPE, 1))], -1)
    model = forward_model(SHAPE, 2, shift_field_px=shift_px, spot_px2=spot_px2)

    def random(*shape):
        values = rng.standard_normal((2, *shape))
        return (values[0] + 1j * values[1] if kind is np.complex128 else values[0]).astype(kind)

    x, y = random(*model.hr_shape), random(frames, *SHAPE)
    A = model.operator
    assert A(x).dtype == kind
    tolerance = 1e-5 if kind is np.float32 else 1e-12
    assert np.vdot(y, A(x)) == pytest.approx(np.vdot(A.adjoint(y), x), abs=tolerance * 1e3)
    np.testing.assert_allclose(A(np.ones_like(x)), 1.0, atol=1e-5)
    part = model.crop(slice(2, 13), slice(3, 20))
    np.testing.assert_allclose(
        part.operator(np.ascontiguousarray(x[4:26, 6:40]))[:, 4:-4, 4:-4],
        A(x)[:, 6:9, 7:16],
        atol=1e-3,  # taps are linear between those of 64 covariances of the part
    )


def test_what_no_two_variances_allow_leans_as_much_as_they_do():
    """A covariance beyond its variances is no spot; one below a thousandth is not worth it."""
    x = np.random.default_rng(4).random((2 * SHAPE[0], 2 * SHAPE[1]))
    seen = [
        forward_model(SHAPE, 2, **even_field((0.05, 0.1, lean))).predict(x)
        for lean in (0.05, 0.2, 0.0009, 0.0)
    ]
    np.testing.assert_array_equal(seen[0], seen[1])
    np.testing.assert_array_equal(seen[2], seen[3])
    assert np.abs(seen[0] - seen[3]).max() > 0.01
