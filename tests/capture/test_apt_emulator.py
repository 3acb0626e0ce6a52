"""The emulated controller: its mechanics against closed forms, and the rules of the devices."""

import time
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lensshift.capture.drivers import apt_codec as apt
from lensshift.capture.drivers.apt_codec import Bits, Framer, Id, Message
from lensshift.capture.drivers.apt_settings import Z8_COUNTS_PER_MM, travel_time_s
from lensshift.capture.emulators.apt import AptController, EmulatedStagePair
from lensshift.capture.emulators.apt_messages import More
from lensshift.capture.emulators.apt_motion import Motion

PLAY = 200.0
ENABLE = Message(Id.SET_ENABLED, (1, 1))
HOME = Message(Id.MOVE_HOME, (1, 0))
STATUS = Message(Id.REQUEST_STATUS, (1, 0))


def answers(controller: AptController, *messages: Message) -> list[Message]:
    """Return what the controller says to messages that come in one block."""
    said = controller.receive(b"".join(message.to_bytes() for message in messages))
    return Framer(apt.TO_HOST).feed(said, 0.0)


def status(controller: AptController) -> apt.Status:
    said = [one for one in answers(controller, STATUS) if one.id == Id.STATUS]
    return apt.Status.unpack(said[-1].data)


def wait_for(condition: Callable[[], bool]) -> None:
    give_up_s = time.monotonic() + 60.0
    while not condition():
        assert time.monotonic() < give_up_s
        time.sleep(0.002)


@given(
    goals=st.lists(st.integers(-30000, 30000), min_size=1, max_size=5),
    velocity=st.floats(10.0, 1e5),
    acceleration=st.floats(100.0, 1e6),
)
def test_moves_keep_to_speed_and_acceleration_and_arrive_when_they_should(
    goals: list[int], velocity: float, acceleration: float
) -> None:
    motion, start_s, at = Motion(0.0, PLAY), 5.0, 0
    for goal in goals:
        motion.go(start_s, goal, velocity, acceleration)
        due_s = travel_time_s(abs(goal - at), velocity, acceleration)
        if goal != at:
            assert motion.end_s - start_s == pytest.approx(due_s, rel=1e-6, abs=1e-9)
        times_s = np.linspace(start_s, start_s + due_s, 101)
        motor = np.array([motion.motor(one) for one in times_s])
        lens = np.array([motion.lens(one) for one in times_s])
        speed = np.array([motion.velocity(one) for one in times_s])
        way = abs(goal - at)
        step_s = due_s / 100
        assert np.all(np.abs(speed) <= velocity * (1 + 1e-9))
        assert np.all(np.abs(np.diff(motor)) <= velocity * step_s * (1 + 1e-9) + 1e-6 * way)
        assert np.all(np.diff(motor) * np.sign(goal - at) >= -1e-6)
        assert np.all((lens >= motor - 1e-9) & (lens <= motor + PLAY + 1e-9))
        assert motor[-1] == pytest.approx(goal, abs=1e-6)
        start_s, at = motion.end_s + 1.0 if goal != at else start_s, goal


def test_lens_lags_by_the_play_until_it_is_taken_up() -> None:
    motion = Motion(0.0, PLAY)
    motion.go(0.0, 1000.0, 1e3, 1e5)
    assert motion.lens(10.0) == pytest.approx(1000.0)  # forward: with the motor
    motion.go(10.0, 900.0, 1e3, 1e5)
    assert motion.lens(20.0) == pytest.approx(1000.0)  # the play is not yet taken up
    motion.go(20.0, 500.0, 1e3, 1e5)
    assert motion.lens(30.0) == pytest.approx(500.0 + PLAY)
    motion.go(30.0, 600.0, 1e3, 1e5)
    assert motion.lens(40.0) == pytest.approx(500.0 + PLAY)
    motion.go(40.0, 800.0, 1e3, 1e5)
    assert motion.lens(50.0) == pytest.approx(800.0)
    assert [motion.lens(one) for one in (10.0, 20.0, 30.0)] == pytest.approx([1000, 1000, 700])


