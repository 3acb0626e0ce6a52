"""Damage files of every kind and read them: `python fuzz_files.py FOLDER COUNT SEED`.

A process of its own, because a library in C may end the whole process.
"""

import gzip
import json
import resource
import signal
import struct
import sys
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
import tifffile
from astropy.io import fits
from PIL import Image

from lensshift import Burst, load_burst, load_reconstruction, save_burst, save_reconstruction
from lensshift.capture.opening import EXAMPLE, open_rig
from lensshift.core.calibration import Calibration
from lensshift.core.errors import DataError, DeviceError
from lensshift.core.grid import Grid
from lensshift.core.motion import StageMap
from lensshift.io import (
    export_burst,
    load_image_stack,
    load_lens_field,
    load_offsets,
    save_lens_field,
)
from lensshift.io.calibration_file import load_calibration, save_calibration
from lensshift.io.capture_file import CaptureWriter, FrameRecord
from lensshift.io.recordings import read_udp
from lensshift.optics.field import lens_field
from lensshift.optics.lens_file import load_lens
from lensshift.optics.zmx import load_zmx
from lensshift.pipeline.experiment_file import default_text, load_experiment
from lensshift.reconstruction.reconstruct import reconstruct
from lensshift.scene.scene_file import load_scene

SHAPE = (3, 5, 7)
LIMIT_S = 20.0  # a hang; the machine may be busy
LIMIT_BYTES = 2 * (1 << 28)  # twice what a small file may take
SKY = fits.Header({
    "CTYPE1": "RA---TAN-SIP", "CTYPE2": "DEC--TAN-SIP", "CRPIX1": 3.5, "CRPIX2": 2.0,
    "CRVAL1": 83.8, "CRVAL2": -5.4, "CD1_1": -1e-3, "CD1_2": 2e-4, "CD2_1": 2e-4, "CD2_2": 1e-3,
    "A_ORDER": 2, "A_2_0": 1e-3, "B_ORDER": 2, "B_1_1": -2e-3,
})  # fmt: skip
Reader = Callable[[Path], object]


def burst() -> Burst:
    rng = np.random.default_rng(0)
    return Burst.from_arrays(
        rng.integers(0, 4000, SHAPE).astype("u2"),
        rng.normal(3.5, 0.01, SHAPE).astype("f4"),
        valid=rng.random(SHAPE) > 0.1,
        offset_px=rng.normal(size=(3, 2)),
        pitch_mm=(0.15, 0.1),
        modulation_hz=20e6,
        meta={"camera": "none"},
    )


def written(folder: Path) -> dict[str, tuple[Path, Reader]]:
    """Write one good file of each kind; return it with its reader."""
    one, rng = burst(), np.random.default_rng(1)
    at = {name: folder / f"good-{name}" for name in KINDS}
    save_burst(one, at["burst.nc"])
    save_reconstruction(reconstruct(one, scale=2, method="bicubic"), at["result.nc"])
    with CaptureWriter.create(at["journal.nc"], {"pitch_mm": [0.1, 0.1]}) as file:
        frame = rng.random(SHAPE[1:])
        for step in range(3):
            file.append(
                FrameRecord(
                    step=step, amplitude=frame, valid=frame > 0.1, offset_px=np.zeros(2),
                    time_s=0.1 * step, raw={"cycle": np.asarray(step)},
                )
            )  # fmt: skip
    save_calibration(Calibration(StageMap(np.eye(2) * 5.6), np.full(2, 3.0)), at["map.json"])
    save_lens_field(
        lens_field(load_lens("petzval_b"), Grid((5, 7), (0.155, 0.155)), 1), at["field.nc"]
    )
    np.savez(at["stack.npz"], amplitude=one.amplitude, offset_px=one.offset_px, meta='{"a": 1}')
    np.savez_compressed(at["packed.npz"], amplitude=one.amplitude, offset_px=one.offset_px)
    np.save(at["stack.npy"], one.amplitude)
    tifffile.imwrite(at["stack.tif"], one.amplitude, photometric="minisblack")
    tifffile.imwrite(at["zip.tif"], one.amplitude, photometric="minisblack", compression="zlib")
    Image.fromarray(one.amplitude[0]).save(at["lzw.tif"], compression="tiff_lzw")
    Image.fromarray(one.amplitude[0]).save(at["image.png"])
    for name in ("photo.jpg", "image.bmp"):
        Image.fromarray(one.amplitude[0].astype("u1")).save(at[name])
    fits.PrimaryHDU(one.amplitude, SKY).writeto(at["sky.fits"], overwrite=True)
    at["table.csv"].write_text("frame,row,col\n0,0.25,0\n1,0,0.5\n2,0.25,0.5\n")
    at["table.json"].write_text(json.dumps({"offset_px": one.offset_px.tolist()}))
    at["rig.toml"].write_text(EXAMPLE)
    at["run.toml"].write_text(default_text())
    at["lens.toml"].write_text(_package("optics", "*.toml"))
    at["scene.toml"].write_text(_package("scene", "*.toml"))
    at["lens.zmx"].write_text(ZMX)
    at["packets.pcap"].write_bytes(_pcap())
    at["packets.pcap.gz"].write_bytes(gzip.compress(_pcap()))
    at["packets.pcapng"].write_bytes(_pcapng())
    return {name: (at[name], read) for name, read in KINDS.items()}


