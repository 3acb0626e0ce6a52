"""Told shifts held against the frames: a mistake is named, errors and patterns are mended."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from lensshift.core.arrays import Array
from lensshift.core.errors import warn_quality
from lensshift.core.phasors import has_phasors
from lensshift.core.types import Burst, ShiftField
from lensshift.reconstruction.glance import Glance, glance
from lensshift.reconstruction.learned.method import USUAL_SHIFT_ERROR_PX
from lensshift.reconstruction.learned.pattern import without_pattern
from lensshift.reconstruction.method import Method, Request
from lensshift.reconstruction.phasor.choice import Choice
from lensshift.reconstruction.phasor.common_light import phasors_in_common
from lensshift.reconstruction.phasor.rounding import differ_by_rounding
from lensshift.reconstruction.pixel_response import averaged
from lensshift.reconstruction.quick_shifts import found_variance_px2
from lensshift.reconstruction.shift_check import (
    HARDLY_TOLD,
    STILL,
    TURNING,
    Doubt,
    doubtful_shifts,
    surely_better,
    warn_of_doubt,
)

# More than twice the budget of a calibration, which `register` calls poor as well; smaller errors
# are mended without a word.
SAID_PX = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class Told:
    """What came of the shifts that were told.

    Parameters
    ----------
    burst, part : with shifts that frames and user agree on; the second has the used frames alone
    doubt : what is wrong with the shifts as told, and not mended
    settings : what a result should say of it
    """

    burst: Burst
    part: Burst
    doubt: Doubt | None = None
    settings: dict[str, Any] = field(default_factory=dict)


def held_against_frames(
    burst: Burst,
    part: Burst,
    shift_field: ShiftField | None,
    scale: int,
    request: Request,
    method: Method,
    choice: Choice,
) -> tuple[Told, Request]:
    """Return what the frames doubt of the shifts; or shifts without doubt, if the method may mend.

    Before, phasors are brought to one light and distance, and what stays at the pixels is taken off
    frames.

    Warns
    -----
    QualityWarning
        If there is a doubt that has a name, shifts were mended by more than 0.05 px (rms), or the
        pixels have a pattern.
    """
    phasors = choice.channel == "phasor"
    if phasors and not request.streamed:
        burst, request = phasors_in_common(burst, request, stacklevel=3)
        part = burst.select(request.frames)
    told = Told(burst, part)
    mend = method.name == "auto" or phasors
    if not (mend or method.questions_shifts):
        return told, request
    look, doubt = _looked_at(part, shift_field, scale)
    mend = mend and shift_field is None and not request.streamed
    # A strong pattern may predict pixels better where they are, but not pass for all of the scene.
    scene_stays = doubt is not None and (
        doubt.mistake == TURNING or (doubt.mistake == STILL and doubt.told)
    )
    if mend and not (request.photometric or scene_stays):
        burst, request, said = without_pattern(burst, request, scale, phasors=phasors, stacklevel=3)
        if said:
            told = Told(burst, part := burst.select(request.frames), settings=said)
            look, doubt = _looked_at(part, shift_field, scale)
    known_px = part.offset_sigma_px if part.offset_source == "registered" else None
    hardly = known_px is not None and known_px.max() > SAID_PX  # were they told by the frames
    if hardly and doubt is not None and doubt.named and doubt.mistake != TURNING:
        doubt = replace(doubt, mistake=HARDLY_TOLD)
    told = replace(told, doubt=doubt)
    if doubt is not None and doubt.named:
        warn_of_doubt(doubt, stacklevel=3)
        return told, replace(request, shifts_doubted=True)
    # The lens of a stream comes back to places that were found long ago.
    if look is None or not mend or not _in_question(part, look):
        return told, request
    return _mended(told, look, request), request


def _looked_at(
    part: Burst, shift_field: ShiftField | None, scale: int
) -> tuple[Glance | None, Doubt | None]:
    shifts = part.offset_px if shift_field is None else shift_field.offset_px
    look = glance(_averages(part), shifts, part.valid)
    doubt = None if look is None else doubtful_shifts(look, scale)
    return look, None if doubt is None or differ_by_rounding(part) else doubt


def _mended(told: Told, look: Glance, request: Request) -> Told:
    """Return the burst with the shifts that the frames show, if they surely show other ones."""
    # Few bursts come here; the others need not wait until it is imported.
    from lensshift.registration.told import REACH_PX, corrected_shifts

    if np.abs(look.apart_px).max() > REACH_PX:
        return told
    burst, part = told.burst, told.part
    found = corrected_shifts(_averages(part), part.valid, part.offset_px)
    if found is None or not surely_better(look, found.offset_px):
        return told
    if found.error_px > SAID_PX and not surely_better(look, found.offset_px, solved=True):
        return told
    used = list(request.frames or range(burst.frame_count))
    if found.error_px > SAID_PX:
        away_px = found.offset_px - part.offset_px
        most = int(np.argmax(np.hypot(*away_px.T)))
        down, right = away_px[most]
        warn_quality(
            f"offset_px is off by {found.error_px:.2f} px (rms; frame {used[most]} by {down:+.2f}, "
            f"{right:+.2f}): the picture takes the shifts that the frames show; calibrate the rig, "
            "or let `lensshift.register` find offset_px",
            4,
        )
    moved = np.array(burst.offset_px)
    known = burst.offset_sigma_px
    sigma_px = np.zeros_like(moved) if known is None else np.array(known)
    moved[used], sigma_px[used] = found.offset_px, found.sigma_px
    burst = replace(burst, offset_px=moved, offset_sigma_px=sigma_px)
    said = {"corrected_offset_px": found.offset_px.tolist(), "offset_error_px": found.error_px}
    return Told(burst, burst.select(used), None, told.settings | said)


def _averages(part: Burst) -> Array:
    """Return frames [frame row col] that move like the scene.

    An amplitude of two distances is no mean of theirs: where they are mixed it falls to nothing.
    """
    phasors = part.distance_m is not None and has_phasors(part)
    return averaged(part, "phasor" if phasors else "amplitude")


def _in_question(part: Burst, look: Glance) -> bool:
    """Return whether frames seem to lie elsewhere than they usually do beside where they were told.

    Shifts that were found from the frames, or told to be exact, are not asked.
    """
    exact = part.offset_sigma_px is not None and not part.offset_sigma_px.any()
    if exact or part.affine is not None or part.offset_source == "registered":
        return False
    away_px2 = float(np.sum(look.apart_px**2)) / (len(look.apart_px) - 1)
    usual_px2 = 2 * USUAL_SHIFT_ERROR_PX**2
    if away_px2 <= usual_px2:
        return False
    return away_px2 > usual_px2 + found_variance_px2(look.smooth, look.found_px)
