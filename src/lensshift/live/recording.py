"""Keep what arrives, and pictures that somebody wants to keep."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields, replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from lensshift.core.errors import DataError
from lensshift.core.types import Burst
from lensshift.io import save_burst, save_reconstruction, write_recording
from lensshift.io.capture_file import (
    CaptureWriter,
    FrameRecord,
    burst_of_capture,
    frames_of_capture,
)
from lensshift.live.picture import Picture, one_frame
from lensshift.live.sources import Shot

_TOGETHER = 64  # frames of a journal that are read and written at once


class Recording:
    """Frames of one plan: a journal while they come, a burst file after `close`."""

    def __init__(self, folder: Path, plan: Burst, pattern: str) -> None:
        self.path = unused(folder, "recording", ".nc")
        self._pattern = pattern
        self._steps: list[int] = []  # place of each frame, which is all that is kept of it here
        self._begin(plan)

    @property
    def count(self) -> int:
        """Frames so far."""
        return len(self._steps)

    def _begin(self, plan: Burst) -> None:
        self._plan = plan
        header: dict[str, Any] = {
            "plan": plan.meta.get("plan", ""),
            "pitch_mm": list(plan.grid.pitch_mm),
            "shape": list(plan.grid.shape),
            "modulation_hz": plan.modulation_hz,
            "meta": dict(plan.meta),
        }
        self._file = CaptureWriter.create(self.path, header)

    def append(self, shot: Shot) -> bool:
        """Write a frame; return whether it belongs here, which one of another plan does not.

        The first one of the pattern says the plan: where that has just been changed, the picture
        that the recording began with, and a frame on its way, are of the one before.
        """
        if not self.count and shot.plan.meta["plan"] != self._pattern:
            return True
        if shot.plan is not self._plan:
            if self.count:
                return False
            self._file.close()
            self.path.unlink()
            self._begin(shot.plan)
        seen = {one.name: getattr(shot.frame, one.name) for one in fields(shot.frame)}
        record = FrameRecord(
            step=shot.place, offset_px=np.asarray(shot.offset_px), stage_mm=shot.stage_mm,
            stage_commanded_mm=shot.commanded_mm, **seen,
        )  # fmt: skip
        self._file.append(record)
        self._file.frames.clear()  # they are on disk; a long recording shall not fill memory
        self._steps.append(shot.place)
        return True

    def close(self) -> None:
        """End it: a burst file takes the place of the journal; without a frame nothing is left.

        DataError if the file cannot be written; the journal stays.
        """
        self._file.close()
        if not self.count:
            self.path.unlink(missing_ok=True)
            return
        write_recording(self.path, self.count, self._parts())

    def _parts(self) -> Iterator[Burst]:
        """Yield the frames in bursts, each of which has to show something."""
        held: list[FrameRecord] = []
        frames = frames_of_capture(self.path)
        while some := list(islice(frames, _TOGETHER)):
            if all(any(one.valid.any() for one in part) for part in (held, some)):
                yield self._part(held)
                held = []
            held += some
        yield self._part(held)

    def _part(self, frames: list[FrameRecord]) -> Burst:
        part = burst_of_capture(self._file.header, frames, self.path)
        meta = {**part.meta, "step": self._steps}
        return replace(part, meta=meta, intrinsics=self._plan.intrinsics)


def save_snapshot(picture: Picture, folder: Path) -> tuple[Path, ...]:
    """Write a picture as result file and PNG, and its frames as a burst file, or a DataError."""
    from lensshift.report.preview import save_shots

    result = unused(folder, "snapshot", ".nc")
    frames, preview = result.with_name(f"{result.stem}-frames.nc"), result.with_suffix(".png")
    save_burst(picture.window, frames)
    save_reconstruction(picture.result, result)
    images = {name: np.abs(one.image) for name, one in picture.result.channels.items()}
    shown = {"one frame": one_frame(picture), picture.settings.method: images}
    save_shots(shown, f"{picture.window.frame_count} frames", preview)
    return result, frames, preview


def unused(folder: Path, name: str, ending: str) -> Path:
    """Return the first of NAME-0001 and so on that no file has; DataError if all are taken."""
    for number in range(1, 10_000):
        path = folder / f"{name}-{number:04d}{ending}"
        if not path.exists():
            return path
    raise DataError("expected room for another file, 9999 are there", source=folder)
