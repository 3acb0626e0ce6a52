"""How a picture of a scene that rests follows a new frame, in closed form.

What the frames told of detail stays; how bright it is, and how far away, the newest frame says over
some pixels, so that light that flickers, warms up or sinks, and a camera that drifts, are followed
at once. Frames that show other detail are for a solver: `Stream` asks it when they come.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any

import numpy as np

from lensshift.core.arrays import Array, Floats
from lensshift.core.local_means import gaussian_around, mean_around
from lensshift.core.types import Estimate, Frame, Reconstruction
from lensshift.core.units import PhaseScale, unambiguous_range_m
from lensshift.forward.differences import image_slopes
from lensshift.forward.model import ForwardModel
from lensshift.forward.operator import single
from lensshift.forward.prediction import FramePredictor, PhasorPredictor
from lensshift.reconstruction.displacement import ALLOWED_SHIFT_PX, WINDOW_PX
from lensshift.reconstruction.learned.phasors import LOW_PASS_PX, NO_PHASE_RAD

# What is off by more standard deviations counts as if it were off by so many (Huber).
MOST_SIGMAS = 3.0
# Over so many pixels, some three of its means along each side, a change is told from noise.
AROUND_PX = 9
# Of the largest weight: where no pixel is believed nothing is known to change.
LEAST_WEIGHT = 1e-9
TINY = np.finfo(np.float64).tiny  # where a sum that is divided by may be 0


@dataclass(frozen=True, eq=False)
class View:
    """A frame beside what a picture lets expect of it.

    Parameters
    ----------
    model : how the picture becomes this frame, the only one of the model
    seen : [row col] the frame that it predicts
    rest : [row col] by how much the frame is more; 0 where it is not valid
    valid : [row col]
    noise_sigma : noise of an LR pixel, of a component of phasors
    """

    model: ForwardModel
    seen: Array
    rest: Array
    valid: Array
    noise_sigma: float

    @property
    def components(self) -> int:
        """2 for phasors, else 1."""
        return 2 if np.iscomplexobj(self.seen) else 1

    @property
    def squares(self) -> Floats:
        """[row col] squared residual of a component."""
        return np.asarray(self.rest.real**2 + self.rest.imag**2) / self.components

    @cached_property
    def variance(self) -> Floats:
        """[row col] what noise and errors of the shifts leave in a component."""
        steep = sum(np.abs(slope) ** 2 for slope in image_slopes(self.seen))
        of_shifts = ALLOWED_SHIFT_PX**2 / self.components * np.asarray(steep)
        return np.maximum(self.noise_sigma**2 + of_shifts, TINY)

    @property
    def basis(self) -> Array:
        """[row col] what there may be more of: phasors, or a level of light or distances alone."""
        return self.seen if self.components == 2 else np.full_like(self.seen, self.model.gain[0])

    def since(self, before: View) -> View:
        """Return what changed since a frame of the same place, which the picture explained so far.

            r' - r <r', r> / <r, r>,   the share within 0 .. 1, over 5 x 5 pixels

        What no picture explains, as errors of the shifts, is in both frames; their noise is not.
        """
        both = (self.rest * before.rest.conj()).real / self.components
        share = mean_around(both, WINDOW_PX) / (mean_around(before.squares, WINDOW_PX) + TINY)
        share, valid = np.clip(share, 0, 1), self.valid & before.valid
        return replace(self, rest=np.where(valid, self.rest - share * before.rest, 0), valid=valid)

    @cached_property
    def _told(self) -> tuple[Array, Floats, Floats]:
        """c, |c|^2 around it less t^2, and t^2, as in `change`; of a component, [row col]."""
        left = self
        for _ in range(2):  # light that sinks is far off all over, until it is taken off
            size = np.sqrt(left.squares / self.variance)
            weight = np.minimum(1.0, MOST_SIGMAS / np.maximum(size, 1e-12)) / self.variance
            weight *= self.valid
            known = gaussian_around(weight * np.abs(self.basis) ** 2, LOW_PASS_PX)
            of_basis = gaussian_around(weight * np.conj(self.basis) * self.rest, LOW_PASS_PX)
            least = max(LEAST_WEIGHT * float(known.max()), TINY)
            c = np.where(known > least, of_basis / np.maximum(known, least), 0)
            left = self.without(c)
        noise = 1 / (4 * math.pi * LOW_PASS_PX**2 * np.maximum(known, least))
        return c, mean_around(np.abs(c) ** 2, AROUND_PX) / self.components - noise, noise

    @property
    def _share(self) -> Floats:
        """[row col] as much of c as is more than noise (James and Stein)."""
        _, more, noise = self._told
        return np.asarray(np.maximum(more, 0) / (np.maximum(more, 0) + noise))

    @cached_property
    def change(self) -> Array:
        """[row col] by how much of the basis the frame is more, over the pixels around.

            c = G (w b* r) / G (w |b|^2),   w = min(1, 3 s / |r - c b|) / s^2,   twice from c = 0
            c <- c q,   q = max(0, 1 - t^2 / mean |c|^2),   1 / t^2 = 4 pi g^2 G (w |b|^2)

        G a Gaussian low pass of width g, r what is left, s^2 its variance; t^2 that of c, of which
        as much is taken as is more than noise over 9 x 9 pixels.
        """
        return np.asarray(self._told[0] * self._share)

    def unsure(self, before: Floats | float) -> Floats:
        """Return the variance [row col] of a component of what a picture now is of the basis.

            v <- (q^2 t^2 + (1 - q)^2 max(mean |c|^2 - t^2, v)) / |1 + c|^2

        The noise of what was taken, and what was left; a frame that is taken whole forgets those
        before. Of phasors v is that of a factor of the picture, which has changed by 1 + c.

        Parameters
        ----------
        before : [row col] that before this frame
        """
        _, more, noise = self._told
        left = self._share**2 * noise + (1 - self._share) ** 2 * np.maximum(more, before)
        factor = np.abs(1 + self.change) ** 2 if self.components == 2 else 1.0
        return np.asarray(left / np.maximum(factor, TINY))

    def without(self, change: Array) -> View:
        """Return what is left beside a picture that has changed so."""
        return replace(self, rest=np.where(self.valid, self.rest - change * self.basis, 0))


def views_of(
    found: Reconstruction, frame: Frame, number: int, light: float = 1.0
) -> dict[str, View]:
    """Return what the channels expect beside what the frame shows; "phasor" if these are phasors.

    Nothing of what it does not show.

    Parameters
    ----------
    number : of the frame among those of the picture
    light : how many times as bright as the picture the frame is, by which it is divided; its noise
        as well where it is darker (that of light grows with it)
    """
    if light != 1.0:
        frame = replace(frame, amplitude=frame.amplitude / light)
    noise = 1.0 / min(light, 1.0)
    if (phasors := _as_phasors(found)) is not None:
        bright, _, scale = phasors
        z = _phasor_of(frame, scale)
        return {} if z is None else {"phasor": _view(bright, z, frame, number, noise)}
    shown = {"amplitude": frame.amplitude, "distance": frame.distance_m}
    return {
        name: _view(one, values, frame, number, noise if name == "amplitude" else 1.0)
        for name, one in found.channels.items()
        if (values := shown[name]) is not None
    }


@dataclass(frozen=True, slots=True, eq=False)
class Followed:
    """A picture that was computed, and what became of it.

    Parameters
    ----------
    solved : as it was computed
    found : as it followed the frames since
    unsure : variance [row col] of what it followed, by the names of its views; see `View.unsure`
    """

    solved: Reconstruction
    found: Reconstruction
    unsure: Mapping[str, Floats] = field(default_factory=dict)

    def by(self, views: dict[str, View]) -> Followed:
        """Return it as bright, and as far away, as a frame of a scene that rests shows it.

            x <- x + b A^T c / A^T 1,   c as `View.change`

        Of light or distances alone b is 1: what is added to all that is seen comes back. Of phasors
        b = x: all around shares one factor, so that a dark surface keeps its distance beside a
        bright one.

        Parameters
        ----------
        views : what changed in that frame
        """
        unsure = {name: one.unsure(self.unsure.get(name, 0.0)) for name, one in views.items()}
        unsure = dict(self.unsure) | unsure
        channels: dict[str, Estimate] = dict(self.found.channels)
        if (phasors := _as_phasors(self.found)) is not None:
            channels["amplitude"], channels["distance"] = _with_gain(*phasors, views["phasor"])
        else:
            least = 0.0 if self.found.settings.get("non_negative") else -np.inf
            for name, view in views.items():
                channels[name] = _raised(channels[name], _change(view), least)
        for name, one in channels.items():
            of = unsure.get("phasor" if phasors else name)
            before = self.solved.channels[name]
            if of is not None and before.uncertainty is not None:
                bare = replace(one, uncertainty=None)  # else each holds all those before
                channels[name] = replace(one, uncertainty=partial(_std_of, before, bare, of))
        found = replace(
            self.found, amplitude=channels.get("amplitude"), distance_m=channels.get("distance")
        )
        return replace(self, found=found, unsure=unsure)


def brighter(found: Reconstruction, times: float) -> Reconstruction:
    """Return a picture in another light: its amplitude, with the std, is so many times as large."""
    one = found.amplitude
    if one is None or times == 1.0:
        return found
    predict: Any = one.predict
    frames = _predictor_of(one)
    lit = replace(frames, image=frames.image * times, bias=frames.bias * times)
    return replace(
        found,
        amplitude=replace(
            one,
            image=one.image * times,
            fine=None if one.fine is None else one.fine * times,
            uncertainty=None if one.uncertainty is None else partial(_std_times, one, times),
            predict=replace(predict, phasor=lit) if isinstance(predict, PhasorPredictor) else lit,
        ),
    )


def _std_times(one: Estimate, times: float) -> Floats:
    return np.asarray(one.std) * times


def _std_of(solved: Estimate, one: Estimate, unsure: Floats) -> Floats:
    """Return the std of a picture that followed: that of its detail, and of what it followed.

    Detail of light that a factor changed is as many times as sure.
    """
    times = one.image.shape[0] // unsure.shape[0]
    followed = np.sqrt(unsure).repeat(times, axis=0).repeat(times, axis=1)
    std = np.asarray(solved.std)
    scale = one.predict.distance if isinstance(one.predict, PhasorPredictor) else None
    if scale is not None:
        most_m = NO_PHASE_RAD / scale.rad_per_m
        return np.asarray(np.minimum(np.hypot(std, followed / scale.rad_per_m), most_m))
    if isinstance(one.predict, PhasorPredictor) or np.iscomplexobj(one.image):
        light, before = np.abs(one.image), np.abs(solved.image)
        std = std * np.divide(light, before, out=np.ones_like(light), where=before > 0)
        followed = followed * light
    return np.asarray(np.hypot(std, followed))


def _view(one: Estimate, values: Array, frame: Frame, number: int, noise: float) -> View:
    predictor = _predictor_of(one)
    model = predictor.model_of(number)
    seen = model.predict(predictor.image)[0]
    valid = frame.valid & model.inside[0]
    if predictor.stray_light is not None:
        values = predictor.stray_light.removed(np.where(valid, values, 0))
    rest = np.where(valid, values - seen, 0)
    return View(model, seen, rest, valid, noise * (one.noise_sigma or 0.0))


def _predictor_of(one: Estimate) -> FramePredictor:
    found = one.predict.phasor if isinstance(one.predict, PhasorPredictor) else one.predict
    if not isinstance(found, FramePredictor):
        raise TypeError(f"expected an estimate that `reconstruct` returned, got {found!r:.60}")
    return found


def _as_phasors(found: Reconstruction) -> tuple[Estimate, Estimate, PhaseScale] | None:
    """Return amplitude, distance and how phases stand for it, if both were found together."""
    light, far = found.amplitude, found.distance_m
    if light is None or far is None or not isinstance(far.predict, PhasorPredictor):
        return None
    scale = far.predict.distance
    return None if scale is None else (light, far, scale)


def _phasor_of(frame: Frame, scale: PhaseScale) -> Array | None:
    """Return the phasors [row col] of a frame, turned as those of the picture are."""
    far_m = 0.0 if np.iscomplexobj(frame.amplitude) else frame.distance_m
    if far_m is None:
        return None
    away_m = np.where(frame.valid, far_m, 0.0) - scale.reference_m
    z = np.where(frame.valid, frame.amplitude, 0)
    return np.asarray(z * np.exp(1j * scale.rad_per_m * away_m))


def _change(view: View) -> Array:
    """Return the change [row col] on the grid of the picture."""
    A = view.model.operator
    every = A.adjoint(single(np.ones((1, *view.seen.shape))))
    return np.asarray(A.adjoint(single(view.change[None])) / np.maximum(every, LEAST_WEIGHT))


def _raised(one: Estimate, change: Array, least: float) -> Estimate:
    """Return the estimate with a change that was found on the grid of its predictor."""
    predictor = _predictor_of(one)

    def raised(image: Array) -> Array:
        here = _on_grid_of(image, change)
        # Complex images that are no light and distance: of these it is a factor as well.
        moved = image * (1 + here) if np.iscomplexobj(image) else np.maximum(image + here, least)
        return np.asarray(moved)

    return replace(
        one,
        image=raised(one.image),
        fine=None if one.fine is None else raised(one.fine),
        predict=replace(predictor, image=raised(predictor.image)),
    )


def _with_gain(
    light: Estimate, far: Estimate, scale: PhaseScale, view: View
) -> tuple[Estimate, Estimate]:
    """Return amplitude and distance of phasors times a local factor."""
    gain, predictor = 1 + _change(view), _predictor_of(light)
    phasor = replace(predictor, image=predictor.image * gain)
    coarse = _on_grid_of(light.image, gain)
    brighter = replace(
        light,
        image=light.image * np.abs(coarse),
        fine=None if light.fine is None else light.fine * np.abs(gain),
        predict=PhasorPredictor(phasor),
    )
    farther = replace(
        far,
        image=_farther(far.image, coarse, scale),
        fine=None if far.fine is None else _farther(far.fine, gain, scale),
        predict=PhasorPredictor(phasor, scale),
    )
    return brighter, farther


def _farther(image_m: Floats, gain: Array, scale: PhaseScale) -> Floats:
    """Return distances whose phases are turned by those of a gain."""
    found_m = image_m + np.angle(gain) / scale.rad_per_m
    return np.mod(found_m, unambiguous_range_m(scale.modulation_hz)) if scale.circular else found_m


def _on_grid_of(image: Array, values: Array) -> Array:
    """Return the means of the values on the smaller pixels of an image."""
    rows, cols = image.shape
    times = math.isqrt(values.size // image.size)
    if times == 1:
        return values
    return np.asarray(values.reshape(rows, times, cols, times).mean(axis=(1, 3)))
