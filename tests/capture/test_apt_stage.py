"""The driver against emulated controllers over TCP and pty, well and ill."""

import _thread
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import serial.tools.list_ports

from lensshift.capture.drivers import apt_codec as apt
from lensshift.capture.drivers.apt import AptSettings, AptStage, open_apt_stage
from lensshift.capture.drivers.apt_codec import Id, Message
from lensshift.capture.drivers.apt_cube import find_port
from lensshift.capture.drivers.apt_settings import Z8_COUNTS_PER_MM, travel_time_s
from lensshift.capture.emulators.apt import (
    AptController,
    EmulatedStagePair,
    serve_pty,
    serve_tcp,
)
from lensshift.capture.rig import Stage
from lensshift.core.errors import DeviceError, DeviceTimeout

SPEED = 50.0  # of the emulated time
# The machine of the tests may stand still for seconds; that is not the driver's fault.
PATIENT = AptSettings(home="if_needed", enable_wait_s=0.05, timeout_margin_s=30.0, max_retries=20)
# Fast home, slow moves: time to do something in mid-move.
SLOW_SPEED = 5.0  # 5 mm take 100 s: a machine that stands still for seconds does not miss them
SLOW = AptSettings(
    home="if_needed", enable_wait_s=0.25, timeout_margin_s=30.0, max_retries=20,
    home_velocity_mmps=100.0, velocity_mmps=0.01, acceleration_mmps2=1000.0,
)  # fmt: skip
PLAY_MM = 0.006
COUNT_MM = 1.0 / Z8_COUNTS_PER_MM


@contextmanager
def served(row: AptController, col: AptController) -> Iterator[tuple[str, str]]:
    with serve_pty(row) as first, serve_pty(col) as second:
        yield first.url, second.url


def pair_of(
    row: AptController | None = None, speed: float = SPEED
) -> tuple[AptController, AptController]:
    return (
        row or AptController(speed=speed),
        AptController(model="TDC001", serial_number=83000001, speed=speed, seed=1),
    )


def during(condition: Callable[[], bool], action: Callable[[], None]) -> threading.Thread:
    """Do `action` as soon as `condition` holds, in another thread."""

    def watch() -> None:
        while not condition():
            time.sleep(0.005)
        action()

    thread = threading.Thread(target=watch, daemon=True)
    thread.start()
    return thread


def until_it_fails(action: Callable[[], object]) -> None:
    while True:
        action()


def stands(controller: AptController, seconds_s: float = 0.15) -> bool:
    before_mm = controller.motor_mm()
    time.sleep(seconds_s)
    return controller.motor_mm() == before_mm


@pytest.fixture(scope="module", params=["tcp", "pty"])
def rig(request: pytest.FixtureRequest) -> Iterator[tuple[EmulatedStagePair, AptStage]]:
    with (
        EmulatedStagePair(
            play_mm=PLAY_MM, encoder_noise_mm=2e-5, speed=SPEED, link=request.param
        ) as pair,
        open_apt_stage(*pair.urls, PATIENT) as stage,
    ):
        yield pair, stage


def test_home_is_the_zero_of_the_lens(rig: tuple[EmulatedStagePair, AptStage]) -> None:
    pair, stage = rig
    home_mm = stage.home()
    assert home_mm == pytest.approx([0.0, 0.0], abs=5 * COUNT_MM)
    assert pair.lens_mm() == pytest.approx([0.0, 0.0], abs=2 * COUNT_MM)


def test_every_move_puts_the_lens_right(rig: tuple[EmulatedStagePair, AptStage]) -> None:
    pair, stage = rig
    for goal_mm in ([0.3, 0.5], [0.38, 0.42], [0.3, 0.42], [0.301, 0.419], [0.301, 0.419]):
        read_mm = stage.move_to(goal_mm)
        assert read_mm == pytest.approx(goal_mm, abs=5 * COUNT_MM)
        assert pair.lens_mm() == pytest.approx(goal_mm, abs=2 * COUNT_MM)
        assert stage.position_mm() == pytest.approx(goal_mm, abs=5 * COUNT_MM)


