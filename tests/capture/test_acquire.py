"""Acquisition against devices in memory whose every step is known."""

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import ArrayLike, NDArray

from lensshift import load_burst, save_burst
from lensshift.capture.acquire import Acquisition, Progress, acquire, acquire_at
from lensshift.capture.plan import PLANS, load_plan, named_plan, shortest_order
from lensshift.capture.rig import CameraFrame
from lensshift.capture.rounds import bursts, frames
from lensshift.core.calibration import Calibration
from lensshift.core.errors import DataError, DeviceError, DeviceTimeout
from lensshift.core.grid import Grid
from lensshift.core.intrinsics import Pinhole
from lensshift.core.motion import ShiftPlan, StageMap
from lensshift.core.types import Frame
from lensshift.io.capture_file import read_capture

REST = np.array([3.0, 2.5])
CALIBRATION = Calibration(StageMap(np.array([[5.6, 0.1], [-0.1, -5.5]]), sigma_px=0.01), REST)


@dataclass
class MemoryStage:
    name: str = "stage 1, stage 2"
    place_mm: NDArray[Any] = field(default_factory=lambda: np.array([3.0, 2.5]))
    visited: list[NDArray[Any]] = field(default_factory=list)
    direct: list[bool] = field(default_factory=list)
    stops: int = 0
    fails_at: int | None = None
    drifts_mm: float = 0.0
    travel_mm: NDArray[Any] = field(default_factory=lambda: np.array([[0.0, 6.0], [0.0, 6.0]]))

    def position_mm(self) -> NDArray[Any]:
        self.place_mm = self.place_mm + self.drifts_mm
        return self.place_mm.copy()

    def move_to(self, position_mm: ArrayLike, *, direct: bool = False) -> NDArray[Any]:
        if self.fails_at == len(self.visited):
            raise DeviceError("motion error", device="stage 1", command="move")
        self.place_mm = np.array(position_mm, dtype=float)
        self.visited.append(self.place_mm)
        self.direct.append(direct)
        return self.place_mm.copy()

    def stop(self) -> None:
        self.stops += 1

    def close(self) -> None: ...

    def describe(self) -> Mapping[str, Any]:
        return {"model": "memory"}


@dataclass
class MemoryCamera:
    """Its frames show where the stage stood as they began; `pipeline` of them are under way."""

    stage: MemoryStage
    pipeline: int = 2
    loses: frozenset[int] = frozenset()
    silent_after: int = 10**9
    name: str = "camera"
    grid: Grid = field(default_factory=lambda: Grid((2, 3), (0.155, 0.155)))
    modulation_hz: float | None = 15e6
    cycle: int = 0
    under_way: deque[tuple[int, NDArray[Any]]] = field(default_factory=deque)

    def open(self) -> None: ...

    def newest_cycle(self) -> int:
        self._fill()
        return self.under_way[0][0]

    def _fill(self) -> None:
        while len(self.under_way) <= self.pipeline:
            self.under_way.append((self.cycle, self.stage.place_mm.copy()))
            self.cycle += 1

    def next_frame(self, timeout_s: float) -> CameraFrame:
        while True:
            self._fill()
            cycle, seen_mm = self.under_way.popleft()
            if cycle > self.silent_after:
                raise DeviceTimeout("no packets", device=self.name, command="frame")
            if cycle not in self.loses:
                break
        amplitude = np.full(self.grid.shape, seen_mm[0] + 1e-3 * cycle)
        valid = np.ones(self.grid.shape, dtype=bool)
        valid[0, 0] = cycle % 2 == 0
        frame = Frame(amplitude, np.full(self.grid.shape, seen_mm[1]), valid, 0.04 * cycle)
        return CameraFrame(frame, cycle, 0.04 * cycle, {"cycle_word": np.array([cycle])})

    def counts(self) -> Mapping[str, int]:
        return {"frames": self.cycle}

    def close(self) -> None: ...

    def describe(self) -> Mapping[str, Any]:
        return {"firmware": "none"}


