"""Frames one at a time: a picture after each of them, while the lens goes round its plan."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from lensshift.core.arrays import Floats, Mask
from lensshift.core.burst_checks import all_valid
from lensshift.core.errors import warn_quality
from lensshift.core.types import Burst, Frame, Reconstruction
from lensshift.reconstruction.clipping import measured
from lensshift.reconstruction.following import Followed, brighter
from lensshift.reconstruction.method import Method
from lensshift.reconstruction.methods import make_method
from lensshift.reconstruction.options import one_of
from lensshift.reconstruction.phasor.choice import UNTOLD
from lensshift.reconstruction.photometry import differing, lights
from lensshift.reconstruction.places import (
    BETTER_PLACE,
    MOST,
    RESTS,
    Claim,
    Known,
    burst_of,
    frame_of,
    is_blank,
    is_noisier,
)
from lensshift.reconstruction.reconstruct import reconstruct

Pace = Literal["auto", "live", "refined"]

# Of the pictures of a scene that rests, so many are computed by the response and the shifts that
# the frames of one did not contradict: their frames would say the same. A lens that goes out of
# focus by less than is noticed is asked then.
BELIEVED_PICTURES = 16


class Stream:
    """The picture of the last frames of a camera whose lens goes round a plan; see `stream`."""

    def __init__(self, template: Burst, scale: int, pace: Pace, settings: dict[str, Any]) -> None:
        self._template, self._scale, self._pace = template, scale, pace
        self._settings = settings
        self._frames: dict[int, Frame] = {}
        self._known: Known | None = None
        self._next = self._since_refined = self._since_asked = 0
        self._contradicted = 0  # pictures computed one after the other that their frames contradict
        self._event: str | None = None
        self._rests = True
        self._claim: Claim | None = None
        self._moved: dict[int, Mask] = {}  # where frames were not those of their places before
        self._partial = False  # whether some frames were left out of some pixels of the picture
        self._stuck = np.zeros(template.grid.shape, np.bool_)  # left out of all frames
        self._another = False  # whether these are of another scene
        self._told: set[str] = set()  # what was said of such pixels

    @property
    def window(self) -> Burst:
        """The frames in the picture, as a burst, in the order of the plan.

        Those of before the light changed are as bright as the latest one.

        Raises
        ------
        ValueError
            Before the first frame that shows anything, and after a round of none.
        """
        whole = self._in_one_light()[0]
        return self._of_now(whole) if self._partial else whole

    @property
    def frames(self) -> tuple[int, ...]:
        """The places of the plan whose frames are in the picture, the latest last."""
        return tuple(self._frames)

    def step(self, frame: Frame | ArrayLike, *, place: int | None = None) -> Reconstruction:
        """Take one frame and return the picture: `take`, then `picture`.

        Raises
        ------
        ValueError
            As `take` does.
        """
        self.take(frame, place=place)
        return self.picture()

    def take(self, frame: Frame | ArrayLike, *, place: int | None = None) -> None:
        """Take one frame and solve nothing, where not every frame needs a picture.

        One that shows nothing is lost: its place is not in the picture until the next round. It has
        no valid pixel, or all of them are alike while another frame of the picture shows more.

        Parameters
        ----------
        frame : a `Frame`, or its amplitudes or phasors [row col]
        place : where on the plan it was taken; by default the place after the last one

        Raises
        ------
        ValueError
            If the place is not on the plan, the frame is of another shape or kind than those
            before (amplitudes after phasors), or it holds phasors of several frequencies.
        """
        one = frame_of(frame)
        if one.amplitude.shape != self._template.grid.shape:
            raise ValueError(
                f"expected a frame of {self._template.grid.shape}, got {one.amplitude.shape}"
            )
        self._refuse_another_kind(one)
        place_now = self._next if place is None else place
        others = [other for k, other in self._frames.items() if k != place_now]
        lost = is_blank(one) and not all(map(is_blank, others))
        shows = bool(np.any(one.valid & ~self._stuck)) and not lost
        latest = next(reversed(self._frames.values()), one)
        if shows and latest.distance_m is not None and one.distance_m is None:
            self._warn("a frame has no distances, so the picture has none while it is in there")
        seen = replace(one, valid=one.valid & ~self._stuck) if self._stuck.any() else one
        at, event, rests = self._placed(seen, place, shows)
        if event == "scene changed":
            self._frames.clear()
            self._known, self._moved, self._another = None, {}, True
            if self._claim is not None:  # what it placed elsewhere is of after the change
                self._frames.update(self._claim.frames)
        if event == "scene changed" or place is not None or not shows:
            self._claim = None
        self._rests = self._rests and rests and len(self._frames) == self._template.frame_count
        self._frames.pop(at, None)
        if shows:
            self._frames[at] = one
        self._next = (at + 1) % self._template.frame_count
        self._event = event or self._event

    def picture(self, *, refined: bool = False) -> Reconstruction:
        """Return the picture of the frames taken so far.

        Parameters
        ----------
        refined : compute it, whatever the pace

        Its settings say what was done: `pace` "live" (that of before, as bright and as far away as
        the frames since show it) or "refined" (`reconstruct`), `places` of the frames in it, and
        `event` since the last one: "scene changed", "frames lost", "frame twice" or None. After a
        round that shows nothing it is the one before, of no `places`.
        """
        count = self._template.frame_count
        round_ends = self._since_refined + 1 >= count  # all is computed anew, so nothing drifts
        # Until all frames are of after something moved, or it was not that.
        settled = not 0 < self._contradicted < count and not self._partial
        live = self._rests and settled and self._pace != "refined" and not refined
        live = not self._frames or (live and not (self._pace == "auto" and round_ends))
        known = self._known
        if live and known is not None:
            if not self._frames:
                self._warn("no frame of a round shows anything: the picture is that of before")
            found = brighter(known.followed.found, known.light)
            self._since_refined += 1
        else:
            rests = self._rests and settled and self._pace == "auto" and not refined
            before = self._believed() if rests else None
            self._since_asked = 0 if before is None else self._since_asked + 1
            window, times = self._in_one_light(look=True)
            found = self._solved(window, before)
            wrong = any("contradiction" in one.notes for one in found.channels.values())
            dimmed = min(1.0, float(times.min()))
            self._known = Known(Followed(found, found), self._lit(window, times), dimmed=dimmed)
            self._contradicted = self._contradicted + 1 if wrong else 0
            self._since_refined, live = 0, False
        event, self._event, self._rests = self._event, None, True
        said = {"pace": "live" if live else "refined", "places": sorted(self._frames)}
        return replace(found, settings=dict(found.settings) | said | {"event": event})

    def _in_one_light(self, *, look: bool = False) -> tuple[Burst, Floats]:
        """Return the frames as bright as the latest, and by what [frame] they are multiplied.

        Parameters
        ----------
        look : for pixels that do not follow the scene; else those are left out that did not before
        """
        places = sorted(self._frames)
        if not places:
            raise ValueError("no frame shows anything: expected a frame with a valid pixel")
        whole = burst_of(self._template, places, [self._frames[k] for k in places])
        window, said = measured(whole) if look else (whole, [])
        even = self._settings.get("photometric")
        times = np.ones(len(places)) if even else lights(window, places.index(self.frames[-1]))
        lit = bool(np.any(times != 1))
        if lit:  # else their numbers stay what they are
            window = replace(window, amplitude=window.amplitude * times[:, None, None])
        if look:
            # In another light none stays the same, and a few frames do not say.
            if self._another and not lit and len(places) == self._template.frame_count:
                self._stuck, self._another = np.zeros_like(self._stuck), False
            self._stuck = self._stuck | np.all(whole.valid & ~window.valid, axis=0)
            for text in said:
                if (what := text.partition(":")[0]) not in self._told:
                    self._warn(text)
                self._told.add(what)
        if self._stuck.any():
            window = replace(window, valid=window.valid & ~self._stuck)
        return window, times

    def _solved(self, window: Burst, before: Reconstruction | None) -> Reconstruction:
        """Return the picture of frames, which are left out where they are of before a movement."""
        part = self._of_now(window)
        self._partial = part is not window
        if self._partial:
            rows, cols = np.nonzero(np.any(window.valid & ~part.valid, axis=0))
            where = f"rows {rows.min()} .. {rows.max()}, columns {cols.min()} .. {cols.max()}"
            self._warn(f"something moved at {where}: there the picture is of the frames since")
        return reconstruct(part, self._scale, streamed=before or True, **self._settings)

    def _of_now(self, window: Burst) -> Burst:
        """Return the frames without what has moved since they were taken."""
        noise = 0.0 if self._known is None else self._known.noise_sigma
        if not (self._moved and noise):
            return window
        places, never = sorted(self._frames), np.zeros(window.grid.shape, np.bool_)
        old, latest = differing(window, places.index(self.frames[-1]), noise), self.frames[-1]
        since, now = never, self._moved.get(latest, never)
        # Frames from before something moved, or which alone show it; none is old by what is older.
        for place in reversed(self.frames):
            moved = self._moved.get(place, never)
            old[places.index(place)] &= since | (moved & ~now)
            since = since | moved
        return replace(window, valid=window.valid & ~old) if old.any() else window

    def _note_moved(self, moved: Mask, at: int) -> None:
        """Take note of where a frame is not that of its place before; a round later it is."""
        if len(self._moved) == self._template.frame_count:
            over = np.all([*self._moved.values()], axis=0) & ~moved
            self._moved = {k: one & ~over for k, one in self._moved.items()}
        self._moved[at] = moved
        self._moved = {k: one for k, one in self._moved.items() if one.any()}

    def _lit(self, window: Burst, times: Floats) -> dict[int, Frame]:
        """Return the frames of a window; the user is told if they are so many times as bright."""
        other = times[times != 1]
        if other.size:
            most = max(other, key=lambda one: abs(math.log(one)))
            self._warn(
                f"the light changed: {other.size} frames of before are multiplied, by up to "
                f"{most:.3g}, to be as bright as the latest"
            )
        seen = zip(sorted(self._frames), window.amplitude, window.valid, strict=True)
        return {k: replace(self._frames[k], amplitude=y, valid=valid) for k, y, valid in seen}

    def _refuse_another_kind(self, frame: Frame) -> None:
        """Refuse what does not go into one burst: of amplitudes alone phases would be 0.

        Of the first one it is said what it lacks.
        """
        waves, hz = np.iscomplexobj(frame.amplitude), self._template.modulation_hz
        if waves and isinstance(hz, tuple):
            raise ValueError(
                f"expected phasors of one modulation frequency, got {len(hz)} frequencies: a "
                "stream of each, or `reconstruct` of a burst with the phasors of all"
            )
        latest = next(reversed(self._frames.values()), frame)
        if waves and hz is None and latest is frame and "channel" not in self._settings:
            self._warn(UNTOLD)
        if np.iscomplexobj(latest.amplitude) != waves:
            got, before = ("phasors", "amplitudes") if waves else ("amplitudes", "phasors")
            raise ValueError(f"expected {before}, as the frames before, got {got}")

    def _believed(self) -> Reconstruction | None:
        """Return the picture whose response and shifts hold while the scene rests, if they do."""
        known = self._known
        if known is None or self._since_asked + 1 >= BELIEVED_PICTURES:
            return None
        whole = len(known.frames) == self._template.frame_count
        return known.followed.solved if known.fits and whole else None

    def _placed(self, frame: Frame, place: int | None, shows: bool) -> tuple[int, str | None, bool]:
        """Return where a frame was taken, what happened, and whether the scene rests."""
        count = self._template.frame_count
        if place is not None and not 0 <= place < count:
            raise ValueError(f"expected a place from 0 to {count - 1}, got {place}")
        at = self._next if place is None else place
        if not shows:
            self._warn(f"the frame of place {at} shows nothing and is left out")
            return at, "frames lost", False
        known = self._known
        if known is None or at not in self._frames or at not in known.frames:
            self._moved.pop(at, None)
            return at, None, False  # what nobody saw may be anything
        known, changed, share = known.beside(frame, at)
        self._known = known
        if place is None and self._claim is not None:
            true = self._claim.tells(frame, at, known.light)
            if true is False:
                self._warn("no frames were lost, but the camera moved: all before is left out")
                return self._claim.counted, "scene changed", False
            self._claim = None if true else self._claim.also(frame)
        asked = place is None and len(known.frames) == count > 1
        best = known.nearest(frame, at) if asked and known.fits else at
        if best == at and share > RESTS and is_noisier(changed):
            return at, None, False
        if best == at and share <= RESTS:
            if self._moved:
                self._note_moved(known.moved(frame, at), at)
            if self._pace != "refined":
                self._known = replace(known, followed=known.followed.by(changed))
            return at, None, True
        if asked and share > RESTS and (best != at or not known.fits):
            others = {k: known.against(frame, k, elsewhere=True)[1] for k in known.frames}
            others[at] = BETTER_PLACE * share
            asked_of = (at, best) if known.fits else others
            best = min(asked_of, key=others.__getitem__)
        if best != at:
            self._claim = self._claim or Claim(known, {}, at).also(frame)
            last = self.frames[-1]
            if best == last and count > 2:  # of two places the other one is as likely lost
                lost = f"the lens stood still, or {count - 1} frames were lost"
                self._warn(f"a frame of place {last} came twice, {lost}: it is in the picture once")
                return best, "frame twice", False
            self._warn(f"frames were lost: the one after place {last} is of {best}")
            return best, "frames lost", False
        # What follows frames takes another wall for other light and distance of the one before.
        moved = known.moved(frame, at)
        if max(share, float(np.mean(moved))) > MOST:
            self._warn("the scene changed: what was seen before is left out")
            return at, "scene changed", False
        self._note_moved(moved, at)
        return at, None, False

    def _warn(self, text: str) -> None:
        warn_quality(text, 4)


def stream(
    plan: ArrayLike | Burst,
    scale: int = 2,
    method: str | Method = "auto",
    *,
    pitch_mm: float | tuple[float, float] = 1.0,
    shape: tuple[int, int] | None = None,
    modulation_hz: float | None = None,
    pace: Pace = "auto",
    **settings: Any,
) -> Stream:
    """Return what takes frames one at a time and gives a picture after each.

    The last frame of each place of the plan is in the picture. A frame that most of the picture
    contradicts begins a new one ("scene changed"); one that fits another place of the plan goes
    there ("frames lost", or "frame twice" where it is the last one's). While the scene rests a new
    frame is followed in closed form (`lensshift.reconstruction.following`); if it contradicts the
    picture, all is computed anew.

    Parameters
    ----------
    plan : the shifts [place 2] (row, col) that the lens goes round, in LR pixels, or a burst that
        has them, whose grid, modulation, intrinsics and pixel response are those of the stream
    scale, method : as in `reconstruct`; other methods than "auto" are always "refined"
    pitch_mm, shape, modulation_hz : of the frames, where the plan is no burst
    pace : "live": computed anew where frames contradict the picture, else followed; "refined":
        computed anew at each step; "auto": once a round of the plan
    settings : of `reconstruct`

    Raises
    ------
    ValueError
        If the plan is none, or a setting is unknown.

    Examples
    --------
    >>> import numpy as np, lensshift
    >>> square = [(-0.25, -0.25), (-0.25, 0.25), (0.25, 0.25), (0.25, -0.25)]
    >>> camera = lensshift.stream(square, shape=(16, 64))
    >>> picture = camera.step(np.ones((16, 64)))
    >>> picture.amplitude.image.shape
    (32, 128)
    """
    one_of("auto", "live", "refined").check("pace", pace)
    name = make_method(method, dict(settings.pop("options", {}))).name
    if isinstance(plan, Burst):  # of which a place may have shown nothing
        template = replace(
            plan, amplitude=np.zeros(plan.amplitude.shape), valid=all_valid(),
            distance_m=None, phasors=None, raw={},
        )  # fmt: skip
    else:
        offset_px = np.asarray(plan, np.float64)
        if offset_px.ndim != 2 or offset_px.shape[1] != 2 or not len(offset_px):
            raise ValueError(f"expected a plan [place 2] of shifts, got shape {offset_px.shape}")
        if shape is None:
            raise ValueError("shape: expected (rows, cols) of the frames")
        template = Burst.from_arrays(
            np.zeros((len(offset_px), *shape)), offset_px=offset_px, pitch_mm=pitch_mm,
            modulation_hz=modulation_hz,
        )  # fmt: skip
    paced: Pace = pace if name == "auto" else "refined"
    return Stream(template, scale, paced, {"method": method} | settings)
