"""Programs that others wrote, against the emulators: what they expect is what real devices do.

They run in an interpreter of their own, which LENSSHIFT_FOREIGN_PYTHON names (some are under the
GPL or large, so they are in no extra):

    python -m venv foreign
    foreign/bin/pip install thorlabs-apt-device pylablib-lightweight numba ifm3dpy scapy
"""

import json
import math
import os
import subprocess
import sys
import textwrap
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lensshift.capture.drivers.replay import ReplayCamera
from lensshift.capture.emulators.apt import EmulatedStagePair
from lensshift.capture.emulators.ifm_device import IfmDevice
from lensshift.capture.emulators.o3m import packetise, pixel_message
from lensshift.capture.emulators.pcic import PcicServer, directions
from lensshift.core.types import Frame

PYTHON = os.environ.get("LENSSHIFT_FOREIGN_PYTHON", sys.executable)
COUNTS_PER_MM = 34554.96


def foreign(package: str, program: str, *arguments: object) -> dict[str, Any]:
    """Run a program; return the JSON of its last line. Skip where the package is not installed."""
    there = subprocess.run([PYTHON, "-c", f"import {package}"], capture_output=True, check=False)
    if there.returncode:
        pytest.skip(f"{package} is not installed at {PYTHON}; see LENSSHIFT_FOREIGN_PYTHON")
    done = subprocess.run(
        [PYTHON, "-c", textwrap.dedent(program), *(str(one) for one in arguments)],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    return dict(json.loads(done.stdout.splitlines()[-1]))


APT_DEVICE = """
    import json, sys, time
    from thorlabs_apt_device import KDC101, TDC001

    made = {"KDC101": KDC101, "TDC001": TDC001}[sys.argv[2]]
    device = made(serial_port=sys.argv[1], serial_number=None, home=False)

    def wait(done):
        end = time.monotonic() + 20
        while not done() and time.monotonic() < end:
            time.sleep(0.05)

    def still():
        time.sleep(0.3)
        wait(lambda: not any(device.status[n] for n in moving))
        return device.status["position"]

    moving = ("moving_forward", "moving_reverse", "jogging_forward", "jogging_reverse", "homing")
    told = {}
    time.sleep(0.5)
    device.set_enabled(True)
    time.sleep(0.3)
    device.set_velocity_params(acceleration=1000, max_velocity=2000000)
    device.home()
    wait(lambda: device.status["homed"])
    told["homed"] = device.status["homed"]
    told["at_home"] = still()
    device.move_absolute(100000)
    told["absolute"] = still()
    device.move_relative(-5000)
    told["relative"] = still()
    device.set_jog_params(2000, 1000, 2000000, continuous=False)
    device.move_jog(direction="forward")
    told["jogged"] = still()
    device.move_jog(direction="reverse")
    told["jogged_back"] = still()
    told["step"] = device.jogparams["step_size"]
    device.move_velocity(direction="forward")
    time.sleep(0.2)
    told["under_way"] = any(device.status[n] for n in moving)
    device.stop()
    told["stopped"] = still()
    told["enabled"] = device.status["channel_enabled"]
    device.close()
    print(json.dumps(told))
"""


@pytest.mark.skipif(os.name == "nt", reason="no pseudo terminals there")
@pytest.mark.parametrize("model", ["KDC101", "TDC001"])
def test_thorlabs_apt_device(model: str) -> None:
    with EmulatedStagePair(link="pty", speed=10.0) as pair:
        which = [one.info.model for one in pair.controllers].index(model)
        told = foreign("thorlabs_apt_device", APT_DEVICE, pair.urls[which], model)
        stands = pair.controllers[which].motor_mm() * COUNTS_PER_MM
    assert told["homed"]
    assert told["enabled"]
    assert (told["at_home"], told["absolute"], told["relative"]) == (0, 100000, 95000)
    assert (told["jogged"], told["jogged_back"], told["step"]) == (97000, 95000, 2000)
    assert told["under_way"]
    assert told["stopped"] > 95000
    home_offset = 0.3 * COUNTS_PER_MM  # it homes without one, so its zero is the switch
    assert told["stopped"] == pytest.approx(stands + home_offset, abs=2)


PYLABLIB = """
    import json, sys, time
    from pylablib.devices.Thorlabs import kinesis

    for one in vars(kinesis).values():  # a pseudo terminal has no RTS line to toggle
        if isinstance(one, type) and hasattr(one, "_cycle_rts"):
            one._cycle_rts = staticmethod(lambda *a, **k: None)
    motor = kinesis.KinesisMotor(("serial", sys.argv[1]), scale="step")
    told = {"model": motor.get_device_info().model_no}
    told["limits"] = motor.get_limit_switch_parameters() is not None
    told["backlash"] = motor.get_gen_move_parameters() is not None
    motor.setup_velocity(max_velocity=2000000, acceleration=1000)
    motor.home(sync=True, force=True, timeout=60)
    told["homed"] = motor.is_homed()
    motor.move_to(100000)
    motor.wait_move(timeout=30)
    told["absolute"] = motor.get_position()
    motor.move_by(-5000)
    motor.wait_move(timeout=30)
    told["relative"] = motor.get_position()
    motor.setup_jog(mode="step", step_size=2000, max_velocity=2000000, acceleration=1000)
    told["step"] = motor.get_jog_parameters().step_size
    motor.jog("+", kind="builtin")
    motor.wait_move(timeout=30)
    told["jogged"] = motor.get_position()
    motor.jog("-", kind="continuous")
    time.sleep(0.1)
    told["under_way"] = motor.is_moving()
    motor.stop(immediate=True)
    motor.wait_move(timeout=30)
    told["stopped"] = motor.get_position()
    motor.set_position_reference(1234)
    told["renamed"] = motor.get_position()
    told["status"] = motor.get_status()
    motor.blink()
    motor.close()
    print(json.dumps(told))
"""


@pytest.mark.skipif(os.name == "nt", reason="no pseudo terminals there")
def test_pylablib() -> None:
    with EmulatedStagePair(link="pty", speed=10.0) as pair:
        for one in pair.controllers:
            one.receive(bytes.fromhex("100201015001"))  # enabled, as the button of a cube does
        told = foreign("pylablib", PYLABLIB, pair.urls[0])
    assert told["model"] == "KDC101"
    assert told["homed"]
    assert (told["absolute"], told["relative"], told["jogged"]) == (100000, 95000, 97000)
    assert told["step"] == 2000
    assert told["under_way"]
    assert told["stopped"] < 97000
    assert told["renamed"] == 1234
    assert {"homed", "enabled", "connected"} <= set(told["status"])


IFM3D = """
    import json, sys, time
    from ifm3dpy.device import O3D, O3R, Device
    from ifm3dpy.framegrabber import FrameGrabber, buffer_id as B

    rpc, pcic, model = int(sys.argv[1]), int(sys.argv[2]), sys.argv[3]
    camera = (O3R if model == "O3R" else O3D)("127.0.0.1", rpc)
    told = {"who": str(camera.who_am_i()), "firmware": str(camera.firmware_version()),
            "kind": type(Device("127.0.0.1", rpc)).__name__}
    if model == "O3R":
        (port,) = camera.ports()
        told["port"] = [port.port, port.pcic_port, port.type]
        told["state"] = camera.get(["/ports/port0/state"])["ports"]["port0"]["state"]
    wanted = {"amplitude": B.NORM_AMPLITUDE_IMAGE, "distance": B.RADIAL_DISTANCE_IMAGE,
              "confidence": B.CONFIDENCE_IMAGE, "xyz": B.XYZ}
    if model == "O3D":
        wanted["vectors"] = B.UNIT_VECTOR_ALL
        wanted["diagnostic"] = B.DIAGNOSTIC
        wanted["extrinsic"] = B.EXTRINSIC_CALIB
    else:
        wanted["info"] = B.TOF_INFO
    grabber, frames = FrameGrabber(camera, pcic), []
    grabber.on_new_frame(frames.append)
    grabber.start(list(wanted.values())).wait_for(5000)
    end = time.monotonic() + 20
    while len(frames) < 3 and time.monotonic() < end:
        time.sleep(0.05)
    frame = frames[-1]
    told["images"] = {n: frame.get_buffer(b).tolist() for n, b in wanted.items()}
    told["count"] = [one.frame_count() for one in frames[:3]]
    grabber.stop().wait_for(2000)
    print(json.dumps(told))
"""


@pytest.mark.parametrize("model", ["O3D", "O3R"])
def test_ifm3d(model: str) -> None:
    """The client of the vendor opens the camera, asks for images and reads what was seen."""
    rng = np.random.default_rng(3)
    distance_m, valid = rng.uniform(0.5, 4.0, (11, 17)), rng.random((11, 17)) > 0.1
    frame = Frame(rng.random((11, 17)), distance_m, valid, 0.0)
    with (
        PcicServer(lambda begin_s, end_s: frame, model=model, rate_hz=20.0) as server,
        IfmDevice(model, server.port) as device,
    ):
        told = foreign("ifm3dpy", IFM3D, device.port, server.port, model)
        port = server.port
    assert told["who"].endswith(model)
    seen = {name: np.array(image) for name, image in told["images"].items()}
    step_m = 1.0 if model == "O3R" else 1e-3  # an O3R's client turns counts into metres
    error_m = np.abs(seen["distance"] * step_m - distance_m)[valid].max()
    assert error_m <= 0.51 * (1e-3 if model == "O3D" else 1.5259e-4)
    assert np.array_equal((seen["confidence"] & 1) == 0, valid)
    looked = directions((11, 17)) * distance_m[..., None]
    scale = 1.0 if model == "O3R" else 1e-3
    np.testing.assert_allclose((seen["xyz"] * scale)[valid], looked[valid], atol=2e-3)
    assert told["count"] == sorted(set(told["count"]))
    if model == "O3D":
        np.testing.assert_allclose(seen["vectors"], directions((11, 17)), atol=1e-6)
    else:
        assert told["port"] == ["port0", port, "3D"]
        assert told["state"] == "RUN"


SCAPY = """
    import json, pathlib, sys
    from scapy.all import Dot1Q, Ether, IP, UDP, Raw, CookedLinux, fragment, wrpcap
    from scapy.utils import PcapNgWriter

    folder = pathlib.Path(sys.argv[1])
    parts = [bytes.fromhex(one) for one in json.loads(pathlib.Path(sys.argv[2]).read_text())]
    ip = IP(src="192.168.1.69", dst="192.168.1.255")
    packets = [ip / UDP(sport=50000, dport=42000) / Raw(one) for one in parts]
    wrpcap(str(folder / "raw.pcap"), packets, linktype=101)
    ether = [Ether(src="00:02:01:00:00:01", dst="ff:ff:ff:ff:ff:ff") / one for one in packets]
    wrpcap(str(folder / "ethernet.pcap"), ether)
    wrpcap(str(folder / "nanoseconds.pcap"), ether, nano=True)
    wrpcap(str(folder / "big_endian.pcap"), ether, endianness=">")
    vlan = [Ether(src=e.src, dst=e.dst) / Dot1Q(vlan=5) / p for e, p in zip(ether, packets)]
    wrpcap(str(folder / "vlan.pcap"), vlan)
    torn = [Ether(src=ether[0].src, dst=ether[0].dst) / f for p in packets
            for f in fragment(p, fragsize=552)]
    wrpcap(str(folder / "fragments.pcap"), torn)
    wrpcap(str(folder / "cooked.pcap"), [CookedLinux(proto=0x800) / p for p in packets])
    with PcapNgWriter(str(folder / "ethernet.pcapng")) as file:
        for one in ether:
            file.write(one)
    print(json.dumps({"files": sorted(one.name for one in folder.glob("*.pcap*"))}))
"""


def test_recordings_that_scapy_wrote(tmp_path: Path) -> None:
    rng, sent, packets = np.random.default_rng(4), [], []
    for number in range(5):
        distance_m = rng.uniform(0.5, 9.0, (16, 64))
        frame = Frame(rng.random((16, 64)), distance_m, np.ones((16, 64), dtype=bool), 0.0)
        sent.append(distance_m)
        packets += packetise({8: pixel_message(frame)}, 100 + number, 1000 + 20 * number)
    (tmp_path / "packets.json").write_text(json.dumps([one.hex() for one in packets]))
    told = foreign("scapy", SCAPY, tmp_path, tmp_path / "packets.json")
    assert len(told["files"]) == 8
    for name in told["files"]:
        camera = ReplayCamera(tmp_path / name, pitch_mm=0.155, speed=math.inf)
        camera.open()
        for distance_m in sent:
            seen_m = camera.next_frame(20.0).frame.distance_m
            np.testing.assert_allclose(seen_m, distance_m, atol=1e-5, err_msg=name)
        camera.close()
