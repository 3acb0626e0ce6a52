"""Coverage-guided fuzzing of the protocol parsers, where atheris is installed.

    python tests/capture/coverage_guided.py o3m|image|diagnosis|pcic|apt FOLDER -runs=100000

FOLDER takes the inputs that reach new code; a crash, a hang or too much memory ends with an error
and the input. Everything behind FOLDER goes to libFuzzer.
"""

import struct
import sys
from collections.abc import Callable
from pathlib import Path

import atheris

with atheris.instrument_imports(include=["lensshift.capture"]):
    from lensshift.capture.drivers import apt_codec
    from lensshift.capture.drivers.apt_codec import Framer
    from lensshift.capture.drivers.o3m_layout import read_diagnosis, read_image
    from lensshift.capture.drivers.o3m_stream import O3MStream
    from lensshift.capture.drivers.pcic_protocol import PcicParser, read_result, write_message
from lensshift.capture.emulators.o3m import diagnosis_message, packetise, pixel_message
from lensshift.capture.emulators.pcic import result_content
from lensshift.core.errors import DataError, DeviceError

from test_fuzz_parsers import seen  # isort: skip  (a file beside this one)


def parts(data: bytes) -> list[bytes]:
    """Cut bytes into pieces, each behind its length."""
    found = []
    while len(data) >= 2:
        size = struct.unpack_from("<H", data)[0]
        found.append(data[2 : 2 + size])
        data = data[2 + size :]
    return found


def joined(pieces: list[bytes]) -> bytes:
    return b"".join(struct.pack("<H", len(piece)) + piece for piece in pieces)


def o3m(data: bytes) -> None:
    stream = O3MStream()
    for number, datagram in enumerate(parts(data)):
        try:
            stream.push(datagram, ("10.0.0.1", 1), number * 1e-3)
        except DeviceError:
            continue


def pcic(data: bytes) -> None:
    parser = PcicParser(max_bytes=20_000)
    for piece in parts(data):
        for message in parser.feed(piece):
            try:
                read_result(message.content)
            except DataError:
                continue


def apt(data: bytes) -> None:
    framer = Framer(apt_codec.TO_HOST)
    for number, piece in enumerate(parts(data)):
        framer.feed(piece, number * 1e-3)


def reading(read: Callable[[bytes], object]) -> Callable[[bytes], None]:
    def one(data: bytes) -> None:
        try:
            read(data)
        except DataError:
            return

    return one


def seeds(name: str) -> list[bytes]:
    """Return what a healthy device sends, to begin with."""
    frame = seen((16, 64))
    layouts = [pixel_message(frame, layout=layout) for layout in ("1.0", "1.4")]
    if name == "o3m":
        return [joined(list(packetise({8: one, 14: bytes(200)}, 1, 0))) for one in layouts]
    if name == "image":
        return layouts
    if name == "diagnosis":
        return [diagnosis_message(0x22)]
    if name == "pcic":
        contents = [result_content(seen((3, 5)), model=model) for model in ("O3D", "O3R")]
        return [joined([write_message(b"0000", one)] * 2) for one in contents]
    message = apt_codec.Message(next(iter(apt_codec.TO_HOST)))
    raw = message.to_bytes(apt_codec.HOST, apt_codec.CONTROLLER)
    return [joined([raw, raw[:3], raw[3:] + b"\0" + raw])]


PARSERS: dict[str, Callable[[bytes], None]] = {
    "o3m": o3m,
    "image": reading(read_image),
    "diagnosis": reading(read_diagnosis),
    "pcic": pcic,
    "apt": apt,
}


def main() -> None:
    if len(sys.argv) < 3 or sys.argv[1] not in PARSERS:
        sys.exit(__doc__)
    name, folder = sys.argv[1], Path(sys.argv[2])
    folder.mkdir(parents=True, exist_ok=True)
    for number, data in enumerate(seeds(name)):
        (folder / f"seed{number}").write_bytes(data)
    arguments = [sys.argv[0], str(folder), "-max_len=20000", "-rss_limit_mb=1024", "-timeout=10"]
    atheris.Setup([*arguments, *sys.argv[3:]], PARSERS[name])
    atheris.Fuzz()


if __name__ == "__main__":
    main()