def test_stop_and_brake_in_mid_move() -> None:
    motion = Motion(0.0, 0.0)
    motion.go(0.0, 1e6, 1000.0, 500.0)
    motion.halt(5.0)  # 2 s to full speed over 1000 counts, then 3 s at 1000 counts/s
    assert motion.motor(99.0) == pytest.approx(4000.0)
    motion.go(10.0, 1e6, 1000.0, 500.0)
    motion.brake(15.0, 250.0)  # 4000 counts more, then v^2 / 2a
    assert motion.motor(99.0) == pytest.approx(8000.0 + 1000.0**2 / 500.0)
    assert motion.velocity(17.0) == pytest.approx(500.0)
    motion.forget(50.0)
    assert motion.motor(99.0) == pytest.approx(10000.0)


def test_home_right_after_enable_hangs_until_it_is_restarted() -> None:
    controller = AptController(speed=5.0)  # both come within 0.8 s of its time, however busy
    answers(controller, ENABLE, HOME)
    time.sleep(0.1)
    assert status(controller).bits & Bits.HOMING
    assert controller.lens_mm() == pytest.approx(2.0, abs=1e-4)
    controller.reboot()
    answers(controller, ENABLE)
    time.sleep(0.2)
    answers(controller, HOME)
    wait_for(lambda: bool(status(controller).bits & Bits.HOMED))
    assert status(controller).counts == 0
    assert controller.lens_mm() == pytest.approx(-0.3, abs=1e-4)  # no offset from the switch


def test_at_power_on_it_is_disabled_and_does_not_move() -> None:
    controller = AptController(speed=100.0)
    answers(controller, HOME, Message(Id.MOVE_ABSOLUTE, data=apt.Target(1000).pack()))
    time.sleep(0.05)
    seen = status(controller)
    assert not seen.moving
    assert not seen.bits & (Bits.ENABLED | Bits.HOMED)
    enabled = answers(controller, Message(Id.REQUEST_ENABLED, (1, 0)))
    assert enabled == [Message(Id.ENABLED, (1, 2))]


@pytest.mark.parametrize("overrun", [0, 2000])
def test_firmware_overruns_backward_moves_by_its_backlash(overrun: int) -> None:
    controller = AptController(speed=0.5, play_mm=0.01)
    answers(
        controller,
        ENABLE,
        Message(Id.SET_BACKLASH, data=apt.Target(overrun).pack()),
        Message(Id.SET_VELOCITY, data=apt.Velocity(0, 10**6, 10**8).pack()),
        Message(Id.MOVE_ABSOLUTE, data=apt.Target(-10000).pack()),
    )
    began_s = time.monotonic()
    wait_for(lambda: not status(controller).moving)
    motor = [controller.motor_mm(one) for one in np.linspace(began_s, time.monotonic(), 4000)]
    goal_mm = 2.0 - 10000 / Z8_COUNTS_PER_MM
    assert min(motor) == pytest.approx(goal_mm - overrun / Z8_COUNTS_PER_MM, abs=2e-3)
    assert motor[-1] == pytest.approx(goal_mm, abs=1e-4)
    lag_mm = controller.lens_mm() - controller.motor_mm()
    assert lag_mm == pytest.approx(0.0 if overrun else 0.01, abs=1e-4)


@pytest.mark.parametrize("model", ["TDC001", "KDC101"])
def test_end_of_a_move_is_said_with_the_status(model: str) -> None:
    controller = AptController(model=model, speed=1000.0)
    answers(controller, ENABLE, Message(Id.MOVE_ABSOLUTE, data=apt.Target(500).pack()))
    assert controller.quiet_s < 1.0
    time.sleep(0.1)
    said = Framer(apt.TO_HOST).feed(controller.due(), 0.0)
    assert [(one.id, len(one.data)) for one in said] == [(Id.COMPLETED, 14)]
    assert controller.due() == b""


