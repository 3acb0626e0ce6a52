"""Messages, chunks and images of PCIC, also those of a real O3R."""

import json
import struct
from dataclasses import astuple
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lensshift.capture.drivers.pcic_protocol import (
    ChunkKind,
    Message,
    PcicParser,
    bouguet_directions,
    read_chunks,
    read_result,
    read_tof_info,
    write_message,
)
from lensshift.capture.emulators.pcic import result_content
from lensshift.core.errors import DataError
from lensshift.core.intrinsics import Pinhole
from lensshift.core.types import Frame


def seen(seed: int = 0) -> Frame:
    rng = np.random.default_rng(seed)
    valid = rng.random((13, 17)) > 0.1
    return Frame(rng.random((13, 17)), rng.uniform(0.3, 9.0, (13, 17)), valid, 0.0)


def chunk(kind: int, pixel: int, data: bytes, shape: tuple[int, int] = (2, 3)) -> bytes:
    head = struct.pack("<9I", kind, 36 + len(data), 36, 1, shape[1], shape[0], pixel, 7, 8)
    return head + data


def test_the_buffer_of_a_real_o3r(reference_dir: Path) -> None:
    recorded = (reference_dir / "tof_data/ifm_o3r/O3RBuffer.data").read_bytes()
    (message,) = PcicParser().feed(write_message(b"0000", recorded[4:-2]))
    chunks = read_chunks(message.content)
    assert [one.kind for one in chunks] == [100, 105, 101, 300, 106, 420]
    assert all(one.shape == (172, 224) for one in chunks)
    assert {one.frame_count for one in chunks} == {1544}
    info = read_tof_info(chunks[-1])
    assert info.version == 1
    assert info.distance_resolution_m == pytest.approx(1.5259e-4, rel=1e-4)
    # Metadata and TOF_INFO are written by different parts of the camera and agree.
    assert chunks[0].metadata["DistanceResolution"] == pytest.approx(info.distance_resolution_m)
    assert len(info.intrinsic) == len(info.inverse) == 32
    # Focal length and centre in pixels, of a sensor of 224 x 172.
    assert info.intrinsic[:4] == pytest.approx((124.34, 124.34, 111.5, 85.5), abs=0.01)

    image = read_result(message.content)
    assert image.amplitude.shape == image.distance_m.shape == (172, 224)  # type: ignore[union-attr]
    assert 0.1 < image.valid.mean() < 0.5  # most pixels of this recording are invalid
    assert image.distance_m is not None
    assert image.distance_m[image.valid].min() > 0.1
    assert image.distance_m.max() < 3.0
    assert np.all(image.amplitude[image.valid] > 0)
    assert image.raw["distance_noise"].dtype == np.uint16
    assert image.time_s == pytest.approx(324896.000402)
    # It looks ahead in the middle, to the right with the columns and down with the rows.
    assert image.direction is not None
    np.testing.assert_allclose(np.linalg.norm(image.direction, axis=-1), 1.0, rtol=1e-12)
    x, y, z = np.moveaxis(image.direction, -1, 0)
    assert np.all(np.diff(x / z, axis=1) > 0)
    assert np.all(np.diff(y / z, axis=0) > 0)
    np.testing.assert_allclose(image.direction[85, 111], [0.0, 0.0, 1.0], atol=0.5 / 124)


def test_an_o3d_sends_unit_vectors_if_it_is_asked() -> None:
    vectors = np.random.default_rng(0).normal(size=(2, 3, 3)).astype("<f4")
    frame = Frame(np.ones((2, 3)), np.ones((2, 3)), np.ones((2, 3), bool), 0.0)
    content = result_content(frame)
    asked = content[:-4] + chunk(223, 10, vectors.tobytes()) + content[-4:]
    assert read_result(content).direction is None
    np.testing.assert_array_equal(read_result(asked).direction, vectors)
    for unusable in (np.zeros_like(vectors), np.full_like(vectors, np.nan)):
        broken = content[:-4] + chunk(223, 10, unusable.tobytes()) + content[-4:]
        assert read_result(broken).direction is None