def test_both_axes_move_at_once() -> None:
    """One axis is told before the other, however late: the move is ended once both have gone."""
    seen_mm: list[float] = []

    with moving_slowly() as (row, col, stage, under_way):

        def look() -> None:
            seen_mm.extend([row.motor_mm(), col.motor_mm()])
            row.fail_motion()
            col.fail_motion()

        during(under_way, look)
        with pytest.raises(DeviceError, match="motion error"):
            stage.move_to([5.0, 5.0])
    assert min(seen_mm) > 0.01
    assert max(seen_mm) < 4.9


def test_stage_fulfils_the_protocol(rig: tuple[EmulatedStagePair, AptStage]) -> None:
    stage: Stage = rig[1]
    assert stage.name == "KDC101 27000001, TDC001 83000001"
    np.testing.assert_allclose(stage.travel_mm, [[0.02, 6.0], [0.02, 6.0]])
    about = stage.describe()
    assert about["row"]["model"] == "KDC101"
    assert about["col"]["serial_number"] == 83000001
    assert about["row"]["stage_id"] == 11
    assert about["col"]["firmware"] == "2.0.4"
    assert about["motion"]["approach_mm"] == 0.02
    assert about["settings"]["counts_per_mm"] == 34554.96


@pytest.mark.parametrize(
    "goal_mm", [[0.0, 1.0], [1.0, 6.001], [np.nan, 1.0], [1.0], [[1.0, 1.0]], 1.0]
)
def test_positions_out_of_travel_are_refused(
    rig: tuple[EmulatedStagePair, AptStage], goal_mm: object
) -> None:
    with pytest.raises(ValueError, match=r"expected a position \[2\] within 0.02 .. 6 and"):
        rig[1].move_to(goal_mm)


def test_parameters_arrive(rig: tuple[EmulatedStagePair, AptStage]) -> None:
    for controller in rig[0].controllers:
        for request, expected in (
            (Id.REQUEST_VELOCITY, apt.Velocity(0, 1055, 1777857)),  # 2.3 mm/s, 4 mm/s^2
            (Id.REQUEST_HOME, apt.Home(2, 1, 772981, 10366)),
            (Id.REQUEST_BACKLASH, apt.Target(0)),
            (Id.REQUEST_LIMITS, apt.Limits(3, 3, 207330, 0, 1)),
        ):
            said = controller.receive(Message(request, (1, 0)).to_bytes())
            assert said[6:] == expected.pack()


def test_position_is_read_from_another_thread_during_a_move(
    rig: tuple[EmulatedStagePair, AptStage],
) -> None:
    stage = rig[1]
    stage.move_to([0.5, 0.5])
    seen_mm, ended = [], threading.Event()

    def watch() -> None:
        while not ended.is_set():
            seen_mm.append(stage.position_mm())

    watcher = threading.Thread(target=watch)
    watcher.start()
    for goal_mm in ([3.0, 2.0], [0.5, 0.5]):
        assert stage.move_to(goal_mm) == pytest.approx(goal_mm, abs=5 * COUNT_MM)
    ended.set()
    watcher.join()
    assert np.all(np.array(seen_mm) > 0.47)
    assert np.all(np.array(seen_mm) < 3.01)


def test_without_approach_the_lens_is_off_though_the_encoder_is_right() -> None:
    with EmulatedStagePair(play_mm=PLAY_MM, speed=SPEED, link="pty") as pair:
        settings = replace(PATIENT, approach_mm=0.0)
        with open_apt_stage(*pair.urls, settings) as stage:
            stage.move_to([0.5, 0.5])
            assert pair.lens_mm() == pytest.approx([0.5, 0.5], abs=2 * COUNT_MM)
            read_mm = stage.move_to([0.4, 0.6])
            assert read_mm == pytest.approx([0.4, 0.6], abs=2 * COUNT_MM)
            assert pair.lens_mm() == pytest.approx([0.4 + PLAY_MM, 0.6], abs=2 * COUNT_MM)


