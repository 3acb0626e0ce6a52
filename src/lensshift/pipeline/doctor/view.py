"""What the camera shows while the lens stands still: light, noise, texture, losses."""

from __future__ import annotations

import time
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lensshift.capture.rig import Camera, CameraFrame
from lensshift.core.arrays import Array, Floats, Mask
from lensshift.core.defects import copied_frames
from lensshift.optics.actuator import PIXEL_NOISE
from lensshift.pipeline.doctor.findings import Finding, Level
from lensshift.registration.gradient import texture_covariance

LOOKED_S, LEAST_FRAMES, MOST_FRAMES = 2.0, 16, 64  # enough to tell noise to a fifth
# The mean of frames at a position shall tell its shift to this: a fifth of what is wanted of a
# calibration, so that 35 positions leave its model room.
WANTED_PX = 0.004
LEAST_AVERAGES, MOST_AVERAGES = 2, 64  # one may be a frame that is out of the ordinary
# What a scene with texture gives: with this much light its shifts are known.
_FAIR_SNR = 50.0
_MOST_LOST = 1 / 3  # then everything takes half as long again
_CHANCE = 0.01  # that a camera which is well is said to switch
_MOST_INVALID = 0.5  # half of the pixels see nothing
# Changes that are slow are beyond noise where they are this many times what differs from frame to
# frame: of 16 frames of white noise one pixel in 700 seems to.
_SLOW = 1.5
_FEW_MOVE, _MANY_MOVE = 0.01, 0.05  # of the pixels: more than chance, and a calibration is spoilt
_OFTEN, _FEW_CLIPPED = 0.5, 0.01  # of the frames that show a pixel so, and of the pixels


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """Frames of a camera behind a lens that stands still."""

    amplitude: Floats  # [frame row col]
    valid: Mask  # the same
    rate_hz: float  # by the camera's own counter
    lost_share: float  # of the frames that the camera counted
    snr: float  # median over the pixels of mean over noise in time
    sigma_px: Floats  # [2] how well one frame tells a shift along (row, col)
    brightness_jump: float  # rms change between frames that noise does not explain
    settings_share: float  # of the pixels whose amplitude depends on the exposure that they chose
    copies: int = 0  # frames that are another one bit by bit, noise and all
    empty: int = 0  # frames beside these without a valid pixel that is not 0
    moving_share: float = 0.0  # of the pixels that change as neither noise nor drift does
    clipped_share: float = 0.0  # of the pixels that stand at the largest value there is

    @property
    def averages_needed(self) -> float:
        """How many frames have a mean that tells the shift well enough."""
        return float(max(np.max(self.sigma_px / WANTED_PX) ** 2, 1.0))

    @property
    def jumps(self) -> bool:
        """Whether frames differ in brightness more than a calibration may overlook."""
        return self.brightness_jump > PIXEL_NOISE  # which `calibrate_rig` assumes

    @property
    def numbers(self) -> dict[str, Any]:
        """What a page or a program is told."""
        return {
            "rate_hz": self.rate_hz,
            "lost_share": self.lost_share,
            "valid_share": float(self.valid.mean()),
            "snr": self.snr,
            "shift_sigma_px": self.sigma_px,
            "brightness_jump": self.brightness_jump,
            "empty_frames": self.empty,
            "moving_share": self.moving_share,
            "clipped_share": self.clipped_share,
        }


def look(camera: Camera, patience_s: float) -> View:
    """Take frames for two seconds, 16 at least; DeviceError if the camera does not send them."""
    frames = [camera.next_frame(patience_s)]
    end_s = time.monotonic() + LOOKED_S
    while len(frames) < LEAST_FRAMES or time.monotonic() < end_s:
        frames.append(camera.next_frame(patience_s))
        if len(frames) >= MOST_FRAMES:
            break
    cycles = frames[-1].cycle - frames[0].cycle
    seconds = frames[-1].arrived_s - frames[0].arrived_s
    rate_hz = cycles / seconds if seconds > 0 else 0.0
    lost_share = 1.0 - (len(frames) - 1) / cycles if cycles > 0 else 0.0
    told = [one for one in frames if np.any(one.frame.amplitude[_seen(one)])] or frames
    amplitude = np.stack([one.frame.amplitude for one in told]).astype(np.float64)
    valid = np.stack([_seen(one) for one in told])
    always = np.asarray(valid.all(axis=0))
    dark = View(
        amplitude, valid, rate_hz=rate_hz, lost_share=lost_share, snr=0.0,
        sigma_px=np.full(2, np.inf), brightness_jump=0.0,
        settings_share=settings_share([one.raw for one in told], amplitude, always),
        copies=len(copied_frames(amplitude)), empty=len(frames) - len(told),
    )  # fmt: skip
    # A pixel that reads nothing at all is a dead one, and no measure of gain and noise.
    lit = always & (np.median(np.where(always, amplitude, 0.0), axis=0) > 0.0)
    return _measured(dark, lit) if lit.any() and len(told) > 1 else dark


