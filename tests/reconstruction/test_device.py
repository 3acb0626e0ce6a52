"""The solver on a device: the same pictures, from the same code in NumPy and PyTorch."""

import sys
import threading
from importlib import import_module

import numpy as np
import pytest
from mosaic import mosaic_burst, phasor_mosaic

import lensshift
from lensshift import Burst, ShiftField, reconstruct, reconstruct_batch
from lensshift.core.errors import QualityWarning
from lensshift.forward.blur import ApertureBlur, GaussianBlur
from lensshift.forward.model import forward_model
from lensshift.reconstruction import batch
from lensshift.reconstruction.learned import solver
from lensshift.reconstruction.learned.device import DeviceKernels, device_kernels

# Of peak: rounding of single precision in another order. The promise is 1e-3.
SAME = 2e-5
SHAPE = (13, 18)


@pytest.fixture(params=["numpy", "cpu", "cuda"])
def device(request):
    if request.param != "numpy":
        torch = pytest.importorskip("torch", reason="the extra torch is not installed")
        if request.param == "cuda" and not torch.cuda.is_available():
            pytest.skip("there is no CUDA device here")
    return request.param


def burst_of(seed=0, shape=SHAPE, **settings):
    one = mosaic_burst(seed, shape, **settings)
    return Burst.from_arrays(one.y, offset_px=one.offset_px, pitch_mm=0.1)


def phasors_of(seed=0, shape=SHAPE, **settings):
    one = phasor_mosaic(seed, shape, **settings)
    return Burst.from_arrays(one.y, offset_px=one.offset_px, pitch_mm=0.1, modulation_hz=20e6)


def assert_same(found, expected):
    assert found.channels.keys() == expected.channels.keys()
    for name, one in expected.channels.items():
        other, peak = found.channels[name], np.abs(one.image).max()
        np.testing.assert_allclose(other.image, one.image, atol=SAME * peak)
        np.testing.assert_allclose(other.std, one.std, rtol=1e-2, atol=SAME * peak)
        np.testing.assert_allclose(other.confidence, one.confidence, atol=1e-3)
        assert other.status is one.status
        np.testing.assert_allclose(other.objective, one.objective, rtol=1e-4)


@pytest.mark.parametrize(("shape", "scale"), [((13, 18), 2), ((17, 8), 3), ((7, 11), 2)])
@pytest.mark.parametrize("of", [burst_of, phasors_of])
def test_a_picture_is_that_of_the_compiled_kernels(device, of, shape, scale):
    burst = of(1, shape, scale=scale)
    found = reconstruct(burst, scale, device=device)
    assert found.settings["device"] == device
    assert_same(found, reconstruct(burst, scale))


def test_pixels_may_be_missing_or_noisier_than_others(device):
    rng = np.random.default_rng(2)
    one = mosaic_burst(2, (15, 16), scale=3)
    y, valid = one.y.copy(), rng.random(one.y.shape) > 0.1
    valid[:, 5:7, 5:8] = False  # nothing is known there
    y[~valid] = np.nan
    variance = one.sigma**2 * rng.uniform(0.2, 4.0, y.shape)
    y += np.sqrt(variance) * rng.standard_normal(y.shape)
    burst = Burst.from_arrays(y, offset_px=one.offset_px, pitch_mm=0.1, valid=valid)
    told = {"pixel_variance": variance, "frames": [0, 2, 3, 5, 8]}
    assert_same(reconstruct(burst, 3, device=device, **told), reconstruct(burst, 3, **told))


def test_shifts_may_differ_from_pixel_to_pixel(device):
    burst = burst_of(3, (14, 17))
    place = np.linspace(-0.1, 0.1, burst.amplitude[0].size).reshape(14, 17)
    place -= np.mean(place)
    offset_px = burst.offset_px[:, None, None] + np.stack([place, -place], axis=-1)
    for field in (
        ShiftField(offset_px),
        ShiftField(offset_px, spot_px2=2 * np.abs(offset_px) ** 3),
        ShiftField(offset_px, spot_px2=0.05 + 0.04 * offset_px[..., [0, 1, 0]]),
    ):
        assert_same(
            reconstruct(burst, shift_field=field, device=device),
            reconstruct(burst, shift_field=field),
        )


