"""How fast the methods are, as ratios of times measured in one process, one after the other.

    pytest benchmarks/bench_speed.py

`irwsr` and `irwsr-toolbox` do the same work: one fixed weight, 10 x 5 iterations.
"""

import time
from collections.abc import Callable

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from lensshift import Burst, Reconstruction, reconstruct
from lensshift.camera import Sensor, simulate_burst
from lensshift.core.grid import Grid
from lensshift.evaluation import psnr_db
from lensshift.scene import demo_target

SMALL, LARGE = (16, 64), (240, 320)
WEIGHT = 0.01
IRREGULAR_PX = ((-0.27, -0.22), (-0.21, 0.29), (0.26, -0.24), (0.23, 0.28))
SQUARE_PX = ((-0.25, -0.25), (-0.25, 0.25), (0.25, -0.25), (0.25, 0.25))
ITERATIONS = {"iterations": 10, "inner_iterations": 5}


def burst_of(shape: tuple[int, int], offset_px: tuple[tuple[float, float], ...]) -> tuple:
    """Return a burst whose shifts are exactly known, and its truth."""
    grid = Grid(shape, (0.155, 0.155))
    target = demo_target((shape[0] * 0.155, shape[1] * 0.155))
    burst, truth = simulate_burst(target, Sensor(grid), offset_px, shift_error_px=0.0)
    return burst, truth.image


def solve(burst: Burst, method: str) -> Reconstruction:
    """Reconstruct with the fixed weight; `auto` finds its own."""
    if method == "auto":
        return reconstruct(burst, std=False)
    return reconstruct(burst, method=method, prior_weight=WEIGHT, std=False, **ITERATIONS)


def median_s(work: Callable[[], object], rounds: int) -> float:
    """Return the median wall time of some rounds."""
    taken_s = []
    for _ in range(rounds):
        start_s = time.perf_counter()
        work()
        taken_s.append(time.perf_counter() - start_s)
    return float(np.median(taken_s))


@pytest.mark.parametrize(("shape", "rounds", "toolbox_rounds"), [(SMALL, 30, 3), (LARGE, 5, 1)])
def test_irwsr_against_the_toolbox(
    benchmark: BenchmarkFixture,
    report: list[str],
    shape: tuple[int, int],
    rounds: int,
    toolbox_rounds: int,
) -> None:
    burst, truth = burst_of(shape, SQUARE_PX)
    quality_db = psnr_db(solve(burst, "irwsr").amplitude.image, truth)
    toolbox_db = psnr_db(solve(burst, "irwsr-toolbox").amplitude.image, truth)
    toolbox_s = median_s(lambda: solve(burst, "irwsr-toolbox"), toolbox_rounds)
    benchmark.pedantic(solve, (burst, "irwsr"), rounds=rounds, warmup_rounds=1)
    ours_s = benchmark.stats.stats.median
    report.append(
        f"irwsr at {shape[1]} x {shape[0]} x 4: {1e3 * ours_s:.1f} ms, toolbox "
        f"{1e3 * toolbox_s:.0f} ms, ratio {toolbox_s / ours_s:.0f}; "
        f"PSNR {quality_db:.2f} and {toolbox_db:.2f} dB"
    )


@pytest.mark.parametrize(("shape", "rounds"), [(SMALL, 30), (LARGE, 5)])
def test_irwsr_with_irregular_shifts(
    benchmark: BenchmarkFixture, report: list[str], shape: tuple[int, int], rounds: int
) -> None:
    square, _ = burst_of(shape, SQUARE_PX)
    irregular, _ = burst_of(shape, IRREGULAR_PX)
    solve(square, "irwsr")
    square_s = median_s(lambda: solve(square, "irwsr"), rounds)
    benchmark.pedantic(solve, (irregular, "irwsr"), rounds=rounds, warmup_rounds=1)
    irregular_s = benchmark.stats.stats.median
    report.append(
        f"irwsr at {shape[1]} x {shape[0]} x 4, any shifts: {1e3 * irregular_s:.1f} ms, "
        f"{irregular_s / square_s:.1f} times the quarter-pixel square"
    )


@pytest.mark.parametrize(("shape", "rounds"), [(SMALL, 30), (LARGE, 1)])
def test_auto(
    benchmark: BenchmarkFixture, report: list[str], shape: tuple[int, int], rounds: int
) -> None:
    burst, truth = burst_of(shape, SQUARE_PX)
    solve(burst_of(SMALL, SQUARE_PX)[0], "auto")  # compiles
    result = benchmark.pedantic(solve, (burst, "auto"), rounds=rounds)
    report.append(
        f"auto at {shape[1]} x {shape[0]} x 4: {1e3 * benchmark.stats.stats.median:.1f} ms, "
        f"PSNR {psnr_db(result.amplitude.image, truth):.2f} dB"
    )
