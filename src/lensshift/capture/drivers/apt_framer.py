"""Finds APT messages in any stream of bytes, also one that lost or gained some."""

from __future__ import annotations

import struct
from collections.abc import Mapping

from lensshift.capture.drivers.apt_codec import CONTROLLER, HEADER_BYTES, HOST, LONG, Message


class Framer:
    """Finds messages in any stream of bytes; it holds less than one.

    What is no message, or of a length that its id does not have, is skipped byte by byte; half a
    message is dropped when nothing follows it in time.
    """

    def __init__(
        self,
        sizes: Mapping[int, tuple[int, ...]],  # bytes of data by message id; 0 is the short form
        *,
        destination: int | tuple[int, ...] = HOST,  # accepted, one or several
        source: int = CONTROLLER,
        patience_s: float = 0.03,  # how long half a message waits for its next byte
    ) -> None:
        self.resyncs = 0  # stretches of bytes that were no message
        self._sizes = sizes
        self._destinations = (destination,) if isinstance(destination, int) else destination
        self._source = source
        self.called = self._destinations[0]  # destination of the last message
        self._patience_s = patience_s
        self._held = b""
        self._last_s = 0.0
        self._lost = False

    @property
    def wanted(self) -> int:
        """Bytes that complete the message in hand, or its header: what to read next."""
        size = self._size(self._held)
        return HEADER_BYTES - len(self._held) if size is None else size - len(self._held)

    def feed(self, data: bytes, now_s: float) -> list[Message]:
        """Return the messages that `data`, come at `now_s` (any clock), makes whole."""
        late = now_s - self._last_s > self._patience_s
        found = self._take(len(self._held)) if late and self._held else []
        if data:
            self._last_s = now_s
            self._held += data
            found += self._take(0)
        return found

    def _take(self, drop: int) -> list[Message]:
        """Cut whole messages off; rather than wait for more, skip a byte of the first `drop`."""
        found, at = [], 0
        while len(self._held) > at:
            size = self._size(self._held[at : at + HEADER_BYTES])
            if size is not None and 0 < size <= len(self._held) - at:
                found.append(self._message(self._held[at : at + size]))
                at += size
                self._lost = False
            elif size == 0 or at < drop:
                self.resyncs += not self._lost
                self._lost = True
                at += 1
            else:
                break
        self._held = self._held[at:]
        return found

    def _size(self, held: bytes) -> int | None:
        """Return the length of the message that begins here, 0 if none does, None if unknown."""
        if len(held) < HEADER_BYTES:
            return None
        message_id, length, destination, source = struct.unpack_from("<HHBB", held)
        if destination & ~LONG not in self._destinations or source != self._source:
            return 0
        data = length if destination & LONG else 0
        return HEADER_BYTES + data if data in self._sizes.get(message_id, ()) else 0

    def _message(self, raw: bytes) -> Message:
        message_id, *parameters, destination = struct.unpack_from("<HBBB", raw)
        self.called = destination & ~LONG
        data = raw[HEADER_BYTES:]
        if data:
            return Message(message_id, data=data)
        return Message(message_id, (parameters[0], parameters[1]))