@pytest.mark.parametrize("of_field", [False, True])
def test_large_pictures_are_solved_in_tiles(device, monkeypatch, of_field):
    burst = burst_of(3, (70, 41), snr=200)
    field = None
    if of_field:
        field = ShiftField(np.broadcast_to(burst.offset_px[:, None, None], (4, 70, 41, 2)).copy())
    monkeypatch.setattr(solver, "TILE_HR_PX", 44)
    assert_same(
        reconstruct(burst, shift_field=field, device=device), reconstruct(burst, shift_field=field)
    )


@pytest.mark.parametrize("kind", [np.float32, np.complex64])
@pytest.mark.parametrize(
    ("scale", "blur"),
    [(1, GaussianBlur(0.0)), (2, GaussianBlur(0.3)), (3, ApertureBlur(0.9)), (5, GaussianBlur(1))],
)
@pytest.mark.parametrize("of_field", [False, True])
def test_the_operators_are_exact_and_adjoint(device, scale, blur, of_field, kind):
    rng = np.random.default_rng(5)
    shifts = rng.uniform(-1.5, 1.5, (4, 2)) * [1, 4]  # some pixels see nothing of the image
    if of_field:
        field = shifts[:, None, None] + 0.2 * rng.standard_normal((4, 6, 9, 2))
        spot = 0.1 * rng.random((4, 6, 9, scale)) if 1 < scale < 4 else None  # 3: they lean
        model = forward_model((6, 9), scale, shift_field_px=field, spot_px2=spot, blur=blur)
    else:
        model = forward_model((6, 9), scale, shifts, blur=blur)
    kernels = device_kernels(device)
    A, exact = kernels.operator(model), model.operator

    def random(*shape):
        values = rng.standard_normal((2, *shape))
        return (values[0] + 1j * values[1] if kind is np.complex64 else values[0]).astype(kind)

    x, y = random(3, *model.hr_shape), random(3, 4, 6, 9)
    taken = kernels.back(A.forward(kernels.there(x)))
    spread = kernels.back(A.adjoint(kernels.there(y)))
    for n in range(3):
        np.testing.assert_allclose(taken[n], exact.forward(x[n]), atol=1e-5)
        np.testing.assert_allclose(spread[n], exact.adjoint(y[n]), atol=1e-5)
        product = np.vdot(taken[n], y[n])
        assert abs(product - np.vdot(x[n], spread[n])) < 1e-5 * np.abs(y[n]).sum()


def test_a_batch_is_one_burst_after_the_other(device, monkeypatch):
    bursts = [burst_of(seed) for seed in range(3)]
    bursts += [burst_of(3, (9, 12)), phasors_of(4), phasors_of(4), burst_of(5)]
    seen = []
    together = solver._in_tiles
    monkeypatch.setattr(
        solver, "_in_tiles", lambda *of: (seen.append(len(of[2])), together(*of))[1]
    )
    monkeypatch.setattr(batch, "TOGETHER", 6)
    told = {"psf_sigma_px": 0.3}  # read from its frames each burst would have a width of its own
    found = reconstruct_batch(bursts, device=device, **told)
    # Of phasors amplitudes and phases are solved on their own, too; the last burst came too late.
    assert sorted(seen) == [1, 1, 2, 2, 2, 3]
    for one, expected in zip(found, reconstruct_batch(bursts, **told), strict=True):
        assert_same(one, expected)


def test_a_burst_that_is_solved_twice_does_not_hold_up_the_others(device):
    moved = mosaic_burst(1, (24, 30))
    moved.y[2, 8:16, 8:20] = moved.y[2, 8:16, 8:20][::-1].copy()  # something moved in one frame
    odd = Burst.from_arrays(moved.y, offset_px=moved.offset_px, pitch_mm=0.1)
    bursts = [burst_of(0, (24, 30)), odd, burst_of(2, (24, 30))]
    with pytest.warns(QualityWarning):
        found = reconstruct_batch(bursts, device=device)
    assert [len(one.amplitude.objective) for one in found] == [4, 8, 4]
    with pytest.warns(QualityWarning):
        assert_same(found[1], reconstruct(odd))