def test_bouguet_numbers_without_distortion_are_a_pinhole() -> None:
    numbers = [30.0, 25.0, 9.8, 8.2, *[0.0] * 28]
    expected = Pinhole(30.0, 25.0, 9.3, 7.7).directions((15, 21))
    np.testing.assert_allclose(bouguet_directions(numbers, (15, 21)), expected, atol=1e-15)
    bent = [30.0, 25.0, 9.8, 8.2, 0.0, -0.2, 0.05, 0.003, -0.002, 0.01]
    found = bouguet_directions(bent, (15, 21))
    assert found is not None
    # The same formula as that of Brown and Conrady, in the other direction.
    forth = Pinhole(1.0, 1.0, 0.0, 0.0, -0.2, 0.05, 0.003, -0.002, 0.01)
    x, y = found[3, 4, :2] / found[3, 4, 2]
    there = Pinhole(1e9, 1e9, -1e9 * x, -1e9 * y, *astuple(forth)[4:]).directions((1, 1))[0, 0]
    np.testing.assert_allclose(there[:2] / there[2], [(4 - 9.3) / 30, (3 - 7.7) / 25], rtol=1e-9)
    assert bouguet_directions([0.0] * 32, (2, 3)) is None


@pytest.mark.parametrize("cut", [1, 7, 1000, 10**6])
def test_messages_come_whole_however_the_stream_is_cut(cut: int) -> None:
    sent = [Message(b"0000", b"star" + bytes(n) + b"stop") for n in (0, 100, 5000)]
    sent.insert(1, Message(b"1000", b"*"))
    stream = b"".join(write_message(*one) for one in sent)
    parser = PcicParser()
    got = [one for at in range(0, len(stream), cut) for one in parser.feed(stream[at : at + cut])]
    assert got == sent
    assert parser.skipped_bytes == 0


def test_a_message_is_written_as_the_manual_says() -> None:
    assert write_message(b"1000", b"p1") == b"1000L000000008\r\n1000p1\r\n"


@given(
    garbage=st.lists(st.binary(max_size=60), min_size=4, max_size=4),
    cut=st.integers(1, 50),
)
def test_the_parser_finds_the_next_message_after_garbage(garbage: list[bytes], cut: int) -> None:
    clean = [one.replace(b"L", b"l") for one in garbage]  # nothing that looks like a message
    sent = [Message(b"0000", bytes([n]) * 50) for n in range(4)]
    parts = zip(clean, sent, strict=True)
    stream = b"".join(before + write_message(*one) for before, one in parts)
    parser = PcicParser()
    got = [one for at in range(0, len(stream), cut) for one in parser.feed(stream[at : at + cut])]
    assert got == sent
    assert parser.skipped_bytes == sum(map(len, clean))


@pytest.mark.parametrize(
    "damaged",
    [
        b"0000L999999999\r\n0000star",
        b"0000L000000003\r\n0000",
        b"0000L000000020\r\n0001aaaaaaaaaaaaaa\r\n",
        b"0000L000000020\r\n0000aaaaaaaaaaaaaa__",
        b"0000L00000020\r\n",
    ],
    ids=["too long", "too short", "other ticket", "no end", "digits"],
)
def test_a_damaged_message_is_skipped(damaged: bytes) -> None:
    parser = PcicParser()
    good = Message(b"0000", b"starstop")
    assert parser.feed(damaged + write_message(*good)) == [good]
    assert parser.skipped_bytes == len(damaged)
    assert parser.oversize == (b"L999999999" in damaged)


def test_memory_is_bounded() -> None:
    parser = PcicParser(max_bytes=10_000)
    block = bytes(1000)
    for _ in range(100):
        assert parser.feed(block) == []
    assert len(parser._buffer) < 20
    parser.feed(b"0000L000010000\r\n0000")
    for _ in range(100):
        parser.feed(block)
        assert len(parser._buffer) < 12_000


def test_the_beginning_of_a_result_is_seen() -> None:
    parser = PcicParser()
    message = write_message(b"0000", result_content(seen(), count=77))
    assert parser.begun() == b""
    parser.feed(message[:70])
    (count,) = struct.unpack_from("<I", parser.begun(), 4 + 32)
    assert count == 77
    parser.feed(message[70:])
    assert parser.begun() == b""
    parser.feed(write_message(b"1000", b"x" * 90)[:80])
    assert parser.begun() == b""  # an answer is no result


@pytest.mark.parametrize(
    ("pixel", "dtype", "depth"),
    [
        (0, "u1", 1),
        (1, "i1", 1),
        (2, "<u2", 1),
        (3, "<i2", 1),
        (4, "<u4", 1),
        (5, "<i4", 1),
        (6, "<f4", 1),
        (7, "<u8", 1),
        (8, "<f8", 1),
        (10, "<f4", 3),
    ],
)
def test_all_formats_of_pixels(pixel: int, dtype: str, depth: int) -> None:
    values = np.arange(6 * depth).astype(dtype)
    (one,) = read_chunks(b"star" + chunk(203, pixel, values.tobytes()) + b"stop")
    shape = (2, 3, 3) if depth == 3 else (2, 3)
    np.testing.assert_array_equal(one.image(), values.reshape(shape))
    assert one.image().dtype == np.dtype(dtype)