def devices(**camera: Any) -> tuple[MemoryStage, MemoryCamera]:
    stage = MemoryStage()
    return stage, MemoryCamera(stage, **camera)


@given(loses=st.frozensets(st.integers(0, 60), max_size=20), frames=st.integers(1, 4))
def test_every_kept_frame_began_after_the_stage_had_settled(
    loses: frozenset[int], frames: int, tmp_path_factory: pytest.TempPathFactory
) -> None:
    stage, camera = devices(loses=loses)
    path = tmp_path_factory.mktemp("a") / "burst.nc"
    plan = named_plan("square")
    burst = acquire(stage, camera, plan, CALIBRATION, path, Acquisition(frames=frames))
    assert burst.frame_count == 4 * frames
    np.testing.assert_array_equal(burst.distance_m[:, 0, 0], burst.stage_mm[:, 1])  # type: ignore[index]
    np.testing.assert_array_equal(burst.raw["cycle"], burst.raw["cycle_word"][:, 0])
    cycles = burst.raw["cycle_word"][:, 0]
    np.testing.assert_allclose(
        burst.amplitude[:, 0, 1],
        burst.stage_mm[:, 0] + 1e-3 * cycles,  # type: ignore[index]
    )
    assert len(set(cycles.tolist())) == len(cycles)
    got = sorted(map(tuple, burst.offset_px.round(9).tolist()))
    assert got == sorted(map(tuple, np.repeat(plan.target_px, frames, axis=0).tolist()))


def test_without_discarding_a_frame_from_before_would_come(tmp_path: Path) -> None:
    """The test above can fail."""
    stage, camera = devices()
    burst = acquire(
        stage, camera, named_plan("square"), CALIBRATION, tmp_path / "a.nc", Acquisition(discard=0)
    )
    assert np.any(burst.distance_m[:, 0, 0] != burst.stage_mm[:, 1])  # type: ignore[index]


class LateCamera(MemoryCamera):
    """Frames are under way before the first move, but nobody knows until one is whole."""

    whole: bool = False

    def newest_cycle(self) -> int:
        return super().newest_cycle() if self.whole else -1

    def next_frame(self, timeout_s: float) -> CameraFrame:
        self.whole = True
        return super().next_frame(timeout_s)


def test_a_camera_that_was_not_heard_yet_has_begun_frames_all_the_same(tmp_path: Path) -> None:
    stage = MemoryStage()
    camera = LateCamera(stage, cycle=1000)  # it has been running for a while
    MemoryCamera.newest_cycle(camera)
    burst = acquire(stage, camera, named_plan("square"), CALIBRATION, tmp_path / "a.nc")
    np.testing.assert_array_equal(burst.distance_m[:, 0, 0], burst.stage_mm[:, 1])  # type: ignore[index]


def test_the_lens_returns_and_the_file_says_all(tmp_path: Path) -> None:
    stage, camera = devices()
    told: list[Progress] = []
    path = tmp_path / "burst.nc"
    acquire(stage, camera, named_plan("3x3"), CALIBRATION, path, on_step=told.append)
    np.testing.assert_array_equal(stage.place_mm, REST)
    assert stage.stops == 0
    burst = load_burst(path)
    assert burst.meta["stage"]["model"] == "memory"
    assert burst.meta["camera"]["firmware"] == "none"
    assert burst.offset_source == "planned"
    np.testing.assert_allclose(burst.offset_sigma_px, 0.01)
    assert [one.step for one in told] == list(range(1, 10))
    assert told[-1].steps == 9
    assert told[-1].rate_hz == pytest.approx(25.0)


