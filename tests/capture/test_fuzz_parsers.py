"""Whatever arrives, the parsers answer with frames or with the errors they announce."""

import struct
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from lensshift.capture.drivers import apt_codec as apt
from lensshift.capture.drivers.apt_codec import Framer
from lensshift.capture.drivers.o3m_layout import read_diagnosis, read_image
from lensshift.capture.drivers.o3m_packets import MAX_MESSAGE_BYTES
from lensshift.capture.drivers.o3m_stream import O3MStream
from lensshift.capture.drivers.pcic_protocol import (
    MAX_MESSAGE_BYTES as MAX_PCIC_BYTES,
)
from lensshift.capture.drivers.pcic_protocol import PcicParser, read_result, write_message
from lensshift.capture.emulators.apt_controller import AptController
from lensshift.capture.emulators.apt_messages import SIZES
from lensshift.capture.emulators.o3m import (
    LAYOUTS,
    diagnosis_message,
    packetise,
    pixel_message,
)
from lensshift.capture.emulators.pcic import result_content
from lensshift.core.errors import DataError, DeviceError
from lensshift.core.types import Frame

HEADER_FIELDS = ((0, 2), (2, 2), (4, 4), (8, 4), (12, 2), (14, 2), (16, 2), (18, 2), (20, 4))
EXTREMES = (0, 1, 2, 255, 256, 2**15, 2**16 - 1, 2**31, 2**32 - 1)

Random = np.random.Generator


def seen(shape: tuple[int, int]) -> Frame:
    rng = np.random.default_rng(0)
    return Frame(rng.random(shape), rng.uniform(1, 9, shape), np.ones(shape, dtype=bool), 0.0)


