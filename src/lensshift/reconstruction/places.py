"""Of which place of a plan a frame is, and whether the scene of a picture still rests."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike

from lensshift.core.arrays import Mask
from lensshift.core.defects import blank_frames
from lensshift.core.local_means import mean_around
from lensshift.core.types import Burst, Frame, Reconstruction, Status
from lensshift.reconstruction.following import MOST_SIGMAS, Followed, View, views_of
from lensshift.reconstruction.noise import robust_scale
from lensshift.reconstruction.photometry import light_since

# A frame is of another scene where most pixels are farther from the picture than noise and shifts
# explain (`misfit.LIMIT` is that of a solved burst).
CONTRADICTS, MOST = 4.0, 0.5
# With more than this part of the pixels something moves. Noise alone has a mean of nine squares
# beyond four variances at 4e-5 of them.
RESTS = 0.001
# A frame was taken elsewhere on the plan if there it contradicts in less than this part of where it
# does at its own place: what moved contradicts at all of them.
BETTER_PLACE = 0.5
# More noise than before, as under the sun, is in most pixels, and has nothing in common in two that
# lie side by side; of scenes these have a fifth and more. What follows a frame takes a tenth off.
NOISIER, IN_COMMON = 1.5, 0.15
# What a smooth scene contradicts nowhere says its place by all of its pixels together: it lies
# three quarters of the way, and nine times the noise of that way, from where it is expected.
NEARER, WAY_SIGMAS = 0.75, 12.0


@dataclass(frozen=True, slots=True, eq=False)
class Known:
    """A picture that was computed, and what became of it.

    Parameters
    ----------
    followed : as it was computed, and as it followed the frames since
    frames : of which it was computed, by their places
    left : of places, what the picture leaves of their frames
    light : how many times as bright as the picture the frames now are
    dimmed : by how much the noise of its frames may have been made less, with their light
    """

    followed: Followed
    frames: dict[int, Frame]
    left: dict[int, dict[str, View]] = field(default_factory=dict)
    light: float = 1.0
    dimmed: float = 1.0

    @property
    def fits(self) -> bool:
        """Whether its frames do not contradict it."""
        channels = self.followed.solved.channels.values()
        return all(one.status is not Status.CONTRADICTED for one in channels)

    @property
    def noise_sigma(self) -> float:
        """Noise of the light of a frame, or of a component of phasors; at most; 0: not known."""
        light = self.followed.solved.amplitude
        return ((light.noise_sigma if light is not None else None) or 0.0) / self.dimmed

    def beside(self, frame: Frame, at: int) -> tuple[Known, dict[str, View], float]:
        """Return it beside the light of a frame of a place, and what that is `against`.

        A frame that contradicts there may be of another place, and tells its light by that.
        """
        noise = self.noise_sigma * self.dimmed
        known = replace(self, light=light_since(frame, self.frames[at], noise))
        changed, share = known.against(frame, at)
        if share > RESTS and known.light == 1.0:
            others = (light_since(frame, one, noise) for one in self.frames.values())
            known = replace(self, light=next((times for times in others if times != 1.0), 1.0))
            if known.light != 1.0:
                changed, share = known.against(frame, at)
        return known, changed, share

    def against(
        self, frame: Frame, at: int, *, elsewhere: bool = False
    ) -> tuple[dict[str, View], float]:
        """Return what changed since the frame of that place, and what share contradicts.

        By more than that frame did, of which the picture is, and than light that flickers does.
        Of a place that is not the frame's own (`elsewhere`) the picture has to explain all: a frame
        that did not fit there, after a knock, would speak for the next ones.
        """
        views, left = self._views(self.followed.found, frame, at, self.light), self._left(at)
        changed = {name: one.since(left[name]) for name, one in views.items() if name in left}
        if not changed:  # as of a frame without distances
            return {}, MOST
        name, first = next(iter(changed.items()))
        if 2 * np.sum(first.valid) < np.sum(views[name].valid):  # too little was seen before
            return {}, MOST
        squares = views[name].without(first.change).squares
        allowed = first.variance
        if self.fits or not elsewhere:
            allowed = allowed + mean_around(left[name].squares, 3)
        around = mean_around(squares / allowed, 3)
        inner = (slice(1, -1), slice(1, -1)) if min(around.shape) > 2 else (slice(None),) * 2
        return changed, float(np.mean(around[inner] > CONTRADICTS))

    def moved(self, frame: Frame, at: int) -> Mask:
        """Return where [row col] a frame is not that of its place before, of channels any.

        By more than noise and the errors of shifts. What no picture explains is in both.
        """
        views = self._views(self.followed.found, frame, at, self.light)
        moved = np.zeros(frame.valid.shape, np.bool_)
        for name, before in self._left(at).items():
            if name in views:
                now, both = views[name], views[name].valid & before.valid
                step = replace(now, rest=np.where(both, now.rest - before.rest, 0))
                around = mean_around(step.squares / (2 * now.variance), 3)
                moved |= around > CONTRADICTS / self.dimmed**2
        return moved

    def nearest(self, frame: Frame, at: int) -> int:
        """Return the place that a frame is of, `at` unless all of its pixels together say another.

            t = <r, d> / |d|^2,   r the frame less what is expected at `at`, d that of the other

        A frame of the other place has t = 1 and leaves nothing, light that changes t = 0, and a
        camera that was knocked more than there was.
        """
        views = self._views(self.followed.solved, frame, at, self.light)
        name = next(iter(views), None)
        if name is None or name not in self._left(at):
            return at
        here, before, best, nearest = views[name], self._left(at)[name], np.inf, at
        least = (WAY_SIGMAS * here.noise_sigma) ** 2
        if float(np.sum(here.squares - before.squares)) <= least * (NEARER - 0.5):
            return at  # by t > 3 / 4 it would leave more than the frame of before
        for k in self.frames:
            other = self._left(k).get(name)
            if k == at or other is None:
                continue
            there = replace(here, rest=here.rest - (other.seen - here.seen))
            fits = np.minimum(here.squares / here.variance, there.squares / other.variance)
            of = here.valid & other.valid & (fits <= MOST_SIGMAS**2)  # what moved fits neither
            way = np.where(here.valid & other.valid, other.seen - here.seen, 0)
            whole = float(np.sum(np.abs(way) ** 2))
            length = float(np.sum(np.abs(way[of]) ** 2))
            if length <= max(least, NEARER * whole):
                continue
            t = float(np.sum((here.rest * way.conj()).real[of])) / length
            more = float(np.sum(here.squares[of] - before.squares[of]))
            left = float(np.sum(there.squares[of] - other.squares[of]))
            if t > NEARER and left < min(best, (1 - NEARER) * more):
                best, nearest = left, k
        return nearest

    def _views(self, found: Reconstruction, frame: Frame, at: int, light: float) -> dict[str, View]:
        return views_of(found, frame, sorted(self.frames).index(at), light)

    def _left(self, at: int) -> dict[str, View]:
        if at not in self.left:
            self.left[at] = self._views(self.followed.solved, self.frames[at], at, 1.0)
        return self.left[at]


@dataclass(frozen=True, slots=True, eq=False)
class Claim:
    """That frames were lost, as says a frame that fits elsewhere; the next one tells.

    A camera that was knocked does the same: its next frame is no better where the claim expects it.

    Parameters
    ----------
    known : the picture before
    frames : that spoke for it, by their places if none was lost
    counted : the place of the next one if none was lost
    """

    known: Known
    frames: dict[int, Frame]
    counted: int

    def also(self, frame: Frame) -> Claim:
        """Return the claim with a frame that speaks for it."""
        frames = self.frames | {self.counted: frame}
        return replace(self, frames=frames, counted=(self.counted + 1) % len(self.known.frames))

    def tells(self, frame: Frame, at: int, light: float) -> bool | None:
        """Return whether the next frame is where the claim expects it; None: it does not say.

        As one after another loss does not. Nothing loses frames for a whole round.

        Parameters
        ----------
        light : how many times as bright as the picture it is
        """
        known = replace(self.known, light=light)
        if len(self.frames) == len(known.frames):
            return False
        shares = {k: known.against(frame, k, elsewhere=True)[1] for k in known.frames}
        nearest = known.nearest(frame, self.counted)
        if nearest == at or RESTS < shares[self.counted] * BETTER_PLACE >= shares[at]:
            return True
        if max(shares[at], shares[self.counted]) <= RESTS:
            return False if nearest == self.counted else None
        return None if min(shares.values()) <= RESTS else False


def is_noisier(changed: dict[str, View]) -> bool:
    """Tell whether what changed in a frame is no other scene, but more noise than expected.

        MAD z > 1.5 that of noise,   |Re sum z z'*| < 0.15 sum |z|^2

    With z what is left beside what a picture follows, in units of its deviation, and z' its
    neighbour, along rows and along columns.
    """
    first = next(iter(changed.values()), None)
    if first is None or not first.valid.any():
        return False
    left = first.without(first.change)
    z = left.rest / np.sqrt(left.variance)
    most = IN_COMMON * float(np.sum(np.abs(z) ** 2))
    of_pairs = ((z[1:], z[:-1]), (z[:, 1:], z[:, :-1]))
    alone = all(abs(float(np.sum((a * b.conj()).real))) < most for a, b in of_pairs)
    return alone and robust_scale(z[left.valid]) > NOISIER


def frame_of(values: Frame | ArrayLike) -> Frame:
    """Return a frame, or its amplitudes or phasors [row col]; valid at most where it is finite."""
    if isinstance(values, Frame):
        far_m = 0.0 if values.distance_m is None else values.distance_m
        known = np.isfinite(values.amplitude) & np.isfinite(far_m)
        return values if known.all() else replace(values, valid=values.valid & known)
    amplitude = np.asarray(values)
    if amplitude.ndim != 2 or amplitude.dtype.kind not in "uifc":
        raise ValueError(
            f"expected numbers [row col], got {amplitude.dtype} of shape {amplitude.shape}"
        )
    return Frame(amplitude, None, np.isfinite(amplitude), float("nan"))


def is_blank(frame: Frame) -> bool:
    """Tell whether all valid pixels of a frame are alike."""
    return bool(blank_frames(frame.amplitude[None], frame.valid[None])[0])


def burst_of(template: Burst, places: list[int], frames: list[Frame]) -> Burst:
    """Return the frames of some places as a burst."""
    having = [one.distance_m for one in frames if one.distance_m is not None]
    part = template if len(places) == template.frame_count else template.select(places)
    return replace(
        part,
        amplitude=np.stack([one.amplitude for one in frames]),
        distance_m=np.stack(having) if len(having) == len(frames) else None,
        valid=np.stack([one.valid for one in frames]),
        time_s=None, raw={}, phasors=None,
    )  # fmt: skip
