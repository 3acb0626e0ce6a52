"""Messages of an ifm O3M: pixel data in all known layouts, diagnosis. No sockets.

Written from public descriptions of the format; no recording of a real camera was at hand.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lensshift.core.arrays import Floats, Mask
from lensshift.core.errors import DataError

# As ifm documents them; channel 20 has objects without pixels.
PIXEL_CHANNEL, PARAMETER_CHANNEL, DIAGNOSIS_CHANNEL = 8, 14, 256
CHANNELS = frozenset({PIXEL_CHANNEL, PARAMETER_CHANNEL, DIAGNOSIS_CHANNEL})

SHAPE = (16, 64)  # of the only sensor there is
_INVALID, _LOW_SIGNAL = 1, 4096  # bits of the confidence

MODES = {
    0x12: "initialising", 0x15: "booting", 0x21: "limited run", 0x22: "run", 0x31: "emergency",
}  # fmt: skip
RUN_MODE = 0x22  # the only one in which it measures

_MAGIC = b"O3M!"
_MAGIC_BYTES = 12  # magic, name, major, minor, two bytes of padding
_SIZES = {(1, 0): 18900, (1, 1): 19036, (1, 2): 19044, (1, 3): 19224, (1, 4): 19224}
_PIXELS = np.dtype([
    ("width", "<u2"), ("height", "<u2"), ("distance_cm", "<u2", SHAPE),
    ("x_m", "<f4", SHAPE), ("y_m", "<f4", SHAPE), ("z_m", "<f4", SHAPE),
    ("confidence", "<u2", SHAPE), ("amplitude", "<u2", SHAPE), ("normalization", "<f4", (4,)),
    ("timestamp_us", "<u4"), ("frame_counter", "<u4"), ("available", "<u4"),
    ("calibration", "<f4", (6,)), ("field_of_view", "<f4", (4, 3)),
])  # fmt: skip
_COARSE_M = 0.01  # step of `distance_cm`

_DIAGNOSIS = struct.Struct(">12x f 132x f B")  # temperatures of board and light, mode


@dataclass(frozen=True, slots=True, eq=False)
class O3MImage:
    """One cycle of the camera.

    raw : distance_cm, amplitude, confidence, x_m, y_m, z_m, normalization, timestamp_us,
        frame_counter, available, calibration (x, y, z in m, three angles in rad), field_of_view
    """

    layout: str  # "DIA1 1.4" and so on
    amplitude: Floats  # [16 64] what a pixel would have read without its exposure and gain
    distance_m: Floats  # [16 64] radial, from the optical centre
    valid: Mask  # [16 64] False where the camera calls the pixel invalid or too weak
    timestamp_us: int  # master clock of the camera, wraps at 2^32
    coarse_pixels: int  # whose distance is in whole centimetres: coordinates contradict it
    raw: Mapping[str, NDArray[np.generic]]

    @property
    def direction(self) -> Floats | None:
        """[16 64 3] where the pixels look (x right, y down, z forward, along the vehicle's axes).

            direction = (x, y, z) - (x, y, z) of the camera,    sent for invalid pixels as well

        None where a coordinate is not finite or at the camera.
        """
        ahead, left, up = _from_camera_m(self.raw)
        vectors = np.stack([-left, -up, ahead], axis=-1)
        whole = np.isfinite(vectors).all() and vectors.any(axis=-1).all()
        return vectors if whole else None


@dataclass(frozen=True, slots=True)
class O3MDiagnosis:
    """How the camera is: temperatures of itself and of its light, and what it does (`MODES`)."""

    main_celsius: float
    light_celsius: float
    mode: int

    @property
    def mode_name(self) -> str:
        """The mode in words."""
        return MODES.get(self.mode, f"unknown mode 0x{self.mode:02x}")


def layout_of(message: bytes) -> tuple[str, int]:
    """Return the layout of a message of channel 8, and where its pixels begin; or a DataError."""
    if not message.startswith(_MAGIC):
        if len(message) == _SIZES[1, 0]:
            return "DI 1.0", 0
        raise DataError(
            f"expected {_SIZES[1, 0]} bytes or the letters O3M! in front, got {len(message)} bytes",
            field="pixel data",
        )
    name = message[4:8].decode("ascii", "replace")
    version = (message[8], message[9]) if len(message) >= _MAGIC_BYTES else (0, 0)
    layout = f"{name} {version[0]}.{version[1]}"
    fits = len(message) == _SIZES.get(version) if name == "DIA1" else name == "ODA1"
    if not fits or len(message) < _MAGIC_BYTES + _PIXELS.itemsize:
        raise DataError(
            f"expected layout DIA1 1.0 to 1.4 or ODA1, got {layout!r} with {len(message)} bytes",
            field="pixel data",
        )
    return layout, _MAGIC_BYTES


def read_image(message: bytes) -> O3MImage:
    """Read a message of channel 8.

        amplitude = raw amplitude * normalization[(confidence >> 1) & 3]
        distance_m = |(x, y, z) - (x, y, z) of the camera|

    Exposure and gain are chosen per pixel, so raw amplitudes of neighbours cannot be compared. The
    coordinates are finer than the distance in whole centimetres; where the two differ by more than
    1 cm, or a coordinate is not finite, the centimetres count. DataError if this is no known layout
    or not of 64 x 16 pixels.
    """
    layout, start = layout_of(message)
    pixels = np.frombuffer(message, _PIXELS, count=1, offset=start)[0]
    if (pixels["height"], pixels["width"]) != SHAPE:
        raise DataError(
            f"expected 64 x 16 pixels, got {pixels['width']} x {pixels['height']}",
            field="pixel data",
        )
    confidence = pixels["confidence"]
    with np.errstate(invalid="ignore"):  # numbers that are not finite
        factor = pixels["normalization"].astype(np.float64)[(confidence >> 1) & 3]
        amplitude = pixels["amplitude"] * factor
        distance_m, coarse = _distance_m(pixels)
    return O3MImage(
        layout=layout,
        amplitude=amplitude,
        distance_m=distance_m,
        valid=((confidence & (_INVALID | _LOW_SIGNAL)) == 0) & np.isfinite(amplitude),
        timestamp_us=int(pixels["timestamp_us"]),
        coarse_pixels=coarse,
        raw={name: np.asarray(pixels[name]) for name in _PIXELS.fields or ()},
    )


def _from_camera_m(pixels: Any) -> Floats:
    """Return the coordinates (ahead, left, up) from the camera, [3 row col]."""
    places_m = np.array([pixels[axis] for axis in ("x_m", "y_m", "z_m")], dtype=np.float64)
    return np.asarray(places_m - pixels["calibration"][:3, None, None])


def _distance_m(pixels: np.void) -> tuple[Floats, int]:
    """Return radial distances and how many of them are in whole centimetres."""
    coarse_m = pixels["distance_cm"] * _COARSE_M
    fine_m = np.sqrt(np.sum(_from_camera_m(pixels) ** 2, axis=0))
    agree = np.abs(fine_m - coarse_m) <= _COARSE_M
    return np.where(agree, fine_m, coarse_m), int(np.count_nonzero(~agree))


def read_diagnosis(message: bytes) -> O3MDiagnosis:
    """Read a message of channel 256, big-endian unlike all others; DataError if it is too short."""
    if len(message) < _DIAGNOSIS.size:
        raise DataError(
            f"expected at least {_DIAGNOSIS.size} bytes, got {len(message)}", field="diagnosis"
        )
    return O3MDiagnosis(*_DIAGNOSIS.unpack_from(message))