def _package(name: str, pattern: str) -> str:
    import lensshift

    return min((Path(lensshift.__file__).parent / name).rglob(pattern)).read_text()


def _pcap() -> bytes:
    out = struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, 101)
    for number in range(3):
        out += struct.pack("<IIII", number, 0, 78, 78) + _ip(bytes(50))
    return out


def _pcapng() -> bytes:
    out = _block(0x0A0D0D0A, struct.pack("<IHHq", 0x1A2B3C4D, 1, 0, -1))
    out += _block(1, struct.pack("<HHI", 101, 0, 0))
    for number in range(3):
        out += _block(6, struct.pack("<IIIII", 0, 0, number, 78, 78) + _ip(bytes(50)) + b"\0\0")
    return out


def _block(kind: int, body: bytes) -> bytes:
    return struct.pack("<II", kind, len(body) + 12) + body + struct.pack("<I", len(body) + 12)


def _ip(payload: bytes) -> bytes:
    head = struct.pack(">BBHHHBBH", 0x45, 0, 28 + len(payload), 1, 0, 64, 17, 0)
    ends = bytes([192, 168, 1, 69, 192, 168, 1, 255])
    return head + ends + struct.pack(">HHHH", 1, 42000, 8 + len(payload), 0) + payload


ZMX = """VERS 1
MODE SEQ
UNIT MM X W X CM MR CPMM
ENPD 10
WAVM 1 0.85 1
SURF 0
  DISZ INFINITY
SURF 1
  STOP
  CURV 0.02
  DISZ 3
  GLAS N-BK7 0 0 1.5168 64.17
SURF 2
  CURV -0.02
  DISZ 45
SURF 3
  DISZ 0
"""


class ChangedError(Exception):
    """Damage has become numbers."""


def _burst(path: Path) -> object:
    found, true = load_burst(path), burst()
    for name in ("amplitude", "distance_m", "offset_px", "valid"):
        if not np.array_equal(getattr(found, name), getattr(true, name)):
            raise ChangedError(name)
    return found


def _stack(path: Path) -> Burst:
    return load_image_stack(path, offsets=[[0.0, 0.0]] * 3, pitch_mm=0.1)


def _sky(path: Path) -> object:
    export_burst(_stack(path), path.with_name("again.fits"))
    return None


def _image(path: Path) -> object:
    return load_image_stack(path, offsets=[[0.0, 0.0]], pitch_mm=0.1)


class NothingError(Exception):
    """Reading got as far as the devices, which are not there."""


def _rig(path: Path) -> object:
    from lensshift.capture.drivers.o3m import O3MCamera

    def absent(_: object) -> None:
        raise NothingError

    O3MCamera.open = absent  # type: ignore[method-assign]
    try:
        return open_rig(path)
    except NothingError:
        return None