def test_the_mean_of_a_pixel_leaves_out_where_it_is_invalid(tmp_path: Path) -> None:
    stage, camera = devices(pipeline=0)
    settings = Acquisition(frames=4, average=True, discard=0)
    burst = acquire(stage, camera, named_plan("still"), CALIBRATION, tmp_path / "a.nc", settings)
    assert burst.frame_count == 1
    assert burst.valid is not None
    assert burst.valid.all()
    all_four = burst.amplitude[0, 1, 1] - stage.visited[0][0]
    only_even = burst.amplitude[0, 0, 0] - stage.visited[0][0]
    first = round(all_four * 1e3 - 1.5)
    assert all_four == pytest.approx(1e-3 * (first + 1.5))
    assert only_even == pytest.approx(
        1e-3 * np.mean([c for c in range(first, first + 4) if c % 2 == 0])
    )


def test_a_silent_camera_leaves_the_frames_and_a_resume_completes_them(tmp_path: Path) -> None:
    stage, camera = devices(silent_after=14)
    path = tmp_path / "burst.nc"
    with pytest.raises(DeviceTimeout, match="camera: frame: no packets"):
        acquire(stage, camera, named_plan("3x3"), CALIBRATION, path)
    assert stage.stops == 1
    np.testing.assert_array_equal(stage.place_mm, REST)
    done = load_burst(path).frame_count
    assert 0 < done < 9
    before = len(stage.visited)
    burst = acquire(stage, MemoryCamera(stage), named_plan("3x3"), CALIBRATION, path, resume=True)
    assert burst.frame_count == 9
    assert len(stage.visited) - before == 9 - done + 1
    got = sorted(map(tuple, burst.offset_px.round(9).tolist()))
    assert got == sorted(map(tuple, named_plan("3x3").target_px.round(9).tolist()))


def test_a_stage_that_fails_stands_still(tmp_path: Path) -> None:
    stage, camera = devices()
    stage.fails_at = 2
    path = tmp_path / "burst.nc"
    with pytest.raises(DeviceError, match="motion error"):
        acquire(stage, camera, named_plan("square"), CALIBRATION, path)
    assert stage.stops == 1
    assert len(stage.visited) == 2
    assert load_burst(path).frame_count == 2
    stage.fails_at = None
    assert acquire(stage, camera, named_plan("square"), CALIBRATION, path, resume=True).frame_count


def test_a_stage_that_strays_is_noticed(tmp_path: Path) -> None:
    stage, camera = devices()
    stage.drifts_mm = 0.01
    with pytest.raises(DeviceError, match=r"strayed 10\.0 um"):
        acquire(stage, camera, named_plan("square"), CALIBRATION, tmp_path / "a.nc")


def test_the_wrong_file_is_not_resumed(tmp_path: Path) -> None:
    stage, camera = devices(silent_after=6)
    path = tmp_path / "burst.nc"
    with pytest.raises(DeviceTimeout):
        acquire(stage, camera, named_plan("square"), CALIBRATION, path)
    camera = MemoryCamera(stage)
    with pytest.raises(DataError, match="begun with plan square, not 3x3"):
        acquire(stage, camera, named_plan("3x3"), CALIBRATION, path, resume=True)
    with pytest.raises(DataError, match="begun with frames 1, not 2"):
        acquire(stage, camera, named_plan("square"), CALIBRATION, path, Acquisition(2), resume=True)
    other = MemoryCamera(stage, modulation_hz=20e6)  # its distances are of another range
    with pytest.raises(DataError, match="begun with modulation_hz 15000000"):
        acquire(stage, other, named_plan("square"), CALIBRATION, path, resume=True)
    with pytest.raises(DataError, match="there is a file of this name"):
        acquire(stage, camera, named_plan("square"), CALIBRATION, path)
    acquire(stage, camera, named_plan("square"), CALIBRATION, path, resume=True)
    before = len(stage.visited)
    again = acquire(stage, camera, named_plan("square"), CALIBRATION, path, resume=True)
    assert (again.frame_count, len(stage.visited)) == (4, before)  # complete: nothing moves
    with pytest.raises(DataError, match="complete, with plan square, not 3x3"):
        acquire(stage, camera, named_plan("3x3"), CALIBRATION, path, resume=True)
    with pytest.raises(DataError, match="complete, with frames 1, not 2"):
        acquire(stage, camera, named_plan("square"), CALIBRATION, path, Acquisition(2), resume=True)
    save_burst(replace(again, meta={}), path)
    with pytest.raises(DataError, match="nothing to resume: this is no capture"):
        acquire(stage, camera, named_plan("square"), CALIBRATION, path, resume=True)


