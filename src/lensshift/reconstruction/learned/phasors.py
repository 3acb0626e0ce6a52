"""What is added to a picture of phasors: means of its frames, and what other weights see in them.

Phasors of one surface have one phase, and along it they are light that pixels average; small
phases are averaged as well. The weights for phasors were trained where surfaces mix, and draw fine
texture and steps soft; those for brightness know both, but no mixtures. Which of the two is right
at a place, its frames say.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lensshift.core.arrays import Array, Floats
from lensshift.core.local_means import gaussian_around, mean_around
from lensshift.core.order import median
from lensshift.core.units import within_half_a_turn
from lensshift.forward.operator import LinearOperator, mean_seen, single
from lensshift.reconstruction.displacement import ALLOWED_SHIFT_PX, WINDOW_PX, slopes_of
from lensshift.reconstruction.learned.finer import means, seen_finer, std_of_means
from lensshift.reconstruction.learned.opinions import amplitude_of_both, phase_of_both
from lensshift.reconstruction.learned.pooling import pooled_phase
from lensshift.reconstruction.learned.reach import Reach
from lensshift.reconstruction.learned.solver import Asked, Solution
from lensshift.reconstruction.learned.unseen import LEAST_SEEN
from lensshift.reconstruction.problem import LEAST_SHARE_OF_LIGHT

# Width of a mean, LR pixels, that is left to the frames: some 30 pixels of each. The noise of white
# frames through 2 g - g * g, g a Gaussian of width s, is this over 4 pi s^2.
LOW_PASS_PX, OF_TWO_PASSES = 1.5, 11 / 6
# Of the amplitude that it had, so that a phase is left where light was drawn below none.
LEAST_LEFT = 1e-3
TINY = 1e-12
# Standard deviation of a phase that may be anything.
NO_PHASE_RAD = float(np.pi / np.sqrt(3.0))


def finished(
    asked: Asked, found: Solution, scale: int, solve: Callable[[Asked], Solution]
) -> Solution:
    """Return the picture with the means of its frames, phases pooled, and a second opinion of both.

    Parameters
    ----------
    asked : frames of phasors
    found : their picture
    scale : HR pixels per LR pixel
    solve : finds the picture of frames
    """
    weight = found.weight / np.where(np.isfinite(asked.sigma), asked.sigma, np.inf) ** 2
    image, of_means = with_means_of(
        asked.model.operator, found.image, asked.y, weight, LOW_PASS_PX * scale
    )
    asked = replace(asked, on_stage=None)
    along, across = np.hypot(found.std[:2], of_means)
    ratio, along = _second_amplitude(asked, image, along, scale, solve)
    image = image * ratio
    size = np.maximum(np.abs(image), TINY)
    own, shared = (np.minimum(part / size, NO_PHASE_RAD) for part in (across, of_means))
    reach = Reach.of(asked.y, np.isfinite(asked.sigma), asked.model.mean_offset_px, scale)
    # What no mixture around has is no guess at a surface: it takes those of pixels it looks like.
    phase, own = reach.hold(np.angle(image), own)
    image, own = size * np.exp(1j * phase), np.minimum(own, NO_PHASE_RAD)
    phase, of_phase = pooled_phase(image, along, own, shared, mean_hr_px(scale))
    image = size * np.exp(1j * phase)
    phase, of_phase = reach.hold(*_second_phase(asked, image, of_phase, scale, solve))
    return replace(found, image=size * np.exp(1j * phase), std=np.stack([along, of_phase * size]))


def with_finer_amplitude(
    asked: Asked, found: Solution, scale: int, solve: Callable[[Asked], Solution]
) -> Solution:
    """Return the finished picture with amplitudes of smaller pixels, if these predict better.

    Phases stay: they change less over a surface, and at its edges smaller pixels tell less of them.
    """
    asked_light, turn = _along(asked, found.image)
    finer = seen_finer(asked_light, solve)
    if finer is None:
        return found
    light = solve(finer)
    a = np.abs(found.image)
    b = np.maximum(means(light.image), LEAST_LEFT * a)
    unit = found.image / np.maximum(a, TINY)
    seen = turn * finer.model.operator.forward(single(light.image))
    evidence = _evidence(asked, found.image, unit * b, scale, seen)
    mean, along = amplitude_of_both(a, b, found.std[0], std_of_means(light.std), evidence)
    return replace(found, image=mean * unit, std=np.stack([along, found.std[1]]))


def with_means_of(
    A: LinearOperator, image: Array, y: Array, weight: Array, low_hr_px: float
) -> tuple[NDArray[np.complex128], Floats]:
    """Return phasors whose local means agree with the frames, and the std that those leave.

        x <- x + G A^T W (y - A x) / G A^T W 1,   twice;   G a Gaussian low pass of width s
        std^2 = 11/6 / (4 pi s^2  G A^T W 1)

    The prior has the last word of a phasor, and draws a dark surface a little to the bright ones
    around it. Over many pixels the frames know better, whatever the errors of the shifts.

    Parameters
    ----------
    weight : [frame row col] inverse variance, 0 where a pixel is not believed
    low_hr_px : width of the low pass
    """
    y, weight = single(y), single(weight)
    known = gaussian_around(A.adjoint(weight), low_hr_px)
    least = 1e-9 * float(known.max())
    seen, known = known > least, np.maximum(known, least)
    for _ in range(2):
        rest = A.adjoint(weight * (y - A.forward(single(image))))
        image = image + gaussian_around(rest, low_hr_px) / known
    of_noise = OF_TWO_PASSES / (4 * math.pi * low_hr_px**2)
    return np.asarray(image), np.where(seen, np.sqrt(of_noise / known), 0.0)


def mean_hr_px(scale: int) -> float:
    """Return how many HR pixels of white noise a mean of `with_means_of` is as good as."""
    return 4 * math.pi * (LOW_PASS_PX * scale) ** 2 / OF_TWO_PASSES


def _second_amplitude(
    asked: Asked, image: Array, std: Array, scale: int, solve: Callable[[Asked], Solution]
) -> tuple[Floats, Floats]:
    """Return amplitudes over those of the picture, and their std: the mean over two pictures."""
    light = solve(_along(asked, image)[0])
    a = np.abs(image)
    b = np.maximum(light.image, LEAST_LEFT * a)
    evidence = _evidence(asked, image, image * (b / np.maximum(a, TINY)), scale)
    mean, std = amplitude_of_both(a, b, std, light.std, evidence)
    return mean / np.maximum(a, TINY), std


def _along(asked: Asked, image: Array) -> tuple[Asked, Array]:
    """Return the light of frames along the phase of the picture, and that phase as a factor."""
    seen = asked.model.operator.forward(single(image))
    turn = seen / np.maximum(np.abs(seen), TINY)
    light = np.where(np.isfinite(asked.sigma), (asked.y * turn.conj()).real, 0.0)
    return replace(asked, y=light), turn


def _second_phase(
    asked: Asked, image: Array, std_rad: Array, scale: int, solve: Callable[[Asked], Solution]
) -> tuple[Floats, Floats]:
    """Return the phases of two pictures in one, and their std in radians.

        theta = A phi + arg(y / A x),   s_theta = s / |A x|
        b^2 = scale^4 q,   t^2 = s_z^2 + q^2 / 4
        q = A^T beta^2 / A^T 1,   beta = arg(A x) - A phi

    The phase of a mean is no mean of phases: by how much, beta, the picture tells, so frames are
    brought to what they would be if it were. That holds as far as the picture is right, and to
    first order: of phases a radian apart nothing is known. Pixels of s_theta above that, as of the
    sky, are left out, and the first phase stays where most are: the solver takes the mean noise for
    its unit, which they alone would make. An HR pixel is 1 / scale^2 of what an LR pixel sees.
    """
    A, used = asked.model.operator, np.isfinite(asked.sigma)
    a, phase = np.abs(image), np.angle(image)
    seen, mean = A.forward(single(image)), A.forward(single(phase))
    least = LEAST_SHARE_OF_LIGHT**0.5 * median(np.abs(seen[used]))
    light = np.maximum(np.abs(seen), max(least, TINY))
    theta = mean + np.where(used, np.angle(asked.y * seen.conj()), 0.0)
    sigma = asked.sigma / light
    sigma[sigma > 1.0] = np.inf
    known = np.isfinite(sigma)
    if not known.any():
        return phase, std_rad
    other = solve(replace(asked, y=theta, sigma=sigma, general=True))
    bias = within_half_a_turn(np.angle(seen) - mean)
    bias_2 = mean_seen(A, single(bias**2), np.ones(light.shape, np.float32))
    bias, other_rad = scale**2 * np.sqrt(bias_2), np.hypot(other.std, 0.5 * bias_2)
    evidence = _evidence(asked, image, a * np.exp(1j * other.image), scale)
    both = phase_of_both(phase, other.image, std_rad, other_rad, bias, evidence)
    hardly = mean_seen(A, single(known), single(used)) < LEAST_SEEN
    return np.where(hardly, phase, both[0]), np.where(hardly, std_rad, both[1])


def _evidence(
    asked: Asked, first: Array, second: Array, scale: int, seen: Array | None = None
) -> Floats:
    """Return [row col] by how much the logarithm of the likelihood of a second picture is larger.

        (Q_1 - Q_2) / 2,   Q = sum |y - A x|^2 / s^2

    over a window of all frames, s^2 with what shifts may be off.

    Parameters
    ----------
    seen : [frame row col] A x of the second picture, if that was found on another grid
    """
    A, used = asked.model.operator, np.isfinite(asked.sigma)
    pictures = single(first), single(second)
    contrast = np.maximum(*(slopes_of(A, picture, scale)[1] for picture in pictures))
    variance = np.where(used, asked.sigma, np.inf) ** 2 + ALLOWED_SHIFT_PX**2 / 2 * contrast
    views = A.forward(pictures[0]), A.forward(pictures[1]) if seen is None else seen
    sums = []
    for view in views:
        square = np.abs(asked.y - view) ** 2 / 2 / variance
        around = mean_around(np.where(used, square, 0.0).sum(axis=0), WINDOW_PX, zeros=True)
        sums.append(mean_seen(A, single(np.broadcast_to(around, used.shape)), single(used)))
    return np.asarray(WINDOW_PX**2 / 2 * (sums[0] - sums[1]), np.float64)
