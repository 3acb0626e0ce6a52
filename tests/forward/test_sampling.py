import numpy as np
import pytest

from lensshift.forward import sampling
from lensshift.forward.blur import GaussianBlur
from lensshift.forward.model import forward_model
from lensshift.forward.warp import field_positions, frame_positions


@pytest.mark.parametrize("shape", [(3, 1), (1, 2), (3, 5), (5, 9)])
@pytest.mark.parametrize("scale", [1, 2, 3, 5])
def test_compiled_kernels_equal_the_python_that_they_are_written_in(scale, shape, rng):
    hr = (shape[0] * scale, shape[1] * scale)
    offset_px = np.array([[0.3, -0.6], [1.4, 0.25]])
    x, y = rng.standard_normal(hr), rng.standard_normal((2, *shape))
    blur = GaussianBlur(0.4)
    field = np.broadcast_to(offset_px[:, None, None], (2, *shape, 2))
    for kind, positions in (
        ("separable", frame_positions(shape, offset_px, scale)),
        ("field", field_positions(field, scale)),
    ):
        taps = (*blur.taps(positions[0], scale, hr[0]), *blur.taps(positions[1], scale, hr[1]))
        for one in taps:
            one.flags.writeable = False  # as they are in a model: others are compiled anew
        for name, values, like in ((f"forward_{kind}", x, y), (f"adjoint_{kind}", y, x)):
            kernel, fast, slow = getattr(sampling, name), *np.full((2, *like.shape), np.nan)
            last = ()
            if kind == "separable":
                run = sampling.regular_runs(*taps[2:], scale)
                run.flags.writeable = False
                last = (run, 0, like.shape[-2])
            kernel(values, *taps, *last, fast)
            kernel.py_func(values, *taps, *last, slow)
            np.testing.assert_allclose(fast, slow, atol=1e-13)


def test_the_run_of_equal_taps_leaves_out_the_borders():
    _, col_at = frame_positions((4, 20), [[0.0, 0.1]], 2)
    start, weight = GaussianBlur(0.3).taps(col_at, 2, 40)
    begin, end = sampling.regular_runs(start, weight, 2)[0]
    assert 1 <= begin <= 2
    assert 17 <= end <= 19
    assert (weight[0, begin:end] == weight[0, begin]).all()


@pytest.mark.parametrize("kind", [np.float32, np.float64, np.complex64])
def test_bands_on_several_cores_are_the_same_to_the_last_bit(kind, rng, monkeypatch):
    model = forward_model((21, 34), 3, rng.uniform(-1.6, 1.6, (5, 2)))
    A = model.operator
    x = rng.standard_normal(A.in_shape).astype(kind)
    y = rng.standard_normal(A.out_shape).astype(kind)
    if kind is np.complex64:
        x, y = x * np.complex64(1 + 2j), y * np.complex64(2 - 1j)
    expected = A.forward(x), A.adjoint(y)
    monkeypatch.setattr(sampling, "WORTH_THREADS", 1)
    for cores in (2, 3, 5):
        monkeypatch.setattr(sampling, "core_count", lambda cores=cores: cores)
        np.testing.assert_array_equal(A.forward(x), expected[0])
        np.testing.assert_array_equal(A.adjoint(y), expected[1])