@dataclass
class ToldStage(MemoryStage):
    settings: Mapping[str, Any] = field(default_factory=dict)

    def describe(self) -> Mapping[str, Any]:
        return {"settings": self.settings}


@dataclass
class ToldCamera(MemoryCamera):
    exposure_s: float = 0.01

    def describe(self) -> Mapping[str, Any]:
        return {"celsius": 20.0 + self.cycle, "settings": {"exposure_s": self.exposure_s}}


def test_a_capture_goes_on_with_the_devices_that_it_began_with(tmp_path: Path) -> None:
    """Axes that were exchanged, or another scale, put frames where nobody says that they are."""
    settings = {"counts_per_mm": (34555.0, 34555.0), "approach_direction": "forward"}
    stage, path = ToldStage(settings=settings), tmp_path / "burst.nc"
    plan = named_plan("square")
    with pytest.raises(DeviceTimeout):
        acquire(stage, ToldCamera(stage, silent_after=6), plan, CALIBRATION, path)
    others: list[tuple[str, MemoryStage, MemoryCamera]] = [
        ("stage.name", replace(stage, name="stage 2, stage 1"), ToldCamera(stage)),
        ("stage.settings", replace(stage, settings={**settings, "counts_per_mm": 34304.0}),
         ToldCamera(stage)),
        ("camera.name", stage, ToldCamera(stage, name="another")),
        ("camera.settings", stage, ToldCamera(stage, exposure_s=0.02)),
    ]  # fmt: skip
    for name, *devices in others:
        before = len(stage.visited)
        with pytest.raises(DataError, match=rf"{name}: .* begun with {name} .*--restart"):
            acquire(*devices, plan, CALIBRATION, path, resume=True)
        assert len(stage.visited) == before
    done = acquire(stage, ToldCamera(stage, cycle=50), plan, CALIBRATION, path, resume=True)
    assert done.frame_count == 4


def test_a_capture_goes_on_with_the_calibration_that_it_began_with(tmp_path: Path) -> None:
    """Else one burst holds the positions of one map with the offsets of another."""
    stage, camera = devices(silent_after=6)
    path = tmp_path / "burst.nc"
    with pytest.raises(DeviceTimeout):
        acquire(stage, camera, named_plan("square"), CALIBRATION, path)
    begun, camera = len(load_burst(path).amplitude), MemoryCamera(stage)
    twice = StageMap(2.0 * CALIBRATION.stage_map.px_per_mm, sigma_px=0.01)
    for other in (replace(CALIBRATION, stage_map=twice), replace(CALIBRATION, rest_mm=REST + 0.1)):
        with pytest.raises(
            DataError, match=r"calibration: .* begun with calibration sha256 .*, not sha256"
        ):
            acquire(stage, camera, named_plan("square"), other, path, resume=True)
    farther = ShiftPlan(2.0 * named_plan("square").target_px, name="square")
    with pytest.raises(DataError, match="begun with other positions"):
        acquire(stage, camera, farther, CALIBRATION, path, resume=True)
    assert load_burst(path).frame_count == begun
    header, _ = read_capture(path)
    assert header["calibration"]["px_per_mm"] == CALIBRATION.stage_map.px_per_mm.tolist()
    dated = replace(CALIBRATION, notes={"date": "today"})  # the same map, written down again
    burst = acquire(stage, camera, named_plan("square"), dated, path, resume=True)
    np.testing.assert_allclose(burst.offset_px, CALIBRATION.offset_px(burst.stage_mm))


