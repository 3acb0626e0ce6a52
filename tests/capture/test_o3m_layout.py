"""Pixel data and diagnosis of an O3M, against bytes put together from the table of the format."""

import struct

import numpy as np
import pytest

from lensshift.capture.drivers.o3m_layout import layout_of, read_diagnosis, read_image
from lensshift.capture.emulators.o3m import LAYOUTS, diagnosis_message, pixel_message
from lensshift.core.errors import DataError
from lensshift.core.types import Frame

# Offsets of the fields from version 1.1 on; version 1.0 lacks the twelve bytes of magic.
DISTANCE, X, CONFIDENCE, AMPLITUDE = 16, 2064, 14352, 16400
NORMALIZATION, TIMESTAMP, CALIBRATION, FIELD_OF_VIEW = 18448, 18464, 18476, 18500


def seen(seed: int = 0) -> Frame:
    rng = np.random.default_rng(seed)
    amplitude = 10.0 ** rng.uniform(-3, 0.5, (16, 64))
    return Frame(amplitude, rng.uniform(0.5, 40.0, (16, 64)), rng.random((16, 64)) > 0.1, 0.0)


def edited(message: bytes, offset: int, values: bytes) -> bytes:
    return message[:offset] + values + message[offset + len(values) :]


@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_frame_comes_back_from_every_layout(layout: str) -> None:
    frame = seen()
    message = pixel_message(frame, layout=layout, timestamp_us=123456)
    assert len(message) == LAYOUTS[layout]
    image = read_image(message)
    assert image.layout.endswith(layout)
    np.testing.assert_array_equal(image.valid, frame.valid)
    good = frame.valid
    factors = image.raw["normalization"].astype(float)
    used = factors[(image.raw["confidence"][good] >> 1) & 3]
    assert np.all(np.abs(image.amplitude - frame.amplitude)[good] <= 0.5001 * used)
    np.testing.assert_allclose(image.distance_m[good], frame.distance_m[good], atol=1e-5)
    assert image.timestamp_us == 123456
    assert image.coarse_pixels == 0
    assert len(np.unique(used)) == 4  # the test saw all settings


def test_coordinates_tell_where_the_pixels_look_even_the_invalid_ones() -> None:
    image = read_image(pixel_message(seen()))
    assert image.direction is not None
    length = np.linalg.norm(image.direction, axis=-1)
    np.testing.assert_allclose(length[image.valid], image.distance_m[image.valid], atol=1e-5)
    x, y, z = np.moveaxis(image.direction, -1, 0)
    assert z.min() > 0
    # Sent forward, left and up, with the first row on top.
    assert np.all(np.diff(x / z, axis=1) > 0)
    assert np.all(np.diff(y / z, axis=0) > 0)
    nowhere = edited(pixel_message(seen()), X, struct.pack("<f", np.nan))
    assert read_image(nowhere).direction is None


def test_fields_lie_where_the_table_puts_them() -> None:
    row, col = 3, 17
    pixel = 64 * row + col
    message = bytearray(19224)
    message[:12] = b"O3M!DIA1\x01\x04\0\0"
    struct.pack_into("<HH", message, 12, 64, 16)
    struct.pack_into("<H", message, DISTANCE + 2 * pixel, 500)
    for axis, value in enumerate((4.004 + 1.0, 2.0, 3.0)):
        struct.pack_into("<f", message, X + 4096 * axis + 4 * pixel, value)
    struct.pack_into("<H", message, CONFIDENCE + 2 * pixel, 4)
    struct.pack_into("<H", message, AMPLITUDE + 2 * pixel, 1000)
    struct.pack_into("<4f", message, NORMALIZATION, 1.0, 0.5, 0.25, 0.125)
    struct.pack_into("<III", message, TIMESTAMP, 11, 12, 13)
    struct.pack_into("<6f", message, CALIBRATION, 1.0, 2.0, 0.0, 4.0, 5.0, 6.0)
    struct.pack_into("<12f", message, FIELD_OF_VIEW, *range(12))
    image = read_image(bytes(message))
    assert image.amplitude[row, col] == 250.0  # high gain only: the third factor
    assert image.distance_m[row, col] == pytest.approx(np.hypot(4.004, 3.0), abs=1e-6)
    assert np.count_nonzero(image.amplitude) == 1
    assert image.raw["timestamp_us"] == 11
    assert image.raw["frame_counter"] == 12
    assert image.raw["available"] == 13
    assert image.raw["calibration"].tolist() == [1, 2, 0, 4, 5, 6]
    assert image.raw["field_of_view"].tolist() == np.arange(12.0).reshape(4, 3).tolist()