def test_an_o3d_counts_millimetres() -> None:
    frame = seen()
    image = read_result(result_content(frame, model="O3D", count=5, time_s=2.5))
    np.testing.assert_array_equal(image.valid, frame.valid)
    assert image.distance_m is not None
    assert frame.distance_m is not None
    error_m = np.abs(image.distance_m - frame.distance_m)[frame.valid]
    assert 1e-5 < error_m.max() <= 0.5001e-3
    assert (image.frame_count, image.time_us, image.time_s) == (5, 2_500_000, None)


def test_an_o3r_tells_its_resolutions() -> None:
    frame = seen()
    image = read_result(result_content(frame, model="O3R", time_s=2.5))
    assert image.info is not None
    good = frame.valid
    np.testing.assert_allclose(image.amplitude[good], frame.amplitude[good], atol=0.51e-4)
    assert image.distance_m is not None
    assert frame.distance_m is not None
    np.testing.assert_allclose(image.distance_m[good], frame.distance_m[good], atol=0.77e-4)
    assert image.time_s == pytest.approx(2.5)


def test_metadata_behind_the_header() -> None:
    text = json.dumps({"DistanceResolution": 0.5}).encode() + b"\0"
    data = struct.pack("<6H", *range(6))
    size = 48 + len(text)
    head = struct.pack("<9I", 100, size + 12, size, 3, 3, 2, 2, 0, 0) + struct.pack("<3I", 0, 1, 5)
    amplitude = chunk(101, 2, data)
    image = read_result(b"star" + head + text + data + amplitude + b"stop")
    assert image.distance_m is not None
    assert image.distance_m.tolist() == [[0.0, 0.5, 1.0], [1.5, 2.0, 2.5]]
    assert image.time_s == pytest.approx(1 + 5e-9)
    assert image.valid.tolist() == [[False, True, True], [True, True, True]]


def test_normalised_amplitude_goes_before_raw_amplitude() -> None:
    raw = chunk(103, 6, struct.pack("<6f", *range(6)))
    normalised = chunk(101, 6, struct.pack("<6f", *range(10, 16)))
    assert read_result(b"star" + raw + b"stop").amplitude[0, 0] == 0
    assert read_result(b"star" + raw + normalised + b"stop").amplitude[0, 0] == 10


@pytest.mark.parametrize(
    ("content", "told"),
    [
        (b"", "star"),
        (b"starsto", "star"),
        (b"star" + bytes(10) + b"stop", "36"),
        (b"star" + struct.pack("<9I", 100, 0, 36, 1, 1, 1, 0, 0, 0) + b"stop", "got 0"),
        (
            b"star" + struct.pack("<9I", 100, 2**32 - 1, 36, 1, 1, 1, 0, 0, 0) + b"stop",
            "4294967295",
        ),
        (b"star" + struct.pack("<9I", 100, 36, 40, 1, 1, 1, 0, 0, 0) + b"stop", "header"),
        (b"starstop", "no amplitude"),
        (b"star" + chunk(101, 2, bytes(11)) + b"stop", "3 x 2"),
        (b"star" + chunk(101, 99, bytes(12)) + b"stop", "pixel format"),
        (b"star" + chunk(101, 0, bytes(6), (0, 3)) + b"stop", "3 x 0"),
        (b"star" + chunk(101, 0, bytes(6)) + chunk(100, 0, bytes(6), (3, 2)) + b"stop", "differ"),
        (b"star" + chunk(101, 0, bytes(6)) + chunk(420, 0, bytes(100)) + b"stop", "TOF_INFO"),
    ],
)
def test_damaged_results_are_refused(content: bytes, told: str) -> None:
    with pytest.raises(DataError, match=told):
        read_result(content)


def test_kinds_have_the_numbers_of_the_manual() -> None:
    assert ChunkKind(420).name == "TOF_INFO"
    assert ChunkKind(300).name == "CONFIDENCE"


@pytest.mark.parametrize("huge", [3e38, 1e30, 1e10])
def test_intrinsic_numbers_of_no_lens_lead_nowhere(huge: float) -> None:
    numbers = [100.0, 100.0, 8.0, 6.0, 0.0, 0.0, 0.0, 0.0, 0.0, huge]
    assert bouguet_directions(numbers, (13, 17)) is None