def test_a_burst_knows_the_blur_that_its_rig_was_calibrated_to_have(tmp_path: Path) -> None:
    stage, camera = devices()
    sharp = replace(CALIBRATION, psf_sigma_px=0.34)
    burst = acquire(stage, camera, named_plan("square"), sharp, tmp_path / "burst.nc")
    assert burst.meta["psf_sigma_px"] == 0.34


def test_places_out_of_reach_are_refused_before_anything_moves(tmp_path: Path) -> None:
    stage, camera = devices()
    plan = ShiftPlan(np.array([[0.0, 0.0], [0.0, 20.0]]))
    with pytest.raises(ValueError, match=r"position 1 at .* is out of travel"):
        acquire(stage, camera, plan, CALIBRATION, tmp_path / "a.nc")
    assert not stage.visited
    assert not (tmp_path / "a.nc").exists()


def test_the_map_of_another_sensor_is_refused_before_anything_moves(tmp_path: Path) -> None:
    stage, camera = devices()
    rows, cols = camera.grid.shape
    field = np.broadcast_to(np.eye(2), (rows, cols + 1, 2, 2))
    other = Calibration(StageMap(np.eye(2), field), REST)
    plan, said = named_plan("square"), rf"\({rows}, {cols}\) pixels, got \({rows}, {cols + 1}\)"
    with pytest.raises(ValueError, match=said):
        acquire(stage, camera, plan, other, tmp_path / "a.nc")
    for stream in (bursts, frames):
        with pytest.raises(ValueError, match=said):
            next(stream(stage, camera, plan, other))
    assert not stage.visited


SCAN = np.column_stack([np.array([3.0, 2.9, 3.1, 3.1, 2.9]), np.full(5, 3.0)])


def test_a_scan_goes_straight_through_its_positions_in_order(tmp_path: Path) -> None:
    stage, camera = devices()
    burst = acquire_at(stage, camera, SCAN, CALIBRATION, tmp_path / "a.nc", direct=True)
    np.testing.assert_array_equal(burst.stage_commanded_mm, SCAN)
    np.testing.assert_array_equal(stage.visited[:-1], SCAN)
    assert stage.direct == [True] * 5 + [False]


def test_a_resumed_scan_comes_from_where_the_scan_came_from(tmp_path: Path) -> None:
    stage, camera = devices(silent_after=10)
    path = tmp_path / "a.nc"
    with pytest.raises(DeviceTimeout):
        acquire_at(stage, camera, SCAN, CALIBRATION, path, direct=True)
    last = max(load_burst(path).meta["step"])
    stage.visited.clear()
    burst = acquire_at(
        stage, MemoryCamera(stage), SCAN, CALIBRATION, path, direct=True, resume=True
    )
    np.testing.assert_array_equal(burst.stage_commanded_mm, SCAN)
    np.testing.assert_array_equal(stage.visited[:-1], SCAN[last:])


def test_an_endless_stream_ends_with_the_lens_at_rest() -> None:
    stage, camera = devices()
    stream = bursts(stage, camera, named_plan("square"), CALIBRATION)
    three = list(islice(stream, 3))
    stream.close()
    assert [one.frame_count for one in three] == [4, 4, 4]
    np.testing.assert_array_equal(stage.place_mm, REST)


def test_frames_one_by_one_know_their_place_on_the_plan() -> None:
    stage, camera = devices()
    plan = named_plan("square")
    stream = frames(stage, camera, plan, CALIBRATION, Acquisition(frames=2))
    records = list(islice(stream, 16))
    stream.close()  # type: ignore[attr-defined]
    places = [one.step for one in records]
    assert sorted(places) == [0] * 4 + [1] * 4 + [2] * 4 + [3] * 4
    assert places[:8] == places[8:]
    for one in records:
        expected_mm = CALIBRATION.stage_mm(plan.target_px[one.step][None])[0]
        np.testing.assert_allclose(one.stage_commanded_mm, expected_mm)
    np.testing.assert_array_equal(stage.place_mm, REST)