def _seen(shot: CameraFrame) -> Mask:
    return np.asarray(shot.frame.valid & np.isfinite(shot.frame.amplitude))


def _measured(view: View, lit: Mask) -> View:
    """Return a view with what its lit pixels [row col] tell of light, noise, texture, motion."""
    amplitude = view.amplitude
    mean = np.where(lit, amplitude.mean(axis=0), 0.0)
    gain = np.array([np.median(one[lit] / mean[lit]) for one in amplitude])
    flat = amplitude / np.where(gain > 0.0, gain, 1.0)[:, None, None]  # a half may be covered
    noise = np.std(np.diff(flat, axis=0), axis=0) / np.sqrt(2.0)
    snr = float(np.median(mean[lit] / np.maximum(noise[lit], 1e-12 * mean.max())))
    # The median of so many pixels scatters by itself.
    chance2 = 0.5 * np.pi / (snr**2 * np.count_nonzero(lit))
    jump = float(np.sqrt(max(np.var(gain) - 4.0 * chance2, 0.0)))
    sigma = float(np.sqrt(np.mean(noise[lit] ** 2)))
    plain = np.where(lit, flat, np.mean(mean[lit]))
    known = np.broadcast_to(lit, plain.shape)
    covariance = texture_covariance(plain, known, np.zeros((len(plain), 2)), sigma)
    sigma_px = np.sqrt(np.diagonal(covariance))
    largest = amplitude[:, lit] == amplitude[:, lit].max()
    clipped = float(np.mean(largest.mean(axis=0) > _OFTEN)) if sigma > 0.0 else 0.0
    moving = _moving_share(flat[:, lit], noise[lit], float(np.median(mean[lit])))
    return replace(
        view, snr=snr, sigma_px=sigma_px, brightness_jump=jump, moving_share=moving,
        clipped_share=clipped,
    )  # fmt: skip


def _moving_share(flat: Floats, noise: Floats, usual: float) -> float:
    """Return the share of pixels [frame pixel] that change slowly, by more than a drift.

    What differs from frame to frame is noise, a steady drift changes each pixel in proportion to
    time. What is left beside both has moved: somebody walks by, the bench was touched.
    """
    time = np.linspace(-1.0, 1.0, len(flat))[:, None]
    slope = np.sum(time * flat, axis=0) / np.sum(time**2)
    left2 = np.var(flat - slope * time, axis=0)
    return float(np.mean(left2 > np.maximum(_SLOW * noise, PIXEL_NOISE * usual) ** 2))


def settings_share(raw: list[Mapping[str, Array]], amplitude: Floats, always: Mask) -> float:
    """Return the share of pixels whose amplitude depends on exposure and gain, as an O3M tells.

    A camera takes the more sensitive setting where it does not saturate: of one and the same light
    what noise makes weaker. A normal distribution of variance s^2, cut at a limit with the share p
    on one side, has means on both sides that differ by s phi(z) / (p (1 - p)), z = Phi^-1(p), and
    leaves s^2 (1 - phi(z)^2 / (p (1 - p))) about them; so much less may the sensitive setting read.
    """
    if not all({"confidence", "normalization"} <= set(one) for one in raw):
        return 0.0
    setting = (np.stack([one["confidence"] for one in raw]).astype(int) >> 1) & 3
    factor = raw[0]["normalization"]  # the smaller, the more sensitive
    pixels = np.argwhere(always & np.any(setting != setting[0], axis=0))
    differing = 0
    for row, col in pixels:
        here, values = setting[:, row, col], amplitude[:, row, col]
        groups = {one: values[here == one] for one in np.unique(here)}
        told = sorted((one for one in groups if len(groups[one]) > 2), key=lambda one: factor[one])
        if len(told) == 2:
            first, second = (groups[one] for one in told)
            chosen = factor[told[0]] < factor[told[1]]
            differing += _differ(first, second, chosen, len(pixels))
    return differing / always.size


def _differ(first: Floats, second: Floats, chosen: bool, asked: int) -> bool:
    """Tell whether readings differ, by more than chance and the choice of the first, of so many."""
    from scipy.special import ndtri
    from scipy.stats import ttest_ind

    if chosen:
        count = len(first) + len(second)
        share = len(first) / count
        both = share * (1.0 - share)
        height = np.exp(-0.5 * ndtri(share) ** 2) / np.sqrt(2.0 * np.pi)
        within2 = (len(first) * first.var() + len(second) * second.var()) / (count - 2)
        apart = np.sqrt(within2 / (1.0 - height**2 / both)) * height / both
        first = first + np.clip(second.mean() - first.mean(), 0.0, apart)
    if abs(first.mean() - second.mean()) <= PIXEL_NOISE * second.mean():
        return False
    # Each with its own noise (Welch), or all alike (Student), whichever is more: three values may
    # lie close together by chance.
    with warnings.catch_warnings(action="ignore"):  # of those that are all equal
        odds = [ttest_ind(first, second, equal_var=one).pvalue for one in (True, False)]
    return bool(max(odds) < _CHANCE / asked)


