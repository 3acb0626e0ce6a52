"""Recordings of what a camera sent: UDP from pcap and pcapng files, images from ROS bags."""

from __future__ import annotations

import gzip
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from lensshift.core.errors import DataError, of_extra, warn_quality
from lensshift.io.reading import reading, require_file
from lensshift.io.recordings_pcap import Datagram, UdpReader, is_capture, read_packets

_ENCODINGS = {"32FC1": "f4", "16UC1": "u2", "mono16": "u2", "mono8": "u1"}


def read_udp(path: str | Path) -> Iterator[Datagram]:
    """Read the UDP datagrams of a pcap or pcapng file, as Wireshark and tcpdump write them.

    Yields (time in s, (source address, source port), destination port, payload). Both byte orders,
    micro- and nanoseconds, Ethernet with VLAN tags, Linux cooked, raw IP and loopback; IPv4 with
    fragments put together. The file is read as it goes, so it may be long; it may be compressed by
    gzip. DataError if the file is missing, no such file, or damaged. A file cut off at its end and
    datagrams that were recorded in part give a `QualityWarning`.

    Source: IETF drafts draft-ietf-opsawg-pcap and draft-ietf-opsawg-pcapng.
    """
    require_file(path)
    udp = UdpReader()
    with reading(path), _opened(path) as file:
        for packet in read_packets(file, str(path)):
            datagram = udp.read(packet)
            if datagram is not None:
                yield datagram
    if udp.cut or udp.incomplete:
        warn_quality(
            f"{path}: {udp.cut} datagrams were recorded in part and {udp.incomplete} lack a "
            "fragment; they are left out"
        )


def is_udp_recording(path: str | Path) -> bool:
    """Tell whether this is a pcap or pcapng file, by its first bytes."""
    if not Path(path).is_file():
        return False
    with reading(path), _opened(path) as file:
        return is_capture(file.read(4))


def _opened(path: str | Path) -> BinaryIO:
    """Open a recording, or what is in it if it is compressed by gzip, as archives are."""
    with Path(path).open("rb") as file:
        packed = file.read(2) == b"\x1f\x8b"
    return cast(BinaryIO, gzip.open(path) if packed else Path(path).open("rb"))


class BagImage(NamedTuple):
    """One image of a bag."""

    time_s: float  # stamp of the image, or of the recording if the image has none
    topic: str  # where it was published
    image: NDArray[Any]  # [row col] in the units of the topic


def read_bag(path: str | Path, topics: Collection[str] = ()) -> Iterator[BagImage]:
    """Read images of a ROS 1 bag, a ROS 2 bag (a folder) or an MCAP file, of all topics or some.

    Images are `sensor_msgs/Image` of encoding 32FC1, 16UC1, mono16 or mono8; others are skipped.
    ImportError if the extra `recordings` is not installed. DataError if the bag cannot be read.
    """
    needed = "reading bags needs rosbags: pip install 'lensshift[recordings]'"
    highlevel = of_extra("rosbags.highlevel", needed)
    from rosbags.typesys import Stores, get_typestore

    if not Path(path).is_dir():
        require_file(path)
    known = get_typestore(Stores.ROS2_HUMBLE)
    try:
        with reading(path), highlevel.AnyReader([Path(path)], default_typestore=known) as bag:
            kinds = [one for one in bag.connections if one.msgtype == "sensor_msgs/msg/Image"]
            wanted = [one for one in kinds if not topics or one.topic in topics]
            for connection, stamp_ns, data in bag.messages(wanted) if wanted else ():
                message = bag.deserialize(data, connection.msgtype)
                image, stamp = _image(message), message.header.stamp
                time_s = float(stamp.sec + stamp.nanosec * 1e-9) or stamp_ns * 1e-9
                if image is not None:
                    yield BagImage(time_s, connection.topic, image)
    except highlevel.AnyReaderError as error:
        raise DataError(f"cannot read this bag: {error}", source=path) from error


def _image(message: Any) -> NDArray[Any] | None:
    """Return the pixels of a message, None if they are of another kind."""
    name = _ENCODINGS.get(message.encoding)
    if name is None:
        return None
    pixel = np.dtype(name).newbyteorder(">" if message.is_bigendian else "<")
    rows, cols, step = int(message.height), int(message.width), int(message.step)
    data = np.asarray(message.data, dtype=np.uint8)
    if rows < 1 or cols < 1 or step < cols * pixel.itemsize or data.size < rows * step:
        raise DataError(f"{data.size} bytes do not hold {rows} rows of {step}", field="image")
    lines = data[: rows * step].reshape(rows, step)[:, : cols * pixel.itemsize]
    image = np.ascontiguousarray(lines).view(pixel)
    return image.astype(pixel.newbyteorder("="))
