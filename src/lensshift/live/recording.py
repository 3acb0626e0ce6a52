"""Keep what arrives, and pictures that somebody wants to keep."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from lensshift.core.errors import DataError
from lensshift.core.types import Burst
from lensshift.io import save_burst, save_reconstruction
from lensshift.io.capture_file import CaptureWriter, FrameRecord, burst_of_capture, read_capture
from lensshift.live.picture import Picture, one_frame
from lensshift.live.sources import Shot


class Recording:
    """Frames of one plan: a journal while they come, a burst file after `close`."""

    def __init__(self, folder: Path, plan: Burst, pattern: str) -> None:
        self.path = unused(folder, "recording", ".nc")
        self.count, self._pattern = 0, pattern
        self._begin(plan)

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
            step=shot.place,
            offset_px=np.asarray(shot.offset_px),
            stage_mm=shot.stage_mm,
            stage_commanded_mm=shot.commanded_mm,
            **seen,
        )
        self._file.append(record)
        self._file.frames.clear()  # they are on disk; a long recording shall not fill memory
        self.count += 1
        return True

    def close(self) -> None:
        """End it: a burst file takes the place of the journal; without a frame nothing is left.

        DataError if the file cannot be written; the journal stays.
        """
        self._file.close()
        if not self.count:
            self.path.unlink(missing_ok=True)
            return
        header, frames = read_capture(self.path)
        burst = burst_of_capture(header, frames, self.path)
        save_burst(replace(burst, intrinsics=self._plan.intrinsics), self.path)


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
