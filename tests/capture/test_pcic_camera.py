"""The PCIC driver against the emulator, over the loopback of this computer."""

import itertools
import json
import socket
import threading
import time
import tracemalloc
import xmlrpc.client
from collections.abc import Iterator
from contextlib import contextmanager, suppress

import numpy as np
import pytest

from lensshift.capture.drivers.pcic import PcicCamera
from lensshift.capture.drivers.pcic_protocol import write_message
from lensshift.capture.emulators.ifm_device import IfmDevice
from lensshift.capture.emulators.pcic import PcicServer, directions, result_content
from lensshift.core.errors import DeviceError, DeviceTimeout
from lensshift.core.types import Frame

WAIT_S = 30.0


def seen(number: int) -> Frame:
    amplitude = np.full((13, 17), 0.001 * (number + 1))
    return Frame(amplitude, 1.0 + amplitude, np.ones((13, 17), dtype=bool), 0.0)


def server(**settings: object) -> PcicServer:
    numbers = itertools.count()
    return PcicServer(
        lambda begin_s, end_s: seen(next(numbers)),
        rate_hz=30.0,
        **settings,  # type: ignore[arg-type]
    )


def client(emulator: PcicServer, **settings: object) -> PcicCamera:
    return PcicCamera(
        "127.0.0.1",
        emulator.port,
        pitch_mm=(0.1, 0.2),
        timeout_s=WAIT_S,
        **settings,  # type: ignore[arg-type]
    )


def fetch_many(camera: PcicCamera) -> None:
    for _ in range(1000):
        camera.next_frame(WAIT_S)


@pytest.mark.parametrize("model", ["O3D", "O3R"])
def test_results_become_frames(model: str) -> None:
    with server(model=model, first_count=2**32 - 3) as emulator:
        camera = client(emulator, schema='{"layouter": "flexible"}', modulation_hz=30e6)
        with pytest.raises(DeviceError, match="open"):
            _ = camera.grid
        camera.open()
        with pytest.raises(DeviceError, match="already"):
            camera.open()
        assert camera.grid.shape == (13, 17)
        assert camera.grid.pitch_mm == (0.1, 0.2)
        assert emulator.schema == b'{"layouter": "flexible"}'
        frames = [camera.next_frame(WAIT_S) for _ in range(8)]
        unit = 1000.0 if model == "O3D" else 1.0  # an O3D sends counts
        for number, one in enumerate(frames):
            np.testing.assert_allclose(one.frame.amplitude, unit * seen(number).amplitude)
            assert one.frame.distance_m is not None
            np.testing.assert_allclose(one.frame.distance_m, 1.001 + 0.001 * number, atol=8e-5)
        cycles = [one.cycle for one in frames]
        assert all(np.diff(cycles) >= 1)  # also where the counter wraps
        assert camera.newest_cycle() >= cycles[-1]
        assert all(np.diff([one.frame.time_s for one in frames]) > 0)
        assert camera.counts()["frames"] >= 8
        assert camera.counts()["wrong_results"] == 0
        about = camera.describe()
        assert about["schema"] == '{"layouter": "flexible"}'
        assert ("distance_resolution_m" in about) == (model == "O3R")
        camera.close()
        camera.close()


def test_a_lost_connection_is_told_after_the_last_frame() -> None:
    with server() as emulator:
        camera = client(emulator)
        camera.open()
        camera.next_frame(WAIT_S)
        emulator.hang_up()
        for _ in range(2):
            with pytest.raises(DeviceError, match=r"closed the connection|lost"):
                fetch_many(camera)
        camera.close()
        camera.open()  # by hand it is made again
        camera.next_frame(WAIT_S)
        camera.close()


def test_a_port_that_is_taken_is_named() -> None:
    with server() as first, pytest.raises(OSError, match=rf":{first.port} .* another port"):
        server(port=first.port)


def test_garbage_between_results_is_skipped() -> None:
    with server() as emulator:
        camera = client(emulator)
        camera.open()
        emulator.inject(b"0000L999999999\r\n0000" + bytes(100))
        while not camera.counts()["oversize_messages"]:
            camera.next_frame(WAIT_S)
        assert camera.next_frame(WAIT_S).frame.valid.all()
        assert camera.counts()["skipped_bytes"] == 120
        camera.close()


