"""From datagrams on the port of an ifm O3M to frames, and why none came. No sockets."""

from __future__ import annotations

from collections import Counter
from dataclasses import asdict
from typing import Any

import numpy as np

from lensshift.capture.drivers import o3m_layout as o3m
from lensshift.capture.drivers.o3m_packets import QUIET_S, ChannelMessage, Reassembler, read_header
from lensshift.capture.drivers.receiver import counter_steps
from lensshift.capture.rig import CameraFrame
from lensshift.core.errors import DataError, DeviceError
from lensshift.core.types import Frame

Address = tuple[str, int]
_OF_PORT = ("packets", "foreign_packets", "other_cameras_packets", "other_cameras_images")
_OF_SENDERS = {  # name -> of `PacketCounts`
    "lost_packets": "lost", "duplicate_packets": "duplicate", "reordered_packets": "reordered",
    "partial_cycles": "partial", "wrong_size_or_version": "oversize", "restarts": "restarts",
}  # fmt: skip
_MAX_SENDERS = 64  # the one that has been silent for longest makes room for another
_MAX_NOTED = 16  # channels named in a message


# At one moment: datagrams, everything else, and the packets of each channel.
Snapshot = tuple[int, dict[str, int], dict[int, int]]


class O3MStream:
    """Takes datagrams, returns frames of one camera, at an address ("192.168.1.1:50000") or any.

    The camera is who sends pixels that can be read, whatever else comes to the port. Its other
    channels may come from other ports of its address. Others are counted and left aside; one takes
    its place only after it has fallen silent.
    """

    def __init__(self, source: str | None = None) -> None:
        self.source = source
        self._datagrams = 0
        self._counts: Counter[str] = Counter()  # by the names of `totals`
        self.diagnosis: o3m.O3MDiagnosis | None = None
        self.parameters = b""
        self.image: o3m.O3MImage | None = None
        self._senders: dict[Address, Reassembler] = {}
        self._heard_s: dict[Address, float] = {}
        self._chosen: Address | None = None
        self._seen_s = 0.0  # when its last image was whole
        self._informant = ""  # host that told diagnosis and parameters
        self._channels: dict[int, int] = {}  # packets of each channel
        self.other = ""  # address of another camera that sends images
        self._stranger = ""
        self._wrong = ""
        self._time_us = 0

    @property
    def address(self) -> str:
        """Address of the camera that the frames come from, empty before the first."""
        return "" if self._chosen is None else _named(self._chosen)

    @property
    def heard(self) -> bool:
        """Whether any datagram has come, of whomever."""
        return self._datagrams > 0

    def newest_cycle(self) -> int:
        """Return the unwrapped counter of the newest image that has begun to arrive, or -1."""
        sender = None if self._chosen is None else self._senders.get(self._chosen)
        return -1 if sender is None else sender.newest_cycle(o3m.PIXEL_CHANNEL)

    def push(
        self, datagram: bytes | bytearray | memoryview, address: Address, arrived_s: float
    ) -> CameraFrame | None:
        """Take a datagram in; return the frame that it completes, if it does.

        DeviceError if the camera has started anew, or another one has taken its place after a
        silence. Later datagrams may be pushed all the same.
        """
        self._datagrams += 1
        header = read_header(datagram)
        wanted = self.source is None or self.source in (address[0], _named(address))
        if header is not None and wanted and self._is_camera(address, header.channel):
            self._counts["packets"] += 1
            if header.channel in self._channels or len(self._channels) < _MAX_NOTED:
                self._channels[header.channel] = self._channels.get(header.channel, 0) + 1
        else:
            self._stranger = _named(address)
            self._counts["foreign_packets"] += header is None
            self._counts["other_cameras_packets"] += header is not None
        if header is None or not wanted:
            return None
        sender = self._sender(address, arrived_s)
        restarts = sender.restarts(o3m.PIXEL_CHANNEL)
        message = sender.push(header, datagram, arrived_s)
        if address == self._chosen and sender.restarts(o3m.PIXEL_CHANNEL) != restarts:
            raise DeviceError(
                "the camera has started anew: its cycle counter jumped back to "
                f"{header.cycle_counter}"
            )
        return None if message is None else self._take(message, address, arrived_s)

    def _is_camera(self, address: Address, channel: int) -> bool:
        """Tell whether a packet is the camera's; anybody's may be while it is not known yet."""
        camera = self._chosen
        if camera is None or address == camera:
            return True
        return channel != o3m.PIXEL_CHANNEL and address[0] == camera[0]

    def _sender(self, address: Address, arrived_s: float) -> Reassembler:
        if address not in self._senders:
            if len(self._senders) >= _MAX_SENDERS:
                others = (one for one in self._senders if one != self._chosen)
                idle = min(others, key=self._heard_s.__getitem__)
                del self._senders[idle], self._heard_s[idle]
            self._senders[address] = Reassembler(o3m.CHANNELS)
        self._heard_s[address] = arrived_s
        return self._senders[address]

    def _take(
        self, message: ChannelMessage, address: Address, arrived_s: float
    ) -> CameraFrame | None:
        """Read a whole message."""
        try:
            if message.channel == o3m.PIXEL_CHANNEL:
                image = o3m.read_image(message.content)
                if not self._choose(address, arrived_s):
                    return None
                return self._frame(image, message.cycle, arrived_s)
            if self._is_camera(address, message.channel):
                if message.channel == o3m.DIAGNOSIS_CHANNEL:
                    self.diagnosis = o3m.read_diagnosis(message.content)
                elif message.channel == o3m.PARAMETER_CHANNEL:
                    self.parameters = message.content
                self._informant = address[0]
        except DataError as error:
            if self._is_camera(address, message.channel):
                self._counts["wrong_size_or_version"] += 1
                self._wrong = str(error)
        return None

    def _choose(self, address: Address, arrived_s: float) -> bool:
        """Let the sender of an image be the camera, unless there is one; tell whether it is."""
        before = self._chosen
        if address != before and before is not None and arrived_s - self._seen_s <= QUIET_S:
            self._counts["other_cameras_images"] += 1
            self.other = _named(address)
            return False
        self._seen_s = arrived_s
        if address == before:
            return True
        self._chosen, self.image = address, None
        if self._informant != address[0]:
            self.diagnosis, self.parameters = None, b""
        if before is not None:  # cycles and times are those of another counter from here on
            raise DeviceError(
                f"the camera at {_named(before)} has fallen silent, images come from "
                f"{_named(address)} now"
            )
        return True

    def _frame(self, image: o3m.O3MImage, cycle: int, arrived_s: float) -> CameraFrame:
        if self.image is None:
            self._time_us = image.timestamp_us
        else:
            self._time_us += counter_steps(image.timestamp_us, self.image.timestamp_us)
        self.image = image
        frame = Frame(image.amplitude, image.distance_m, image.valid, self._time_us * 1e-6)
        return CameraFrame(frame, cycle, arrived_s, image.raw)

    def totals(self) -> dict[str, int]:
        """Return everything counted: of the camera, of all senders while it is not known yet."""
        senders = dict(self._senders)
        camera = senders.get(self._chosen) if self._chosen is not None else None
        each = [one.counts for one in (senders.values() if camera is None else [camera])]
        found = {name: self._counts[name] for name in _OF_PORT}
        found |= {name: sum(getattr(n, of) for n in each) for name, of in _OF_SENDERS.items()}
        found["wrong_size_or_version"] += self._counts["wrong_size_or_version"]
        return found

    def snapshot(self) -> Snapshot:
        """Return all counts as they are now, for `explain`."""
        return self._datagrams, self.totals(), dict(self._channels)

    def explain(self, before: Snapshot) -> str:
        """Tell in words for the bench why no image came since a snapshot."""
        datagrams, totals, channels = before
        came = {name: count - totals[name] for name, count in self.totals().items()}
        if self._datagrams == datagrams:
            return (
                f"nothing arrives{' any more' if datagrams else ''}; check power and cable, "
                "that the camera sends to this computer and this port, and the firewall"
            )
        if not came["packets"]:
            if came["other_cameras_packets"]:
                wanted = self.source or self.address
                return f"packets come only from {self._stranger}, none from {wanted}"
            return f"{came['foreign_packets']} datagrams came from {self._stranger}, none an O3M's"
        if came["wrong_size_or_version"]:
            return f"{came['wrong_size_or_version']} messages of an unknown version or size" + (
                f" ({self._wrong})" if self._wrong else ""
            )
        seen = [one for one, n in dict(self._channels).items() if n > channels.get(one, 0)]
        if o3m.PIXEL_CHANNEL not in seen:
            return (
                f"channel {', '.join(map(str, sorted(seen)))} arrives, but not channel "
                f"{o3m.PIXEL_CHANNEL} with the pixels{self._mode()}; choose pixel data in the "
                "camera's Ethernet settings"
            )
        sent = max(1, came["packets"] + came["lost_packets"])
        return (
            f"only parts of cycles arrive: {came['partial_cycles']} were given up, "
            f"{100 * came['lost_packets'] / sent:.0f} % of the packets are lost; check network "
            f"card, switch and cable{self._mode()}"
        )

    def _mode(self) -> str:
        if self.diagnosis is None or self.diagnosis.mode == o3m.RUN_MODE:
            return ""
        return f" (the camera is in mode: {self.diagnosis.mode_name})"

    def describe(self) -> dict[str, Any]:
        """Return layout, temperatures, parameters and factors, as far as they have come."""
        known: dict[str, Any] = {"model": "ifm O3M", "address": self.address}
        if self.other:
            known["another_camera"] = f"{self.other} sends images too; choose by source"
        elif self._stranger:
            known["other_sender"] = self._stranger
        image, diagnosis = self.image, self.diagnosis
        if image is not None:
            known["layout"] = image.layout
            for name in ("normalization", "calibration"):
                known[name] = image.raw[name].astype(np.float64).tolist()
            known["coarse_pixels"] = image.coarse_pixels
        if diagnosis is not None:
            known |= asdict(diagnosis) | {"mode": diagnosis.mode_name}
        if self.parameters:
            known["parameters_hex"] = self.parameters.hex()
        return known


def _named(address: Address) -> str:
    return f"{address[0]}:{address[1]}"
