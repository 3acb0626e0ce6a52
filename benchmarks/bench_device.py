"""The solver of `auto` on devices beside the compiled kernels, one after the other in a process.

    pytest benchmarks/bench_device.py

NumPy and PyTorch run the same code; ratios are to the default, more than 1 is slower.
"""

import importlib.util
import time
from collections.abc import Callable

import numpy as np
import pytest

from lensshift import Burst, Reconstruction, reconstruct, reconstruct_batch
from lensshift.camera import Sensor, simulate_burst
from lensshift.core.grid import Grid
from lensshift.scene import demo_target

SQUARE_PX = ((-0.25, -0.25), (-0.25, 0.25), (0.25, 0.25), (0.25, -0.25))
SMALL, MIDDLE, LARGE = (16, 64), (240, 320), (480, 640)
# Of peak: what every device has to agree within.
SAME = 1e-3


def devices() -> list[str]:
    """Return what there is here besides the default."""
    if importlib.util.find_spec("torch") is None:
        return ["numpy"]
    import torch

    torch.set_num_threads(1)
    return ["numpy", "cpu"] + ["cuda"] * torch.cuda.is_available()


def burst_of(shape: tuple[int, int], channel: str, seed: int = 0) -> Burst:
    """Return a burst of the demo target, as phasors with a phase that goes with its brightness."""
    grid = Grid(shape, (0.155, 0.155))
    target = demo_target((shape[0] * 0.155, shape[1] * 0.155))
    burst, _ = simulate_burst(target, Sensor(grid), SQUARE_PX, shift_error_px=0.0, seed=seed)
    if channel == "amplitude":
        return burst
    rng = np.random.default_rng(seed)
    noise = 0.002 * rng.standard_normal((2, *burst.amplitude.shape))
    turned = burst.amplitude * np.exp(1j * np.tanh(2 * burst.amplitude - 1))
    phasors = turned + noise[0] + 1j * noise[1]
    return Burst.from_arrays(phasors, offset_px=SQUARE_PX, pitch_mm=0.155, modulation_hz=20e6)


def medians_s(works: dict[str, Callable[[], object]], rounds: int) -> dict[str, float]:
    """Return the median wall time of each, taken in turn."""
    taken_s: dict[str, list[float]] = {name: [] for name in works}
    for _ in range(rounds):
        for name, work in works.items():
            start_s = time.perf_counter()
            work()
            taken_s[name].append(time.perf_counter() - start_s)
    return {name: float(np.median(times)) for name, times in taken_s.items()}


def apart(found: Reconstruction, expected: Reconstruction) -> float:
    """Return the largest difference over the peak."""
    return max(
        float(np.abs(found.channels[name].image - one.image).max() / np.abs(one.image).max())
        for name, one in expected.channels.items()
    )


@pytest.mark.filterwarnings("ignore::lensshift.core.errors.QualityWarning")
@pytest.mark.parametrize("channel", ["amplitude", "phasor"])
@pytest.mark.parametrize(
    ("shape", "count", "rounds"), [(SMALL, 1, 15), (SMALL, 16, 3), (MIDDLE, 1, 3), (LARGE, 1, 1)]
)
def test_devices(
    report: list[str], shape: tuple[int, int], count: int, rounds: int, channel: str
) -> None:
    bursts = [burst_of(shape, channel, seed) for seed in range(count)]

    def on(device: str | None) -> list[Reconstruction]:
        if count == 1:
            return [reconstruct(bursts[0], channel=channel, device=device)]
        return reconstruct_batch(bursts, channel=channel, device=device)

    names = devices()
    expected = on(None)  # this and the next line are the warm round
    off = {name: max(map(apart, on(name), expected)) for name in names}
    assert max(off.values()) < SAME
    works = {name or "default": lambda name=name: on(name) for name in (None, *names)}
    taken_s = medians_s(works, rounds)
    default_s = taken_s.pop("default")
    said = [
        f"{name} {1e3 * taken_s[name] / count:.1f} ms (ratio {taken_s[name] / default_s:.2f}, "
        f"off {off[name]:.0e} of peak)"
        for name in names
    ]
    said += [] if "cuda" in names else ["CUDA: none here, unmeasured"]
    report.append(
        f"auto, {channel}, {shape[1]} x {shape[0]} x 4, batch of {count}: each burst "
        f"{1e3 * default_s / count:.1f} ms by default; " + "; ".join(said)
    )
