"""Wrong shifts are named by the command line, and right ones are left in peace."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from stand_in import Call, answer

import lensshift
from lensshift.core.types import Burst
from lensshift.io import save_burst
from lensshift.pipeline import demo_burst

Shifts = NDArray[np.float64]
FINE = 8  # samples of the scene per LR pixel

# As new users get them wrong; what the message has to say.
MISTAKES: dict[str, tuple[Callable[[Shifts], Shifts], str]] = {
    "negated": (lambda d: -d, "sign"),
    "swapped": (lambda d: d[:, ::-1], "swapped|(row, col)|sign|order"),
    "zero": (lambda d: 0 * d, "not told"),
    "doubled": (lambda d: 2 * d, "unit"),
    "other order": (lambda d: d[[1, 0, 3, 2, *range(4, len(d))]], "order|sign"),
}


def told(call: Call, burst: Burst, folder: Path, *options: object) -> list[str]:
    """Return the warnings of `lensshift reconstruct` on this burst."""
    save_burst(burst, folder / "burst.nc")
    warnings: list[str] = answer(
        call, "reconstruct", folder / "burst.nc", "-o", folder / "sharp.nc", *options
    )["warnings"]
    return warnings


def scene(seed: int, rows: int, cols: int) -> NDArray[np.float64]:
    """Return a random picture [row col] of FINE samples per pixel: surfaces, lines, texture."""
    rng = np.random.default_rng(seed)
    size = np.array([rows, cols]) * FINE
    row, col = np.mgrid[: size[0], : size[1]] / FINE
    picture = np.full(size, rng.uniform(0.2, 0.8))
    for _ in range(rng.integers(4, 12)):
        at, wide = rng.uniform(0, [rows, cols]), rng.uniform(1, 12, 2)
        turn = rng.uniform(0, np.pi)
        along = (row - at[0]) * np.cos(turn) + (col - at[1]) * np.sin(turn)
        across = (col - at[1]) * np.cos(turn) - (row - at[0]) * np.sin(turn)
        round_one = (along / wide[0]) ** 2 + (across / wide[1]) ** 2 < 1
        square = (np.abs(along) < wide[0]) & (np.abs(across) < wide[1])
        picture[round_one if rng.random() < 0.5 else square] = rng.uniform(0.05, 0.95)
    wave = rng.uniform(0.05, 0.4, 2) * rng.choice([-1, 1], 2)
    depth = 0.1 * rng.random()
    picture += depth * np.sin(2 * np.pi * (wave[0] * row + wave[1] * col))
    return np.asarray(picture)


def right_burst(seed: int) -> Burst:
    """Return frames of square pixels, by sums over samples: nothing of the forward model."""
    rng = np.random.default_rng([seed, 1])
    rows, cols = int(rng.integers(15, 33)), int(rng.integers(24, 57))
    border = 2
    picture = scene(seed, rows + 2 * border, cols + 2 * border)
    grids = {
        4: [(0, 0), (0, 4), (4, 4), (4, 0)],
        9: [(i, j) for i in (0, 3, 5) for j in (0, 3, 5)],
        16: [(i, j) for i in (0, 2, 4, 6) for j in (0, 2, 4, 6)],
    }
    steps = np.array(grids[int(rng.choice([4, 4, 9, 16]))]) - rng.integers(0, 4, 2)
    frames = []
    for down, right in steps:
        top, left = border * FINE - down, border * FINE - right
        part = picture[top : top + rows * FINE, left : left + cols * FINE]
        frames.append(part.reshape(rows, FINE, cols, FINE).mean(axis=(1, 3)))
    noise = 10 ** rng.uniform(-3.5, -1.3)
    noisy = np.stack(frames) + rng.normal(0, noise, (len(steps), rows, cols))
    spoilt = steps / FINE + rng.normal(0, rng.choice([0, 0.01, 0.02]), steps.shape)
    return Burst.from_arrays(noisy, offset_px=spoilt, pitch_mm=0.155)


@pytest.fixture(scope="module")
def boxes(tmp_path_factory: pytest.TempPathFactory) -> Burst:
    from lensshift.pipeline import default_experiment
    from lensshift.pipeline.experiment import simulate

    return simulate(default_experiment()).burst


def check(warnings: list[str], words: str) -> None:
    found = [text for text in warnings if "contradict offset_px" in text]
    assert found, "no warning"
    assert any(word in text for text in found for word in words.split("|")), found


# The default run takes one of each; all of them take over 20 s.
QUICK = {("negated", "amplitude"), ("swapped", "phasor")}
BOXES = [
    pytest.param(mistake, channel, marks=() if (mistake, channel) in QUICK else pytest.mark.slow)
    for mistake in MISTAKES
    for channel in ("phasor", "amplitude")
]


@pytest.mark.parametrize(("mistake", "channel"), BOXES)
def test_boxes(call: Call, boxes: Burst, tmp_path: Path, mistake: str, channel: str) -> None:
    make, words = MISTAKES[mistake]
    burst = replace(boxes, offset_px=make(boxes.offset_px))
    check(told(call, burst, tmp_path, "--channel", channel), words)


@pytest.mark.slow
@pytest.mark.parametrize("mistake", ["negated", "swapped", "zero"])
def test_demo(call: Call, tmp_path: Path, mistake: str) -> None:
    make, words = MISTAKES[mistake]
    burst, _ = demo_burst()
    check(told(call, replace(burst, offset_px=make(burst.offset_px)), tmp_path), words)


def chart(reference_dir: Path) -> tuple[NDArray[np.float64], Shifts]:
    frames = np.load(reference_dir / "real_sequences" / "mdsp_eia.npz")["frames"]
    step = np.stack(np.divmod(np.arange(16), 4), 1)
    return frames, -0.25 * (step - step[[0, 2, 8, 10]].mean(0))


@pytest.mark.slow
@pytest.mark.parametrize("mistake", ["negated", "zero", "other unit"])
def test_chart_of_four_frames(
    call: Call, reference_dir: Path, tmp_path: Path, mistake: str
) -> None:
    frames, right = chart(reference_dir)
    wrong = {"negated": -right, "zero": 0 * right, "other unit": 4 * right}[mistake]
    words = {"negated": "sign", "zero": "not told", "other unit": "offset_px"}[mistake]
    burst = Burst.from_arrays(frames, offset_px=wrong, pitch_mm=0.01)
    check(told(call, burst, tmp_path, "--frames", "0,2,8,10"), words)


@pytest.mark.slow
@pytest.mark.parametrize("mistake", ["negated", "swapped", "zero"])
def test_chart_of_sixteen_frames(
    call: Call, reference_dir: Path, tmp_path: Path, mistake: str
) -> None:
    frames, right = chart(reference_dir)
    make, words = MISTAKES[mistake]
    burst = Burst.from_arrays(frames, offset_px=make(right), pitch_mm=0.01)
    check(told(call, burst, tmp_path), words)


def test_right_ones_say_nothing(call: Call, boxes: Burst, tmp_path: Path) -> None:
    assert told(call, boxes, tmp_path) == []
    assert told(call, demo_burst()[0], tmp_path) == []
    assert told(call, right_burst(1000), tmp_path) == []


@pytest.mark.slow
def test_two_hundred_right_bursts_say_nothing(call: Call, tmp_path: Path) -> None:
    alarms = {seed: told(call, right_burst(seed), tmp_path) for seed in range(200)}
    assert {seed: texts for seed, texts in alarms.items() if texts} == {}


@pytest.mark.parametrize("seed", [pytest.param(101, marks=pytest.mark.slow), 132])
def test_a_picture_of_less_contrast_is_not_taken_for_other_light(
    call: Call, tmp_path: Path, seed: int
) -> None:
    """All frames are brighter than it says by the same percent or two: none differs."""
    assert told(call, right_burst(seed), tmp_path) == []


def test_units_are_questioned(call: Call, boxes: Burst, tmp_path: Path) -> None:
    assert boxes.distance_m is not None
    stack = {"amplitude": boxes.amplitude, "offset_px": boxes.offset_px, "pitch_mm": 0.155}
    for distance_m, hz, word in (
        (1e3 * boxes.distance_m, 15e6, "millimetres"),
        (boxes.distance_m, 15.0, "15 MHz are 15e6"),
    ):
        np.savez(tmp_path / "mine.npz", distance_m=distance_m, **stack)
        done = call(
            "convert", tmp_path / "mine.npz", tmp_path / "mine.nc", "--modulation-hz", hz, "--json"
        )
        assert any(word in text for text in json.loads(done.stdout)["warnings"]), done.stderr


def test_the_scenes_are_of_this_package_alone() -> None:
    burst = right_burst(3)
    assert burst.frame_count in (4, 9, 16)
    assert lensshift.register(burst).offset_px.shape == burst.offset_px.shape