def mutated(data: bytes, rng: Random) -> bytes:
    """Damage bytes as networks, versions and programmers do."""
    out = bytearray(data)
    kind = rng.integers(6)
    if kind == 0 and out:  # a few bytes
        for _ in range(rng.integers(1, 8)):
            out[rng.integers(len(out))] = rng.integers(256)
    elif kind == 1:  # cut off
        del out[rng.integers(len(out) + 1) :]
    elif kind == 2:  # too long
        out += rng.bytes(int(rng.integers(1, 200)))
    elif kind == 3 and len(out) >= 4:  # an extreme number somewhere
        at = 4 * int(rng.integers(len(out) // 4))
        out[at : at + 4] = struct.pack("<I", EXTREMES[rng.integers(len(EXTREMES))])
    elif kind == 4 and len(out) > 8:  # a piece is missing
        at = int(rng.integers(len(out) - 4))
        del out[at : at + int(rng.integers(1, 40))]
    elif kind == 5:  # nothing of the kind
        out = bytearray(rng.bytes(int(rng.integers(100))))
    return bytes(out)


def o3m_datagrams(count: int, rng: Random) -> Iterator[bytes]:
    """Yield packets of a running camera: whole, damaged, or with one field changed."""
    frame = seen((16, 64))
    contents = [pixel_message(frame, layout=layout) for layout in LAYOUTS]
    others = {256: diagnosis_message(0x22), 14: bytes(200)}
    made = cycle = packet = 0
    while made < count:
        cycle += int(rng.integers(1, 3))
        content = contents[rng.integers(len(contents))]
        if rng.random() < 0.3:
            content = mutated(content, rng)
        for datagram in packetise({8: content, **others}, cycle, packet):
            packet += 1
            chance = rng.random()
            if chance < 0.04:
                yield mutated(datagram, rng)
            elif chance < 0.05:
                at, size = HEADER_FIELDS[rng.integers(len(HEADER_FIELDS))]
                value = int(rng.integers(2 ** (8 * size)) >> rng.integers(8 * size))
                yield datagram[:at] + value.to_bytes(size, "little") + datagram[at + size :]
            elif chance < 0.06:
                yield rng.bytes(int(rng.integers(1500)))
            elif chance > 0.98:
                continue
            else:
                yield datagram
            made += 1


def held_bytes(stream: O3MStream) -> int:
    """Return what all messages under way hold."""
    return sum(
        message.size
        for sender in stream._senders.values()
        for channel in sender._channels.values()
        for message in channel._open.values()
    )


def fuzz_o3m(count: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    stream = O3MStream()
    frames = 0
    for number, datagram in enumerate(o3m_datagrams(count, rng)):
        address = ("10.0.0.1", 1 if rng.random() < 0.999 else int(rng.integers(100)))
        try:
            frame = stream.push(datagram, address, number * 1e-3)
        except DeviceError:
            continue
        if frame is not None:
            frames += 1
            assert frame.frame.amplitude.shape == (16, 64)
            assert np.isfinite(frame.frame.amplitude[frame.frame.valid]).all()
            assert frame.frame.distance_m is not None
            assert np.isfinite(frame.frame.distance_m).all()
        if number % 1000 == 0:
            assert held_bytes(stream) <= 8 * 3 * 4 * MAX_MESSAGE_BYTES
    assert frames > count / 200  # the damage left something to find
    totals = stream.totals()
    assert min(totals["partial_cycles"], totals["foreign_packets"], totals["lost_packets"]) > 0
    assert totals["wrong_size_or_version"] > 0


def fuzz_messages(count: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    readers: list[tuple[Callable[[bytes], object], bytes]] = [
        (read_image, pixel_message(seen((16, 64)), layout="1.0")),
        (read_image, pixel_message(seen((16, 64)), layout="1.4")),
        (read_diagnosis, diagnosis_message(0x22)),
        (read_result, result_content(seen((3, 5)), model="O3D")),
        (read_result, result_content(seen((3, 5)), model="O3R")),
    ]
    outcomes = {True: 0, False: 0}
    for number in range(count):
        reader, message = readers[number % len(readers)]
        for _ in range(rng.integers(1, 4)):
            message = mutated(message, rng)
        try:
            reader(message)
        except DataError:
            outcomes[False] += 1
        else:
            outcomes[True] += 1
    assert min(outcomes.values()) > count / 100


def fuzz_pcic(count: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    parser = PcicParser(max_bytes=20_000)
    good = write_message(b"0000", result_content(seen((3, 5)), model="O3R"))
    whole = damaged = 0
    for _ in range(count):
        data = good if rng.random() < 0.3 else mutated(good, rng)
        cut = int(rng.integers(len(data) + 1))
        for part in (data[:cut], data[cut:]):
            for message in parser.feed(part):
                try:
                    read_result(message.content)
                    whole += 1
                except DataError:
                    damaged += 1
            assert len(parser._buffer) <= 20_000 + 2 * len(good) + 300
            parser.begun()
    assert whole > count / 10
    assert damaged > 0
    assert parser.skipped_bytes > 0


def fuzz_apt(count: int, seed: int) -> None:
    """The driver's end of the line and the emulator's take what comes, and hold little of it."""
    rng = np.random.default_rng(seed)
    sent = [apt.Message(number, (1, 1)).to_bytes() for number in SIZES]
    sent += [apt.Message(n, data=bytes([1, *bytes(max(s) - 1)])).to_bytes()
             for n, s in SIZES.items() if max(s)]  # fmt: skip
    status = apt.Status(1000, 5, 0, int(apt.Bits.HOMED | apt.Bits.ENABLED))
    heard = apt.Message(apt.Id.STATUS, data=status.pack()).to_bytes(apt.HOST, apt.CONTROLLER)
    controller, framer = AptController(speed=100.0), Framer(apt.TO_HOST)
    whole = damaged = 0
    for number in range(count):
        data = sent[rng.integers(len(sent))]
        controller.receive(data if rng.random() < 0.5 else mutated(data, rng))
        for message in framer.feed(
            heard if rng.random() < 0.5 else mutated(heard, rng), 1e-3 * number
        ):
            try:
                apt.Status.unpack(message.data)
                whole += 1
            except apt.DamagedMessage:
                damaged += 1
        assert len(framer._held) < 200
        assert len(controller._framer._held) < 200
    assert whole > count / 10
    assert damaged > 0
    assert abs(controller.lens_mm()) < 10.0


def test_malformed_messages_of_a_stage() -> None:
    fuzz_apt(3_000, seed=8)


def test_malformed_packets_of_an_o3m() -> None:
    fuzz_o3m(10_000, seed=1)


def test_malformed_messages() -> None:
    fuzz_messages(3_000, seed=2)


def test_malformed_streams_of_pcic() -> None:
    fuzz_pcic(2_000, seed=3)


def test_random_bytes() -> None:
    rng = np.random.default_rng(4)
    parser, stream = PcicParser(), O3MStream()
    for _ in range(1_000):
        data = rng.bytes(int(rng.integers(1500)))
        assert stream.push(data, ("10.0.0.1", 1), 0.0) is None
        assert parser.feed(data) == []
    assert len(parser._buffer) < MAX_PCIC_BYTES


@pytest.mark.slow
def test_a_million_malformed_packets() -> None:
    fuzz_o3m(1_000_000, seed=5)
    fuzz_messages(300_000, seed=6)
    fuzz_pcic(300_000, seed=7)
    fuzz_apt(100_000, seed=9)


@pytest.mark.slow
@pytest.mark.parametrize("parser", ["o3m", "image", "diagnosis", "pcic", "apt"])
def test_inputs_that_reach_new_code(parser: str, tmp_path: Path) -> None:
    pytest.importorskip("atheris", reason="atheris is not installed")
    script = Path(__file__).with_name("coverage_guided.py")
    command = [sys.executable, str(script), parser, str(tmp_path / "found"), "-runs=50000"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-3000:]
    assert "Done 50000 runs" in done.stderr