def test_an_error_in_one_burst_is_raised_and_no_thread_is_left(device):
    wrong = Burst.from_arrays(
        np.ones((4, *SHAPE)), offset_px=[[90.0, 0], [90, 1], [91, 0], [91, 1]], pitch_mm=0.1
    )
    before = threading.active_count()
    with pytest.raises(ValueError, match="no valid pixel sees the scene"):
        reconstruct_batch([burst_of(0), wrong, burst_of(1)], device=device)

    def stop(number, misfit):
        raise KeyError("enough")

    with pytest.raises(KeyError, match="enough"):
        reconstruct_batch([burst_of(0), burst_of(1)], device=device, on_iteration=stop)
    assert threading.active_count() == before


def test_a_batch_of_none_is_none(device):
    assert reconstruct_batch([], device=device) == reconstruct_batch([]) == []
    with pytest.raises(ValueError, match="do not follow each other"):
        reconstruct_batch([], streamed=True)


@pytest.mark.parametrize("of", [burst_of, phasors_of])
def test_a_stream_runs_on_a_device(device, of):
    burst = of(6)
    cameras = [lensshift.stream(burst, **told) for told in ({}, {"device": device})]
    frames = [lensshift.Frame(y, None, np.isfinite(y), 0.0) for y in burst.amplitude]
    for frame in [*frames, frames[0], frames[1]]:
        expected, found = (camera.step(frame) for camera in cameras)
        assert found.settings["pace"] == expected.settings["pace"]
        assert_same(found, expected)
    assert found.settings["pace"] == "live"


@pytest.mark.parametrize("name", ["gpu", "cuda:", "cuda:x", "CPU", "mps", "", 0])
def test_a_wrong_name_lists_the_right_ones(name):
    with pytest.raises(ValueError, match="expected 'cpu', 'cuda', 'cuda:1' or 'numpy'"):
        reconstruct(burst_of(), device=name)
    with pytest.raises(ValueError, match="expected 'cpu'"):
        reconstruct_batch([burst_of()], device=name)


def test_other_methods_have_no_device():
    with pytest.raises(ValueError, match="only the method 'auto' has one, 'tv' is computed on"):
        reconstruct(burst_of(), method="tv", device="numpy")


def test_without_pytorch_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "torch", None)
    with pytest.raises(ImportError, match=r"pip install 'lensshift\[torch\]'"):
        reconstruct(burst_of(), device="cuda")


def test_a_cuda_device_that_is_not_there_is_an_error():
    pytest.importorskip("torch", reason="the extra torch is not installed")
    count = import_module("torch").cuda.device_count()
    with pytest.raises(ValueError, match=rf"finds {count} CUDA devices here, so there is no"):
        reconstruct(burst_of(), device=f"cuda:{count}")


class _Elsewhere(DeviceKernels):
    """A device that has shapes alone, and refuses what lies on another one."""

    def back(self, values):
        return np.ones(values.shape, np.complex64 if values.is_complex() else np.float32)


@pytest.mark.parametrize("of_field", [False, True])
@pytest.mark.parametrize("of", [mosaic_burst, phasor_mosaic])
def test_nothing_stays_behind_on_the_way_to_a_device(of, of_field):
    torch = pytest.importorskip("torch", reason="the extra torch is not installed")
    burst = of(0, SHAPE)
    field = np.broadcast_to(burst.offset_px[:, None, None], (4, *SHAPE, 2))
    shifts = {"shift_field_px": field} if of_field else {"offset_px": burst.offset_px}
    model = forward_model(SHAPE, 2, **shifts)
    found = solver.solve(
        model, burst.y, np.full(burst.y.shape, burst.sigma), blur_px=0.3,
        on=_Elsewhere(torch, "meta"),
    )  # fmt: skip
    assert found.image.shape == model.hr_shape
    with pytest.raises(RuntimeError, match="meta"):  # it would have been noticed
        torch.ones(3, device="meta") + torch.ones(3)
