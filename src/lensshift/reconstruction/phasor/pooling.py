"""What pixels of one surface know together of its distance."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

REACH_HR_PX = 2  # a pole of one LR pixel is as wide at x2


def pooled_phase(
    image: NDArray[np.complex128], amplitude_std: Array, phase_std_rad: Array
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the phase [row col] of phasors with what alike ones around know, and its std.

        w_j = exp(-(phi_j - phi)^2 / 2 (s_j^2 + s^2) - (a_j - a)^2 / 2 (t_j^2 + t^2)) / s_j^2
        phi' = phi + sum_j w_j (phi_j - phi) / sum_j w_j
        s'^2 = sum_j w_j (s_j^2 + (phi_j - phi')^2) / sum_j w_j

    Each neighbour is a guess at the surface that a pixel sees: as good as both their amplitudes and
    phases agree within their errors, and as much worth as it knows of its own phase. A dark pixel
    beside a bright surface takes its distance from the dark ones behind it, and what is measured
    well stays as it is.

    Parameters
    ----------
    image : [row col] a exp(i phi)
    amplitude_std, phase_std_rad : [row col] t and s

    Source: the bilateral filter (Tomasi and Manduchi, ICCV 1998), its widths the errors themselves.
    """
    amplitude = np.abs(image).astype(np.float32)
    unit = np.where(amplitude > 0, image / np.maximum(np.abs(image), 1e-300), 1.0)
    unit = unit.astype(np.complex64)
    t2, s2 = (np.square(a, dtype=np.float32) for a in (amplitude_std, phase_std_rad))
    total, moved, square = (np.zeros(image.shape, np.float32) for _ in range(3))
    rows, cols = image.shape
    for down in range(-min(REACH_HR_PX, rows - 1), min(REACH_HR_PX, rows - 1) + 1):
        for right in range(-min(REACH_HR_PX, cols - 1), min(REACH_HR_PX, cols - 1) + 1):
            here = np.s_[max(-down, 0) : rows - max(down, 0), max(-right, 0) : cols - max(right, 0)]
            there = np.s_[
                max(down, 0) : rows - max(-down, 0), max(right, 0) : cols - max(-right, 0)
            ]
            off = np.angle(unit[there] * unit[here].conj())
            apart = off**2 / (s2[there] + s2[here])
            apart += (amplitude[there] - amplitude[here]) ** 2 / (t2[there] + t2[here])
            weight = np.exp(-0.5 * apart) / s2[there]
            total[here] += weight
            moved[here] += weight * off
            square[here] += weight * (s2[there] + off**2)
    off = moved / total
    std_rad = np.sqrt(np.maximum(square / total - off**2, 0.0))
    return np.angle(image) + off, std_rad.astype(np.float64)