def test_a_camera_that_starts_anew_is_told() -> None:
    with server() as emulator:
        camera = client(emulator)
        camera.open()
        before = camera.next_frame(WAIT_S)
        emulator.reboot()
        with pytest.raises(DeviceError, match="started anew"):
            fetch_many(camera)
        assert camera.next_frame(WAIT_S).cycle > before.cycle
        camera.close()


@contextmanager
def scripted(*script: bytes | threading.Event) -> Iterator[PcicCamera]:
    """Yield an open camera whose server sends these bytes, and waits for these events."""

    def serve() -> None:
        connection, _ = listener.accept()
        with connection:
            command = connection.recv(100)
            connection.sendall(write_message(command[:4], b"*"))
            for one in script:
                if isinstance(one, bytes):
                    connection.sendall(one)
                else:
                    one.wait(WAIT_S)
            connection.recv(100)  # until p0, or the client has gone

    with socket.create_server(("127.0.0.1", 0)) as listener:
        thread = threading.Thread(target=serve)
        thread.start()
        port = listener.getsockname()[1]
        camera = PcicCamera("127.0.0.1", port, pitch_mm=0.1, timeout_s=WAIT_S)
        camera.open()
        yield camera
        camera.close()
        thread.join()


def result(number: int, frame: Frame | None = None) -> bytes:
    return write_message(b"0000", result_content(frame or seen(number), count=number))


def test_a_frame_is_known_to_have_begun_before_it_is_whole() -> None:
    go_on = threading.Event()
    with scripted(result(7), result(9)[:200], go_on, result(9)[200:]) as camera:
        assert camera.next_frame(WAIT_S).cycle == 7
        while camera.newest_cycle() < 9:
            time.sleep(0.01)
        with pytest.raises(DeviceTimeout):
            camera.next_frame(0.0)
        go_on.set()
        assert camera.next_frame(WAIT_S).cycle == 9


def test_results_that_cannot_be_used_are_told() -> None:
    turned = Frame(np.ones((17, 13)), None, np.ones((17, 13), dtype=bool), 0.0)
    empty = write_message(b"0000", b"starstop")
    for useless, told in ((empty, "holds no amplitude"), (result(8, turned), "has become 13 x 17")):
        go_on = threading.Event()
        with scripted(result(7), go_on, useless, result(9)) as camera:
            camera.next_frame(WAIT_S)
            go_on.set()
            assert camera.next_frame(WAIT_S).cycle == 9
            assert camera.counts()["wrong_results"] == 1
            assert told in camera._explain(0, 0)


def test_no_camera_at_the_address() -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
    camera = PcicCamera("127.0.0.1", port, pitch_mm=0.1)
    with pytest.raises(DeviceError, match="cannot connect"):
        camera.open()
    with pytest.raises(DeviceError, match="not open"):
        camera.next_frame(0.0)
    camera.close()


def test_a_server_that_does_not_answer() -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        camera = PcicCamera("127.0.0.1", listener.getsockname()[1], pitch_mm=0.1, timeout_s=0.2)
        with pytest.raises(DeviceTimeout, match="p1: no answer"):
            camera.open()


def test_a_camera_that_waits_for_a_trigger() -> None:
    class Silent(PcicServer):
        def _send_result(self, client: socket.socket, begin_s: float, end_s: float) -> None:
            pass

    with Silent(lambda begin_s, end_s: seen(0)) as emulator:
        camera = PcicCamera("127.0.0.1", emulator.port, pitch_mm=0.1, timeout_s=2.0)
        with pytest.raises(DeviceTimeout, match="trigger"):
            camera.open()


def test_a_refused_schema() -> None:
    class Strict(PcicServer):
        def _answer(self, command: bytes) -> bytes:
            return b"!" if command[:1] == b"c" else super()._answer(command)

    with Strict(lambda begin_s, end_s: seen(0)) as emulator:
        camera = client(emulator, schema="{}")
        with pytest.raises(DeviceError, match="refused"):
            camera.open()


