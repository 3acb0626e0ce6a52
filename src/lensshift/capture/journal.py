"""The journal of a capture: what its header says, and whether it may be gone on with."""

from __future__ import annotations

import hashlib
import itertools
import json
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np

from lensshift.capture.rig import Camera, Stage
from lensshift.core.arrays import Array
from lensshift.core.calibration import Calibration
from lensshift.core.errors import DataError, naming
from lensshift.core.settings import table_of, to_json
from lensshift.core.types import Burst
from lensshift.io import load_burst
from lensshift.io.calibration_file import calibration_content
from lensshift.io.capture_file import CaptureWriter, is_capture

# What must be the same before and after a break: else the frames of one burst do not fit together.
_SAME = ("plan", "frames", "average", "pitch_mm", "shape", "modulation_hz")
_OF_DEVICES = ("name", "settings")  # as they describe themselves: another one shows other places
_SAME_MM = 1e-6  # far below what an encoder resolves, far above what rounding does


def capture_header(
    stage: Stage,
    camera: Camera,
    position_mm: Array,
    calibration: Calibration,
    settings: Mapping[str, Any],
    plan_name: str,
) -> dict[str, Any]:
    """Return what a journal says of the whole capture; `settings` are those of `Acquisition`."""
    # Notes, such as the date, do not count.
    content = {k: v for k, v in calibration_content(calibration).items() if k != "notes"}
    text = json.dumps(content, sort_keys=True)
    return {
        "plan": plan_name,
        "frames": settings["frames"],
        "average": settings["average"],
        "shape": list(camera.grid.shape),
        "pitch_mm": list(camera.grid.pitch_mm),
        "modulation_hz": camera.modulation_hz,
        "position_mm": position_mm.tolist(),
        "offset_source": calibration.offset_source,
        "calibration": {**content, "sha256": hashlib.sha256(text.encode()).hexdigest()},
        "meta": {
            "plan": plan_name,
            "stage": {"name": stage.name, **stage.describe()},
            "camera": {"name": camera.name, **camera.describe()},
            "acquisition": dict(settings),
            "rest_mm": np.asarray(calibration.rest_mm).tolist(),
            "px_per_mm": np.asarray(calibration.stage_map.px_per_mm).tolist(),
        }
        | ({} if calibration.psf_sigma_px is None else {"psf_sigma_px": calibration.psf_sigma_px})
        | ({"optics": calibration.notes["optics"]} if "optics" in calibration.notes else {})
        | calibration.of_camera,
    }


def finished(path: str | Path, plan_name: str, asked: Mapping[str, Any]) -> Burst | None:
    """Return the burst of a capture that is complete: there is nothing to resume.

    Raises
    ------
    DataError
        If there is a file that is no capture, holds another plan, or was taken in another way than
        is `asked` (some settings of `Acquisition`).
    """
    if not Path(path).exists() or is_capture(path):
        return None
    burst = load_burst(path)
    if "acquisition" not in burst.meta:
        raise DataError("nothing to resume: this is no capture", source=path)
    kept = {**table_of(burst.meta, "acquisition"), "plan": burst.meta.get("plan")}
    for name, value in {"plan": plan_name, **asked}.items():
        if kept.get(name) != value:
            problem = f"the capture is complete, with {name} {kept.get(name)!s:.60}, not {value}"
            raise DataError(problem, field=name, source=path)
    return burst


def set_aside(path: str | Path) -> Path | None:
    """Make room for a capture that begins anew: rename an unfinished one, and return its new name.

    A complete one, or anything else of that name, stays; then it is refused as ever.

    Raises
    ------
    DataError
        If it cannot be renamed, or is being written by another process.
    """
    target = Path(path)
    if not is_capture(target):
        return None
    CaptureWriter.resume(target).close()
    names = (target.with_stem(f"{target.stem}-unfinished-{n}") for n in itertools.count(1))
    aside = next(name for name in names if not name.exists())
    try:
        return target.rename(aside)
    except OSError as error:
        raise DataError(f"cannot be set aside: {error.strerror}", source=target) from error


def opened(path: str | Path, header: Mapping[str, Any], *, resume: bool) -> CaptureWriter:
    """Begin a journal, or go on with the one that is there if it was begun in the same way.

    Raises
    ------
    DataError
        If the file cannot be written, exists already, or was begun otherwise.
    """
    if not resume or not Path(path).exists():
        return CaptureWriter.create(path, header)
    with ExitStack() as opening, naming(path):
        file = opening.enter_context(CaptureWriter.resume(path))
        _check_same(file.header, header)
        opening.pop_all()
    return file


def _check_same(begun: Mapping[str, Any], wanted: Mapping[str, Any]) -> None:
    kept, asked = (_to_compare(one) for one in (begun, wanted))
    for name, value in asked.items():
        if kept[name] != value:
            raise DataError(
                f"the capture was begun with {name} {kept[name]!s:.200}, not {value!s:.200}; "
                "resume it as it was begun, or begin anew (--restart)",
                field=name,
            )
    before, now = (np.asarray(one["position_mm"], dtype=float) for one in (begun, wanted))
    same = before.shape == now.shape
    if same:  # in any order: that depends on where the stage stood
        near = np.abs(before[:, None] - now).max(axis=-1) <= _SAME_MM
        same = bool(near.any(axis=0).all() and near.any(axis=1).all())
    if not same:
        problem = "the capture was begun with other positions; resume it with its own plan or span"
        raise DataError(f"{problem}, or begin anew (--restart)", field="position_mm")


def _to_compare(header: Mapping[str, Any]) -> dict[str, Any]:
    """Return what must be the same; a journal has lists of what was a tuple."""
    found = {name: header.get(name) for name in _SAME}
    found["calibration"] = f"sha256 {table_of(header, 'calibration').get('sha256')!s:.12}"
    for device in ("stage", "camera"):
        told = table_of(table_of(header, "meta"), device, "meta")
        found |= {f"{device}.{name}": told.get(name) for name in _OF_DEVICES}
    return dict(json.loads(to_json(found)))