def test_the_past_of_the_lens_is_remembered() -> None:
    controller = AptController(play_mm=0.006)
    answers(controller, ENABLE, Message(Id.MOVE_ABSOLUTE, data=apt.Target(20000).pack()))
    seen = []
    for _ in range(30):
        now_s = time.monotonic()
        seen.append((now_s, controller.lens_mm(now_s)))
        time.sleep(0.01)
    answers(controller, Message(Id.MOVE_STOP, (1, apt.STOP_AT_ONCE)))
    answers(controller, Message(Id.MOVE_ABSOLUTE, data=apt.Target(-20000).pack()))
    assert [controller.lens_mm(one) for one, _ in seen] == [lens_mm for _, lens_mm in seen]
    assert seen[-1][1] > seen[0][1]


def test_switches_stop_the_motor_and_are_reported() -> None:
    controller = AptController(speed=1000.0)
    for counts, bit, end_mm in (
        (-(2**31), Bits.BACKWARD_LIMIT, -0.3),
        (2**31 - 1, Bits.FORWARD_LIMIT, 6.2),
    ):
        answers(controller, ENABLE, Message(Id.MOVE_ABSOLUTE, data=apt.Target(counts).pack()))
        wait_for(lambda: not status(controller).moving)
        assert status(controller).bits & apt.LIMITS == bit
        assert controller.lens_mm() == pytest.approx(end_mm, abs=1e-4)


def test_counts_wrap_and_a_far_zero_is_at_the_other_switch() -> None:
    controller = AptController(speed=1000.0)
    answers(controller, ENABLE)
    last = apt.Target(2**31 - 1).pack()
    answers(controller, Message(More.SET_POSITION, data=last))
    place = controller.motor_mm()
    answers(controller, Message(More.MOVE_RELATIVE, data=apt.Target(5).pack()))
    wait_for(lambda: controller.motor_mm() != place and status(controller).velocity == 0)
    assert status(controller).counts == -(2**31) + 4
    home = apt.Home(2, 1, apt.servo_velocity(100_000), 2**31 - 1)
    time.sleep(0.01)  # longer than it hangs for, at its own speed
    answers(controller, Message(Id.HOME - 2, data=home.pack()), HOME)
    wait_for(lambda: bool(status(controller).bits & Bits.HOMED))
    assert status(controller).bits & Bits.FORWARD_LIMIT
    assert controller.motor_mm() < 6.5


def test_profiled_stop_takes_its_time() -> None:
    controller = AptController(speed=0.1)
    answers(controller, ENABLE, Message(Id.MOVE_ABSOLUTE, data=apt.Target(50000).pack()))
    wait_for(lambda: status(controller).counts > 5)
    for mode, moving in ((apt.STOP_PROFILED, True), (apt.STOP_AT_ONCE, False)):
        said = answers(controller, Message(Id.MOVE_STOP, (1, mode)), STATUS)
        assert apt.Status.unpack(said[-1].data).moving is moving


def test_losses_are_as_frequent_as_asked() -> None:
    controller = AptController(loss=0.3, seed=4)
    sizes = [len(controller.receive(STATUS.to_bytes())) for _ in range(500)]
    assert set(sizes) == {19, 20}
    assert np.mean(np.array(sizes) == 19) == pytest.approx(0.3, abs=0.08)


def test_noise_of_the_encoder_is_as_asked() -> None:
    controller = AptController(encoder_noise_mm=0.001, seed=5)
    counts = [status(controller).counts for _ in range(500)]
    assert np.std(counts) / Z8_COUNTS_PER_MM == pytest.approx(0.001, rel=0.15)
    assert controller.lens_mm() == pytest.approx(2.0, abs=1e-4)


def test_bad_input() -> None:
    with pytest.raises(ValueError, match="expected model"):
        AptController(model="BSC201")
    with pytest.raises(ValueError, match="positive speed"):
        AptController(speed=0.0)
    with pytest.raises(ValueError, match="expected link"):
        EmulatedStagePair(link="usb")