@pytest.mark.parametrize(
    ("centimetres", "x_m", "expected_m", "coarse"),
    [
        (300, 3.004, 3.004, 0),
        (300, 2.9951, 2.9951, 0),
        (300, 3.2, 3.0, 1),
        (300, 0.0, 3.0, 1),
        (300, np.nan, 3.0, 1),
        (300, np.inf, 3.0, 1),
    ],
)
def test_centimetres_count_where_the_coordinates_contradict(
    centimetres: int, x_m: float, expected_m: float, coarse: int
) -> None:
    frame = Frame(np.ones((16, 64)), np.full((16, 64), 3.0), np.ones((16, 64), bool), 0.0)
    message = pixel_message(frame)
    message = edited(message, CALIBRATION, struct.pack("<3f", 0, 0, 0))
    for axis, value in enumerate((x_m, 0.0, 0.0)):
        message = edited(message, X + 4096 * axis, np.full(1024, value, "<f4").tobytes())
    message = edited(message, DISTANCE, np.full(1024, centimetres, "<u2").tobytes())
    image = read_image(message)
    np.testing.assert_allclose(image.distance_m, expected_m, atol=1e-6)
    assert image.coarse_pixels == coarse * 1024


@pytest.mark.parametrize(
    ("confidence", "valid"), [(0, True), (1, False), (4096, False), (6, True), (32, True)]
)
def test_the_confidence_says_what_is_valid(confidence: int, valid: bool) -> None:
    message = edited(pixel_message(seen()), CONFIDENCE, struct.pack("<H", confidence))
    assert read_image(message).valid[0, 0] == valid


def test_an_amplitude_that_is_not_finite_is_invalid() -> None:
    frame = seen()
    message = edited(pixel_message(frame), NORMALIZATION, struct.pack("<4f", *[np.nan] * 4))
    assert not read_image(message).valid.any()


def test_the_format_of_the_other_firmware_is_read_if_its_size_fits() -> None:
    message = pixel_message(seen()).replace(b"DIA1", b"ODA1", 1).ljust(20952, b"\0")
    assert layout_of(message) == ("ODA1 1.4", 12)
    with pytest.raises(DataError, match="ODA1"):
        read_image(message[:18000])


@pytest.mark.parametrize(
    "message",
    [
        b"",
        b"O3M!",
        b"O3M!DIA1",
        bytes(18901),
        pixel_message(seen())[:-1],
        pixel_message(seen(), layout="1.1") + bytes(8),
        edited(pixel_message(seen()), 9, b"\x05"),
        edited(pixel_message(seen()), 4, b"XYZ1"),
        edited(pixel_message(seen()), 12, struct.pack("<HH", 16, 64)),
    ],
    ids=["empty", "magic", "name", "size", "short", "longer", "version", "firmware", "turned"],
)
def test_other_messages_are_refused(message: bytes) -> None:
    with pytest.raises(DataError, match="expected"):
        read_image(message)


def test_the_diagnosis_is_big_endian() -> None:
    message = bytearray(468)
    message[12:16] = bytes.fromhex("42280000")  # 42.0
    message[148:152] = bytes.fromhex("c1200000")  # -10.0
    message[152] = 0x22
    diagnosis = read_diagnosis(bytes(message))
    assert (diagnosis.main_celsius, diagnosis.light_celsius) == (42.0, -10.0)
    assert diagnosis.mode_name == "run"
    assert read_diagnosis(diagnosis_message(0x31)).mode_name == "emergency"
    assert "0x07" in read_diagnosis(diagnosis_message(7)).mode_name
    with pytest.raises(DataError, match="153"):
        read_diagnosis(bytes(152))


def test_the_emulator_takes_frames_of_the_sensor_only() -> None:
    frame = Frame(np.ones((64, 16)), None, np.ones((64, 16), bool), 0.0)
    with pytest.raises(ValueError, match="16, 64"):
        pixel_message(frame)