def view_findings(
    view: View, counts: Mapping[str, int], known: Mapping[str, Any]
) -> Iterator[Finding]:
    """Yield what is wrong with light, scene and network, by what the camera counted and is."""
    yield from _still_findings(view)  # first: who walks by hides light and texture
    invalid = 1.0 - float(view.valid.mean())
    poor = view.averages_needed > MOST_AVERAGES
    along = ("rows", "columns")[int(np.argmax(view.sigma_px))]
    # The error of a shift goes with noise over texture: with fair light, would it do?
    fair = view.averages_needed * min(view.snr / _FAIR_SNR, 1.0) ** 2 <= MOST_AVERAGES
    if invalid > _MOST_INVALID or view.snr == 0.0 or (poor and fair):
        said = f"SNR {view.snr:.1f} of a pixel, {100 * invalid:.0f} % of the pixels are invalid"
        cure = "go nearer, take a brighter scene, longer exposure"
        bright = invalid > _MOST_INVALID and view.snr > _FAIR_SNR  # what is seen is not dark
        if bright:
            cure = "too bright there, or out of reach? shorter exposure, all of the scene in range"
        yield Finding(Level.FAULT, "invalid pixels" if bright else "too dark", said, cure)
    elif poor:
        said = (
            f"the scene tells shifts across the {along} to {view.sigma_px.max():.2f} px a frame, "
            f"{MOST_AVERAGES} frames are not enough"
        )
        cure = "put a chart with edges in several directions into the view"
        yield Finding(Level.FAULT, "no texture", said, cure)
    if view.lost_share > _MOST_LOST:
        said = f"{100 * view.lost_share:.0f} % of the frames do not arrive whole"
        if "receive_buffer_bytes" in known:
            said += f" (buffer granted: {known['receive_buffer_bytes'] / 2**20:.1f} MiB)"
        cure = "direct cable; sudo sysctl -w net.core.rmem_max=4194304"
        yield Finding(Level.DOUBT, "losses", said, cure)
    if view.copies:
        count = len(view.amplitude)
        said = f"{view.copies} of {count} frames are copies of others, noise and all"
        cure = "have each picture taken anew: one that is handed out again may be of another place"
        level = Level.FAULT if view.copies == count - 1 else Level.DOUBT
        yield Finding(level, "same picture", said, cure)
    if view.jumps or view.settings_share > 0.0:
        said = f"brightness jumps by {100 * view.brightness_jump:.1f} % from frame to frame"
        if not view.jumps:
            share = 100 * view.settings_share
            said = f"{share:.1f} % of the pixels change their amplitude with their exposure"
        cure = "fix exposure and gain; daylight or a flickering lamp in the view"
        yield Finding(Level.DOUBT, "exposure switching", said, cure)
    strangers = counts.get("foreign_packets", 0) + counts.get("other_cameras_packets", 0)
    if strangers:
        who = known.get("another_camera") or known.get("other_sender") or "unknown"
        said = f"{strangers} datagrams came to the camera's port from elsewhere ({who})"
        cure = 'end it, or write source = "ADDRESS OF THE CAMERA" in [camera]'
        yield Finding(Level.DOUBT, "foreign sender", said, cure)


def _still_findings(view: View) -> Iterator[Finding]:
    """Yield what a scene and a camera at rest would not show."""
    if view.empty:
        said = f"{view.empty} of {view.empty + len(view.valid)} frames show nothing"
        cure = "look at trigger, exposure and shutter; what does the camera say of them?"
        yield Finding(Level.DOUBT, "empty frames", said, cure)
    if view.moving_share > _FEW_MOVE and not view.jumps:  # of the light, which change all
        level = Level.FAULT if view.moving_share > _MANY_MOVE else Level.DOUBT
        said = f"{100 * view.moving_share:.0f} % of the pixels change while the lens stands still"
        cure = "let nothing move in the view; clamp camera and bench; no lamp but the camera's"
        yield Finding(level, "moving scene", said, cure)
    if view.clipped_share > _FEW_CLIPPED:
        said = f"{100 * view.clipped_share:.0f} % of the pixels stand at the largest value"
        cure = "shorter exposure, less gain, farther away: edges of saturated areas seem to move"
        yield Finding(Level.DOUBT, "saturated", said, cure)