KINDS: dict[str, Reader] = {
    "burst.nc": _burst,
    "result.nc": load_reconstruction,
    "journal.nc": load_burst,
    "field.nc": load_lens_field,
    "map.json": load_calibration,
    "stack.npz": load_image_stack,
    "packed.npz": load_image_stack,
    "stack.npy": _stack,
    "stack.tif": _stack,
    "zip.tif": _stack,
    "lzw.tif": _image,
    "image.png": _image,
    "photo.jpg": _image,
    "image.bmp": _image,
    "sky.fits": _sky,
    "table.csv": load_offsets,
    "table.json": load_offsets,
    "rig.toml": _rig,
    "run.toml": load_experiment,
    "lens.toml": load_lens,
    "scene.toml": load_scene,
    "lens.zmx": load_zmx,
    "packets.pcap": lambda path: list(read_udp(path)),
    "packets.pcap.gz": lambda path: list(read_udp(path)),
    "packets.pcapng": lambda path: list(read_udp(path)),
}
TOKENS = (
    b"nan", b"inf", b"-1", b"1e999", b"9" * 5000, b"[" * 3000, b'"\x1b]0;x\x07"', b"{}", b"null",
    b"true", b"\xff\xfe", b"\0", b"", b"0", b"'", b'"', b"../../etc/passwd",
)  # fmt: skip


def damaged(data: bytes, rng: np.random.Generator) -> bytes:
    """Damage a file as disks, networks and people do."""
    out = bytearray(data)
    kind, at = rng.integers(7), int(rng.integers(len(data)))
    if kind == 0:
        out[at] ^= 1 << int(rng.integers(8))
    elif kind == 1:
        for place in rng.integers(len(out), size=8):
            out[place] = rng.integers(256)
    elif kind == 2:
        del out[at:]
    elif kind == 3:
        size = int(rng.choice([1, 8, 64, 512]))
        out[at : at + size] = bytes(len(out[at : at + size]))
    elif kind == 4:
        out[at:at] = rng.bytes(int(rng.choice([1, 4, 100])))
    elif kind == 5:  # an extreme number
        size = int(rng.choice([2, 4, 8]))
        out[at : at + size] = int(rng.choice([-1, 1, 2**15, 2**31 - 1])).to_bytes(
            8, "little", signed=True
        )[:size]
    else:  # another word in its place
        words = [n for n, byte in enumerate(data) if byte in b' =,:[]"\n']
        start = words[int(rng.integers(len(words)))] + 1 if words else at
        end = next((n for n in words if n > start), start + 1)
        out[start:end] = TOKENS[int(rng.integers(len(TOKENS)))]
    return bytes(out)


class Hang(BaseException):
    pass


def _alarm(*_: object) -> None:
    raise Hang


def used_bytes() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def read(path: Path, reader: Reader) -> str:
    """Read; return "read" or "refused", or say what must not happen."""
    before, began_s = used_bytes(), time.monotonic()
    signal.setitimer(signal.ITIMER_REAL, LIMIT_S)
    try:
        reader(path)
        outcome = "read"
    except (DataError, DeviceError) as error:
        message = str(error)
        named = isinstance(error, DeviceError) or path.name in message
        fine = named and message.isprintable()
        outcome = "refused" if fine else f"bad message {message!r:.300}"
    except Hang:
        outcome = f"hang of {time.monotonic() - began_s:.0f} s"
    except Exception as error:  # noqa: BLE001 - the one that is looked for
        outcome = f"{type(error).__name__}: {error!s:.300}"
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
    grown = used_bytes() - before
    return outcome if grown < LIMIT_BYTES else f"{outcome}, and {grown} bytes of memory"


def fuzz(
    folder: Path, count: int, seed: int, names: Iterable[str] = KINDS
) -> dict[str, Counter[str]]:
    """Read damaged files, as many of each kind; keep those that do what must not happen."""
    rng = np.random.default_rng(seed)
    outcomes: dict[str, Counter[str]] = {}
    for name, (good, reader) in written(folder).items():
        if name not in names:
            continue
        told = read(good, reader)
        if told != "read":
            raise AssertionError(f"{name}: {told}")
        data, suffix = good.read_bytes(), Path(name).suffix
        outcomes[name] = Counter()
        for number in range(count // len(KINDS) + 1):
            path = folder / f"damaged{suffix}"
            path.write_bytes(damaged(data, rng))
            told = read(path, reader)
            outcomes[name][told] += 1
            if told not in ("read", "refused"):
                path.rename(folder / f"found-{number}-{name}")
    return outcomes


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    signal.signal(signal.SIGALRM, _alarm)
    found = fuzz(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]), sys.argv[4:] or KINDS)
    sys.stdout.write(json.dumps(found))