@pytest.mark.parametrize("name", PLANS)
def test_plans_are_centred_and_sample_evenly(name: str) -> None:
    target = named_plan(name).target_px
    np.testing.assert_allclose(target.mean(axis=0), 0.0, atol=1e-12)
    assert len(np.unique(np.mod(target, 1.0).round(9), axis=0)) == len(target)


def test_a_plan_of_the_users_own(tmp_path: Path) -> None:
    file = tmp_path / "mine.csv"
    file.write_text("row,col\n0,0\n0.5,0.25\n")
    plan = load_plan(file)
    assert plan.name == "mine"
    np.testing.assert_array_equal(plan.target_px, [[0, 0], [0.5, 0.25]])
    with pytest.raises(ValueError, match="expected a plan of square"):
        named_plan("round")


def way(order: list[int], places: NDArray[Any], overrun: float) -> float:
    total, here = 0.0, np.zeros(2)
    for place in places[order]:
        step = place - here
        total += float(np.max(np.abs(step) + 2 * overrun * (step < 0)))
        here = place
    return total


@given(
    st.lists(st.tuples(st.integers(0, 9), st.integers(0, 9)), min_size=1, max_size=6),
    st.floats(0, 3),
)
def test_no_order_is_shorter(cells: list[tuple[int, int]], overrun: float) -> None:
    from itertools import permutations

    places = np.array(cells, dtype=float)
    order = shortest_order(places, overrun, [0.0, 0.0])
    assert sorted(order) == list(range(len(cells)))
    best = min(way(list(one), places, overrun) for one in permutations(range(len(cells))))
    assert way(order, places, overrun) == pytest.approx(best)


def test_the_order_knows_which_way_each_axis_overruns() -> None:
    """One axis runs up forward, the other backward: the cheap way round is a diagonal."""
    square = np.array([[0.0, 0.0], [0.0, 1.0], [1.0, 0.0], [1.0, 1.0]])
    forward = shortest_order(square, 2.0, [0.0, 0.0])
    mirrored = shortest_order(square * [1, -1], [2.0, -2.0], [0.0, 0.0])
    assert forward == mirrored
    assert shortest_order(-square, -2.0, [0.0, 0.0]) == forward


def test_many_places_are_visited_once_and_not_in_the_given_order() -> None:
    places = np.random.default_rng(2).random((16, 2))
    order = shortest_order(places, 0.1, [0.0, 0.0])
    assert sorted(order) == list(range(16))
    assert way(order, places, 0.1) < 0.6 * way(list(range(16)), places, 0.1)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"frames": 0}, "expected frames of 1 to 100000"),
        ({"discard": -1}, "expected discard of 0 to 100000"),
        ({"hold_mm": 0.0}, "positive hold_mm"),
        ({"frame_timeout_s": 1e18}, "positive frame_timeout_s up to 1e"),
    ],
)
def test_bad_settings(wrong: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Acquisition(**wrong)


@dataclass
class LookingCamera(MemoryCamera):
    """Tells where its pixels look once a frame has come, as a driver does."""

    @property
    def intrinsics(self) -> Pinhole | None:
        return Pinhole(3.0, 3.0, 1.0, 0.5) if self.cycle else None


def test_a_burst_keeps_where_the_camera_says_that_its_pixels_look(tmp_path: Path) -> None:
    stage = MemoryStage()
    camera = LookingCamera(stage)
    path, plan = tmp_path / "a.nc", named_plan("square")
    assert acquire(stage, camera, plan, CALIBRATION, path).intrinsics == camera.intrinsics
    assert load_burst(path).intrinsics == camera.intrinsics
    (burst,) = islice(bursts(stage, camera, plan, CALIBRATION), 1)
    assert burst.intrinsics == camera.intrinsics
    assert acquire(*devices(), plan, CALIBRATION, tmp_path / "b.nc").intrinsics is None
