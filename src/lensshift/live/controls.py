"""What a person at the page may change, through the same checks as the command line."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from lensshift.capture.plan import PLANS
from lensshift.core.settings import fit, only
from lensshift.forward.model import MAX_SCALE
from lensshift.live.picture import Settings
from lensshift.live.recording import Recording
from lensshift.live.worker import Live
from lensshift.reconstruction.methods import find_method, method_names

_KNOWN = ("pattern", "scale", "method", "blur_px", "record")
MOST_BLUR_PX = 2.0  # a lens far out of focus


def choices(live: Live) -> dict[str, Any]:
    """Return what there is to choose from."""
    own = live.source.pattern
    return {
        "patterns": [*([] if own in PLANS else [own]), *PLANS],
        "methods": list(method_names()),
        "most_scale": MAX_SCALE,
        "most_blur_px": MOST_BLUR_PX,
    }


def checked(settings: Settings) -> Settings:
    """Return the settings if pictures can be made so, or raise a ValueError."""
    if settings.scale not in range(1, MAX_SCALE + 1):
        raise ValueError(f"expected a scale from 1 to {MAX_SCALE}, got {settings.scale}")
    find_method(settings.method)
    blur_px = settings.blur_px
    if blur_px is not None and not 0.0 <= blur_px <= MOST_BLUR_PX:
        raise ValueError(f"expected a blur from 0 to {MOST_BLUR_PX:g} px, got {blur_px:g}")
    return settings


def control(live: Live, wanted: Mapping[str, Any], folder: Path) -> None:
    """Do what the page asks for; nothing of it if any of it is wrong.

    ValueError if a setting is unknown or out of range, or the lens cannot go there. DataError if
    the recording cannot be written.

    wanted : any of "pattern", "scale", "method", "blur_px" (None: what the source knows), and
        "record" (whether, to the folder)
    """
    only(wanted, _KNOWN)
    kinds = {"scale": int, "method": str, "blur_px": float | None}
    given = {name: fit(wanted[name], kind, name) for name, kind in kinds.items() if name in wanted}
    settings = checked(replace(live.settings, **given))
    record = "record" in wanted and fit(wanted["record"], bool, "record")
    if record and "pattern" in wanted:
        raise ValueError("expected pattern or record: another pattern ends a recording")
    if "pattern" in wanted:
        live.source.choose(fit(wanted["pattern"], str, "pattern"))
    if "record" in wanted:
        live.record(_new_recording(live, folder) if record else None)
    live.settings = settings


def _new_recording(live: Live, folder: Path) -> Recording:
    if live.picture is None:
        raise ValueError("expected a picture before a recording, none has come yet")
    folder.mkdir(parents=True, exist_ok=True)
    return Recording(folder, live.picture.shot.plan, live.source.pattern)


def box_of(value: Any, shape: tuple[int, int]) -> tuple[int, int, int, int]:
    """Return a box (row start, row stop, col start, col stop) within an image, or a ValueError."""
    if not (isinstance(value, list) and len(value) == 4 and all(type(n) is int for n in value)):
        raise ValueError(f"expected a box [row start, row stop, col start, col stop], got {value}")
    top, bottom, left, right = value
    if not (0 <= top < bottom <= shape[0] and 0 <= left < right <= shape[1]):
        raise ValueError(f"expected a box within {shape[0]} x {shape[1]} px, got {value}")
    return top, bottom, left, right