def test_commands_are_answered_as_the_manual_says() -> None:
    def ask(connection: socket.socket, command: bytes) -> bytes:
        connection.sendall(b"1234L%09d\r\n1234%s\r\n" % (len(command) + 6, command))
        answer = b""
        while not answer.endswith(b"\r\n") or len(answer) < 22:
            answer += connection.recv(4096)
        assert answer.startswith(b"1234L%09d\r\n1234" % (len(answer) - 16))
        return answer[20:-2]

    with (
        server() as emulator,
        socket.create_connection(("127.0.0.1", emulator.port), WAIT_S) as connection,
    ):
        assert ask(connection, b"V?") == b"03 01 04"
        assert b"EMULATOR" in ask(connection, b"G?")
        assert ask(connection, b"C?").endswith(emulator.schema)
        assert ask(connection, b"c000000002{}") == b"*"
        assert ask(connection, b"C?") == b"000000002{}"
        assert ask(connection, b"p0") == b"*"
        assert ask(connection, b"nonsense") == b"?"


def test_wrong_arguments() -> None:
    with pytest.raises(ValueError, match="this computer"):
        PcicServer(lambda a, b: seen(0), host="0.0.0.0")
    with pytest.raises(ValueError, match="model"):
        PcicServer(lambda a, b: seen(0), model="O3M")
    with pytest.raises(ValueError, match="exposure"):
        PcicServer(lambda a, b: seen(0), rate_hz=1000.0)
    with pytest.raises(ValueError, match="pitch"):
        PcicCamera("127.0.0.1", pitch_mm=0.0)


def schema_of(*names: str) -> str:
    blobs = [{"type": "blob", "id": name} for name in names]
    return json.dumps({"layouter": "flexible", "elements": [
        {"type": "string", "value": "star", "id": "start_string"}, *blobs,
        {"type": "string", "value": "stop", "id": "end_string"},
    ]})  # fmt: skip


def test_a_result_holds_what_the_schema_asks_for() -> None:
    wanted = ("amplitude_image", "confidence_image", "all_unit_vector_matrices")
    with server() as emulator:
        camera = client(emulator, schema=schema_of(*wanted))
        camera.open()
        shot = camera.next_frame(WAIT_S)
        assert set(shot.raw) == {"amplitude", "confidence"}
        assert shot.frame.distance_m is None
        looking = camera.intrinsics
        assert looking is not None
        np.testing.assert_allclose(looking.direction, directions((13, 17)), atol=1e-6)
        camera.close()


@pytest.mark.parametrize("wrong", ["{", "[]", schema_of("colour_image"), '{"elements": 3}'])
def test_a_schema_that_cannot_be_served_is_refused(wrong: str) -> None:
    with server() as emulator, pytest.raises(DeviceError, match="refused"):
        client(emulator, schema=wrong).open()


def test_rubbish_and_deaf_clients_neither_fill_memory_nor_stop_the_server() -> None:
    with server() as emulator:
        address = ("127.0.0.1", emulator.port)
        tracemalloc.start()
        with socket.create_connection(address) as rubbish, suppress(OSError):
            for _ in range(200):
                rubbish.sendall(bytes(100_000))
            rubbish.sendall(b"1234L999999999\r\n" + bytes(100_000))
        with socket.create_connection(address) as deaf:
            deaf.sendall(write_message(b"1000", b"p1"))
            time.sleep(0.2)
        _, most = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        assert most < 2_000_000  # of the 20 MB that came
        camera = client(emulator)
        camera.open()
        camera.next_frame(WAIT_S)
        camera.close()


@pytest.mark.parametrize(("model", "family"), [("O3D", range(1, 256)), ("O3R", range(768, 1024))])
def test_what_a_client_asks_before_it_opens_a_camera(model: str, family: range) -> None:
    with IfmDevice(model, 50010) as device:
        url = f"http://127.0.0.1:{device.port}/api/rpc/v1/com.ifm.efector/"
        proxy = xmlrpc.client.ServerProxy(url)
        assert int(str(proxy.getParameter("DeviceType")).split(":")[1]) in family
        with pytest.raises(xmlrpc.client.Fault):
            proxy.reboot()
        with pytest.raises(xmlrpc.client.ProtocolError, match="413"):
            proxy.getParameter("x" * 100_000)
        if model == "O3R":
            assert json.loads(str(proxy.get(["/ports/port0/data/pcicTCPPort"]))) == {
                "ports": {"port0": {"data": {"pcicTCPPort": 50010}}}
            }
        proxy("close")()