def test_each_axis_ends_its_moves_in_the_direction_that_it_is_told() -> None:
    """An axis that lifts the lens is held by its weight; the other may need the other way."""
    settings = replace(PATIENT, approach_direction=("backward", "forward"))
    with EmulatedStagePair(play_mm=0.006, speed=20.0) as pair:
        stage = open_apt_stage(*pair.urls, settings)
        np.testing.assert_allclose(stage.travel_mm, [[0.0, 5.98], [0.02, 6.0]])
        np.testing.assert_array_equal(stage.approach_mm, [-0.02, 0.02])
        for goal in (3.0, 3.05, 2.95):
            stage.move_to([goal, goal])
            lags_mm = pair.lens_mm() - [one.motor_mm() for one in pair.controllers]
            np.testing.assert_allclose(lags_mm, [0.006, 0.0], atol=3e-5)  # one count
        stage.close()


@pytest.mark.parametrize("loss", [0.02, 0.1])
def test_damaged_replies_give_no_wrong_position(loss: float) -> None:
    with (
        EmulatedStagePair(
            play_mm=PLAY_MM, encoder_noise_mm=2e-5, loss=loss, speed=SPEED, seed=3, link="pty"
        ) as pair,
        open_apt_stage(*pair.urls, PATIENT) as stage,
    ):
        for step in range(4):
            goal_mm = np.array([1.0 + 0.05 * (step % 2), 1.0 - 0.05 * (step // 2)])
            assert stage.move_to(goal_mm) == pytest.approx(goal_mm, abs=5 * COUNT_MM)
            assert pair.lens_mm() == pytest.approx(goal_mm, abs=2 * COUNT_MM)
            for _ in range(3):
                assert stage.position_mm() == pytest.approx(goal_mm, abs=5 * COUNT_MM)
        about = stage.describe()
    if loss > 0.05:
        assert about["row"]["resyncs"] + about["col"]["resyncs"] > 5
        assert about["row"]["repeated_requests"] + about["col"]["repeated_requests"] > 5


def test_damaged_commands_give_no_wrong_position() -> None:
    with (
        EmulatedStagePair(
            play_mm=PLAY_MM, loss=0.05, loss_in=0.05, speed=SPEED, seed=5, link="pty"
        ) as pair,
        open_apt_stage(*pair.urls, PATIENT) as stage,
    ):
        arrived = 0
        for step in range(5):
            goal_mm = np.array([3.0 + 0.05 * (step % 2), 3.0 - 0.05 * (step // 3)])
            # A damaged command may drive to a switch before it is seen, and that is an error.
            with suppress(DeviceError):
                stage.move_to(goal_mm)
                assert pair.lens_mm() == pytest.approx(goal_mm, abs=2 * COUNT_MM)
                arrived += 1
        assert arrived >= 2


class _Stubborn(AptController):
    """Keeps its backlash, or does not take some commands."""

    def __init__(self, deaf_to: Id, first: int = 10**9, **settings: float) -> None:
        self._deaf_to, self._left = deaf_to, first
        super().__init__(speed=SPEED, **settings)

    def _handle(self, message: Message) -> bytes:
        if message.id == self._deaf_to and self._left > 0:
            self._left -= 1
            return b""
        return super()._handle(message)


def test_parameter_that_is_not_kept_is_named() -> None:
    with (
        served(*pair_of(_Stubborn(Id.SET_BACKLASH))) as urls,
        pytest.raises(
            DeviceError, match=r"KDC101 27000001: set backlash parameters: wrote .*counts=0.*3455"
        ),
    ):
        open_apt_stage(*urls, PATIENT)


def test_lost_commands_are_sent_again() -> None:
    with ExitStack() as stack:
        row, col = _Stubborn(Id.MOVE_ABSOLUTE, 2), _Stubborn(Id.MOVE_HOME, 1, serial_number=2)
        stage = stack.enter_context(open_apt_stage(*stack.enter_context(served(row, col)), PATIENT))
        stage.move_to([1.0, 1.0])
        assert row.lens_mm() == pytest.approx(1.0, abs=2 * COUNT_MM)
        assert stage.describe()["row"]["repeated_moves"] == 2
        assert stage.describe()["col"]["repeated_moves"] == 1


def test_motor_that_never_sets_out_is_an_error() -> None:
    settings = replace(PATIENT, max_retries=6)
    row, col = _Stubborn(Id.MOVE_ABSOLUTE), AptController(serial_number=2, speed=SPEED)
    with (
        served(row, col) as urls,
        open_apt_stage(*urls, settings) as stage,
        pytest.raises(
            DeviceError,
            match=r"KDC101 27000001: move to 1.0000 mm: stands elsewhere after 6 attempts",
        ) as caught,
    ):
        stage.move_to([1.0, 1.0])
    assert caught.value.position_mm == pytest.approx((0.0,), abs=1e-3)


def test_home_too_soon_after_enabling_is_a_timeout(monkeypatch: pytest.MonkeyPatch) -> None:
    # Not the usual 0.8 s: the machine of the tests may stand still for longer.
    monkeypatch.setattr("lensshift.capture.emulators.apt_controller._LOCKS_UP_S", 60.0)
    settings = replace(
        PATIENT, enable_wait_s=0.0, timeout_margin_s=0.1, home_velocity_mmps=100.0,
        acceleration_mmps2=1000.0,
    )  # fmt: skip
    with (
        served(*pair_of(speed=1.0)) as urls,
        pytest.raises(DeviceTimeout, match=r"home: it takes longer"),
    ):
        open_apt_stage(*urls, settings)


class _Sluggish(AptController):
    """Moves far slower than its parameters say, once `slow` is set."""

    slow = False

    def _go(self, goal: float, highest: int, rising: int) -> None:
        super()._go(goal, 10 if self.slow else highest, rising)


def test_move_that_takes_too_long_is_stopped() -> None:
    row, col = pair_of(_Sluggish(speed=SPEED))
    settings = replace(PATIENT, timeout_margin_s=0.2)
    with served(row, col) as urls, open_apt_stage(*urls, settings) as stage:
        row.slow = True
        began_s = time.monotonic()
        with pytest.raises(DeviceTimeout, match=r"KDC101 27000001: move to 1.0000 mm: it takes"):
            stage.move_to([1.0, 1.0])
        assert time.monotonic() - began_s > 1.5 * travel_time_s(1.0, 2.3, 4.0)
        assert stands(row)


def test_limit_switch_is_an_error_and_can_be_left() -> None:
    # A scale that is 15 % off: 5.9 mm are 6.8 mm.
    row, col = pair_of(AptController(speed=SPEED, counts_per_mm=30000.0))
    with served(row, col) as urls, open_apt_stage(*urls, PATIENT) as stage:
        with pytest.raises(DeviceError, match=r"move to 5.9000 mm: forward limit switch") as caught:
            stage.move_to([5.9, 0.1])
        assert caught.value.device == "KDC101 27000001"
        assert caught.value.position_mm == pytest.approx((6.2 * 30000 / Z8_COUNTS_PER_MM,), abs=0.1)
        assert stage.move_to([1.0, 1.0]) == pytest.approx([1.0, 1.0], abs=5 * COUNT_MM)


@contextmanager
def moving_slowly() -> Iterator[tuple[AptController, AptController, AptStage, Callable[[], bool]]]:
    row, col = pair_of(speed=SLOW_SPEED)
    with served(row, col) as urls, open_apt_stage(*urls, SLOW) as stage:
        yield row, col, stage, lambda: min(row.motor_mm(), col.motor_mm()) > 0.01


def test_motion_error_stops_both_axes() -> None:
    with moving_slowly() as (row, col, stage, under_way):
        during(under_way, row.fail_motion)
        with pytest.raises(DeviceError, match=r"KDC101 27000001: move to 5.0000 mm: motion error"):
            stage.move_to([5.0, 5.0])
        assert stands(row)
        assert stands(col)
        assert col.motor_mm() < 4.9
        with pytest.raises(DeviceError, match="motion error"):
            stage.move_to([5.0, 5.0])


def test_opening_anew_clears_a_motion_error() -> None:
    row, col = pair_of()
    with served(row, col) as urls:
        open_apt_stage(*urls, PATIENT).close()
        row.fail_motion()
        with open_apt_stage(*urls, PATIENT) as stage:
            stage.move_to([0.5, 0.5])
    assert row.lens_mm() == pytest.approx(0.5, abs=2 * COUNT_MM)


def test_motor_that_cannot_be_enabled() -> None:
    settings = replace(PATIENT, max_retries=3)
    with (
        served(*pair_of(_Stubborn(Id.SET_ENABLED))) as urls,
        pytest.raises(DeviceError, match=r"KDC101 27000001: cannot be enabled"),
    ):
        open_apt_stage(*urls, settings)


def test_pulled_cable_stops_the_other_axis() -> None:
    with moving_slowly() as (row, col, stage, under_way):
        during(under_way, row.unplug)
        with pytest.raises(DeviceError, match=r"move to 5.0000 mm: connection lost \(cable\?\)"):
            stage.move_to([5.0, 5.0])
        assert stands(col)
        assert col.motor_mm() < 4.9
        assert not stands(row)  # nobody can tell it
        stage.stop()
        with pytest.raises(DeviceError, match="connection lost"):
            stage.position_mm()
        stage.close()
        stage.close()


def test_pulled_cable_is_noticed_over_tcp_too() -> None:
    row, col = pair_of()
    with (
        serve_tcp(row) as first,
        serve_tcp(col) as second,
        open_apt_stage(first.url, second.url, PATIENT) as stage,
    ):
        col.unplug()
        with pytest.raises(DeviceError, match="connection lost"):
            until_it_fails(stage.position_mm)


def test_ctrl_c_stops_both_axes() -> None:
    signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored under nohup
    with moving_slowly() as (row, col, stage, under_way):
        during(under_way, _thread.interrupt_main)
        with pytest.raises(KeyboardInterrupt):
            stage.move_to([5.0, 5.0])
        assert stands(row)
        assert stands(col)
        assert max(row.motor_mm(), col.motor_mm()) < 4.9


def test_an_error_between_moves_leaves_everything_at_rest_and_closed() -> None:
    row, col = pair_of()
    with (
        served(row, col) as urls,
        pytest.raises(ZeroDivisionError),
        open_apt_stage(*urls, PATIENT) as stage,
    ):
        raise ZeroDivisionError
    assert row.received[-2].id == Id.MOVE_STOP
    with pytest.raises(DeviceError, match="connection lost"):
        stage.position_mm()


def test_stop_from_another_thread_ends_the_move() -> None:
    with moving_slowly() as (row, col, stage, under_way):
        thread = during(under_way, stage.stop)
        with pytest.raises(DeviceError, match="stopped before it arrived"):
            stage.move_to([5.0, 5.0])
        thread.join()
        assert stands(row)
        assert stands(col)


def test_restarted_controller_has_lost_its_zero() -> None:
    with moving_slowly() as (row, _, stage, under_way):
        during(under_way, row.reboot)
        with pytest.raises(DeviceError, match=r"KDC101 27000001: .*its zero is lost"):
            stage.move_to([5.0, 5.0])
        with pytest.raises(DeviceError, match="it does not know its zero; home it first"):
            stage.move_to([1.0, 1.0])


def test_axes_are_homed_with_leave_only() -> None:
    """Homing takes the lens to the end of its way: what holds it may be in the way."""
    asking = replace(PATIENT, home="ask")
    row, col = pair_of()
    heard: list[tuple[str, bool]] = []

    def leave(way: str, ask: bool) -> bool:
        heard.append((way, ask))
        assert (row.lens_mm(), col.lens_mm()) == pytest.approx((2.0, 2.0), abs=COUNT_MM)
        return len(heard) > 1

    with served(row, col) as urls:
        for on_homing in (None, leave):
            with pytest.raises(DeviceError, match=r"home: nobody has allowed it.* 7\.3 mm at most"):
                open_apt_stage(*urls, asking, on_homing)
        with open_apt_stage(*urls, asking, leave) as stage:
            assert stage.position_mm() == pytest.approx([0.0, 0.0], abs=2 * COUNT_MM)
        open_apt_stage(*urls, asking).close()  # now both know their zero
        with open_apt_stage(*urls, asking) as stage:
            stage.move_to([2.0, 2.0])
        open_apt_stage(*urls, replace(PATIENT, home="always"), leave).close()
    assert [ask for _, ask in heard] == [True, True, False]
    assert "row: KDC101 27000001 is anywhere" in heard[0][0]
    assert "TDC001 83000001 goes from 2.000 mm back 2.300 mm" in heard[2][0]


def test_stage_that_is_not_homed_does_not_move() -> None:
    settings = replace(PATIENT, home="never")
    row, col = pair_of()
    with served(row, col) as urls:
        with open_apt_stage(*urls, settings) as stage, pytest.raises(DeviceError, match="zero"):
            stage.move_to([1.0, 1.0])
        assert (row.lens_mm(), col.lens_mm()) == pytest.approx((2.0, 2.0), abs=COUNT_MM)
        with open_apt_stage(*urls, PATIENT) as stage:  # now it is
            assert stage.position_mm() == pytest.approx([0.0, 0.0], abs=2 * COUNT_MM)


PORTS = [
    SimpleNamespace(device="/dev/ttyUSB3", serial_number="83000001", description="APT USB Device"),
    SimpleNamespace(device="/dev/ttyS0", serial_number=None, description="ttyS0"),
]


def test_port_is_found_by_serial_number(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(serial.tools.list_ports, "comports", lambda: PORTS)
    assert find_port("83000001") == "/dev/ttyUSB3"
    assert find_port("socket://127.0.0.1:5") == "socket://127.0.0.1:5"
    with pytest.raises(
        DeviceError, match=r"27000009: open: .*/dev/ttyUSB3 \(83000001\), /dev/ttyS0 \(ttyS0\)"
    ):
        open_apt_stage("83000001", "27000009")
    monkeypatch.setattr(serial.tools.list_ports, "comports", list)
    with pytest.raises(DeviceError, match="no serial ports at all"):
        find_port("83000001")


def test_one_device_for_both_axes_is_refused() -> None:
    with pytest.raises(ValueError, match="expected two devices"):
        open_apt_stage("/dev/ttyUSB0", "/dev/../dev/ttyUSB0")
    twice = AptController(speed=SPEED), AptController(speed=SPEED)
    with served(*twice) as urls, pytest.raises(DeviceError, match="both axes are this device"):
        open_apt_stage(*urls, PATIENT)


def test_port_that_is_not_there() -> None:
    with pytest.raises(DeviceError, match="/dev/nothing-here: open: cannot be opened"):
        open_apt_stage("/dev/nothing-here", "/dev/nor-here")


def test_port_with_no_controller() -> None:
    settings = AptSettings(max_retries=2)
    with pytest.raises(DeviceTimeout, match="loop://: request 0x0005: bytes come, but no APT"):
        open_apt_stage("loop://", "loop://?logging=error", settings)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("velocity_mmps", 0.0), ("acceleration_mmps2", -1.0), ("tolerance_mm", np.inf),
        ("counts_per_mm", (1.0, 0.0)), ("counts_per_mm", (1.0, 2.0, 3.0)), ("approach_mm", -0.1),
        ("approach_direction", "up"), ("approach_direction", ("forward", "up")),
        ("settle_polls", 1), ("max_retries", 0), ("home", "maybe"), ("travel_mm", (3.0, 3.01)),
        # What a slip of the keys makes: waits without end, numbers that no controller holds, and
        # positions that never count as reached.
        ("velocity_mmps", 1e-300), ("acceleration_mmps2", 5e-10), ("counts_per_mm", 1e300),
        ("home_offset_mm", 1e5), ("enable_wait_s", 1e300), ("timeout_margin_s", 1e10),
        ("reply_timeout_s", np.nan), ("settle_polls", 100_001), ("tolerance_mm", 1e-9),
        ("travel_mm", (0.0, np.inf)),
    ],
)  # fmt: skip
def test_bad_settings(field: str, value: object) -> None:
    with pytest.raises(ValueError, match=f"expected .*{field}"):
        AptSettings(**{field: value})


def test_a_speed_beyond_what_a_controller_can_be_told_is_refused() -> None:
    settings = AptSettings(velocity_mmps=100.0, counts_per_mm=1e6, home="never")
    with EmulatedStagePair() as pair, pytest.raises(ValueError, match="look at speeds and scale"):
        open_apt_stage(*pair.urls, settings)


def test_scale_of_each_axis() -> None:
    settings = AptSettings(counts_per_mm=(34304.0, 34555.0))
    assert [settings.scale(axis) for axis in (0, 1)] == [34304.0, 34555.0]
    assert AptSettings(counts_per_mm=34304).scale(1) == 34304.0
