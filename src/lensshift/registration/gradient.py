"""Shifts by iterated gradient least squares, every frame against the mean of the others."""

from __future__ import annotations

import numpy as np

from lensshift.core.arrays import Array, Floats, Mask, Shifts
from lensshift.registration.likelihood import ShiftFit, against_reference

# Below this low pass the aliases of square pixels pull the shifts towards whole pixels.
LOW_PASS_SIGMA_PX = 0.8
# The low pass is one-sided at the border of a frame.
BORDER_PX = 2
CONVERGED_PX = 1e-3  # a twentieth of the budget
MAX_STEP_PX = 0.5  # beyond it the slope of a frame says nothing
_LEAST_PIXELS = 16  # for two numbers of each frame


def gradient_shifts(
    frames: Array,
    valid: Mask,
    start_px: Shifts,
    *,
    reference: int = 0,
    photometric: bool = False,
    max_iterations: int = 30,
) -> ShiftFit:
    """Estimate the offsets of all frames by least squares on the gradients of a common model.

        y_k(u + d_k) - m_k(u) = - delta_k . (grad y_k + grad m_k) / 2 + gamma_k m_k + beta_k

    m_k is the mean of the other frames, moved to the reference by what is known so far. Frame and
    model take part in the gradient alike, and at each pixel the noise of a central difference is
    independent of the noise of the pixel: the noise does not bias where the iteration comes to
    rest. All frames are low-passed first, which holds the aliases down but not wholly off; see
    `likely_shifts` for frames that alias much.

    Parameters
    ----------
    frames, valid : [frame row col]
    start_px : [frame 2], right to about a pixel
    reference : frame whose offset stays as it is
    photometric : whether gain and offset (gamma, beta) are estimated for each frame
    """
    smooth, seen = _low_passed(frames, valid)
    offset_px = start_px.copy()
    count = len(frames)
    gain, bias = np.ones(count), np.zeros(count)
    step_px = np.zeros((count, 2))
    normal = np.zeros((count, 2, 2))
    residual = 0.0
    converged = False
    for _ in range(max_iterations):
        moved, used = _aligned(smooth, seen, offset_px - offset_px[reference])
        moved = (moved - bias[:, None, None]) / gain[:, None, None]
        total, number = np.where(used, moved, 0.0).sum(axis=0), used.sum(axis=0)
        squares = []
        for k in range(count):
            others = number - used[k]
            here = used[k] & (others > 0)
            model = (total - np.where(used[k], moved[k], 0.0)) / np.maximum(others, 1)
            fit = _one_frame(moved[k], model, here, photometric=photometric)
            step_px[k], normal[k] = fit[0], fit[1]
            gain[k] *= 1.0 + fit[2]
            bias[k] += fit[3]
            squares.append(fit[4])
        residual = float(np.mean(squares))
        # Each frame is compared with the others, which move as well.
        step_px *= (count - 1) / count
        step_px -= step_px[reference].copy()
        largest_px = float(np.abs(step_px).max())
        offset_px = offset_px + step_px * min(1.0, MAX_STEP_PX / max(largest_px, 1e-300))
        if largest_px < CONVERGED_PX:
            converged = True
            break
    # The low pass shares noise over 4 pi sigma^2 pixels.
    shared = 4.0 * np.pi * LOW_PASS_SIGMA_PX**2
    each = residual * shared * np.linalg.pinv(normal, rcond=1e-9)
    return ShiftFit(
        offset_px=offset_px,
        covariance_px2=against_reference(each, reference) * (count - 1) / count,
        gain=gain / gain[reference],
        noise_sigma=float(np.sqrt(residual)),
        converged=converged,
    )


def texture_covariance(frames: Array, valid: Mask, offset_px: Shifts, noise_sigma: float) -> Floats:
    """Return the covariance [2 2] of a shift that the plain gradients of the frames allow.

        sigma^2 T^-1,   T = sum over pixels of grad y_k . grad (mean of the others)

    The noise of two frames is independent, so T holds the texture alone; where there is none it
    scatters about 0 by what the noise makes, and no less is taken.
    """
    smooth, seen = _low_passed(frames, valid)
    moved, used = _aligned(smooth, seen, offset_px)
    count = len(frames)
    here = used.all(axis=0)
    slopes = np.stack([np.stack([g[here] for g in np.gradient(one)]) for one in moved])
    others = (slopes.sum(axis=0) - slopes) / (count - 1)
    texture = np.real(np.einsum("kap,kbp->ab", slopes, np.conj(others))) / count
    # Of a central difference of low-passed white noise.
    slope_noise = noise_sigma**2 / (8.0 * np.pi * LOW_PASS_SIGMA_PX**4)
    least = slope_noise * max(float(np.count_nonzero(here)), 1.0) ** 0.5
    value, vector = np.linalg.eigh(0.5 * (texture + texture.T))
    value = np.maximum(value, max(least, 1e-300))
    return np.asarray((vector / value) @ vector.T * noise_sigma**2)


def _low_passed(frames: Array, valid: Mask) -> tuple[Array, Mask]:
    """Return the frames under a Gaussian that leaves invalid pixels out."""
    from scipy.ndimage import gaussian_filter

    sigma = (0.0, LOW_PASS_SIGMA_PX, LOW_PASS_SIGMA_PX)
    weight = gaussian_filter(valid.astype(np.float64), sigma, mode="nearest")
    values = gaussian_filter(np.where(valid, frames, 0.0), sigma, mode="nearest")
    seen = weight > 0.5
    inside = np.zeros(frames.shape[1:], np.bool_)
    inside[BORDER_PX:-BORDER_PX, BORDER_PX:-BORDER_PX] = True
    return values / np.maximum(weight, 1e-12), seen & inside


def _aligned(smooth: Array, seen: Mask, offset_px: Shifts) -> tuple[Array, Mask]:
    """Return the frames moved back by their offsets, and where they see anything."""
    from scipy.ndimage import shift

    moved = np.empty_like(smooth)
    used = np.empty(seen.shape, np.bool_)
    for k, offset in enumerate(offset_px):
        moved[k] = shift(smooth[k], -offset, order=3, mode="nearest")
        inside = shift(seen[k].astype(np.float64), -offset, order=1, cval=0.0)
        used[k] = inside > 0.99
    return moved, used


def _one_frame(
    moved: Array, model: Array, here: Mask, *, photometric: bool
) -> tuple[Shifts, Floats, float, float, float]:
    """Return step, normal matrix, change of gain and of bias, and mean squared residual."""
    if np.count_nonzero(here) < _LEAST_PIXELS:
        raise ValueError(
            f"expected frames with at least {_LEAST_PIXELS} valid pixels in common, got "
            f"{np.count_nonzero(here)}"
        )
    slopes = [-0.5 * part[here] for part in np.gradient(moved + model)]
    if photometric:
        slopes += [model[here], np.ones(np.count_nonzero(here))]
    design = np.stack(slopes, axis=-1)
    difference = (moved - model)[here]
    found, *_ = np.linalg.lstsq(design, difference, rcond=1e-6)
    square = float(np.mean((difference - design @ found) ** 2))
    normal = design.T @ design
    inner = normal[:2, :2]
    if photometric:
        inner = inner - normal[:2, 2:] @ np.linalg.pinv(normal[2:, 2:]) @ normal[2:, :2]
    gain, bias = (float(found[2]), float(found[3])) if photometric else (0.0, 0.0)
    return found[:2], inner, gain, bias, square
