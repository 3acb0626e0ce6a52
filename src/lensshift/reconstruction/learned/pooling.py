"""What pixels of one surface know together of its distance."""

from __future__ import annotations

from functools import partial

import numpy as np
from numba import njit
from numpy.typing import NDArray

from lensshift.core.arrays import Array, Floats
from lensshift.core.threads import bands, core_count, on_threads

REACH_HR_PX = 6  # with 8 surfaces are 5 % smoother and edges as good, for twice the time
WORTH_THREADS = 2**14  # pixels: below, waking a thread takes as long as the work


def pooled_phase(
    image: NDArray[np.complex128],
    amplitude_std: Array,
    phase_std_rad: Array,
    shared_rad: Array | float = 0.0,
    shared_hr_px: float = 1.0,
) -> tuple[Floats, Floats]:
    """Return the phase [row col] of phasors with what alike ones around know, and its std.

        w_j = exp(-(phi_j - phi)^2 / 2 S_j - (a_j - a)^2 / 2 (t_j^2 + t^2)) / S_j
        S_j = s_j^2 + s^2
        phi' = phi + sum_j w_j (phi_j - phi) / sum_j w_j
        s'^2 = max(sum_j w_j s_j^2, sum_j w_j (phi_j - phi')^2) / sum_j w_j
               (1 - (m / s)^2 n / (n + N))

    Each neighbour is a guess at the surface that a pixel sees: as good as both their amplitudes and
    phases agree within their errors, and as much worth as the difference of both phases is known. A
    dark pixel beside a bright surface takes its distance from the dark ones behind it, and what is
    measured well stays as it is. One that knows little is not swayed by a few that know much and
    see something else. Guesses differ by their errors or, if by more, by what they see. What
    neighbours are off by together is not less for many of them, but for the part m that is noise
    of the frames in a mean over N pixels: over n = 2 s^2 sum_j w_j of them, it is one over N + n.

    Parameters
    ----------
    image : [row col] a exp(i phi)
    amplitude_std, phase_std_rad : [row col] t and s
    shared_rad : [row col] m, which s holds
    shared_hr_px : N

    Source: the bilateral filter (Tomasi and Manduchi, ICCV 1998), its widths the errors themselves.
    """
    phase = np.angle(image)
    t2, s2 = (np.square(a, dtype=np.float32) for a in (amplitude_std, phase_std_rad))
    # Each pixel is one of its guesses.
    total, own = 0.5 / s2, np.full_like(s2, 0.5)
    moved, spread = np.zeros_like(s2), np.zeros_like(s2)
    amplitude = np.abs(image).astype(np.float32)
    guesses, sums = (phase.astype(np.float32), amplitude, t2, s2), (total, own, moved, spread)

    def pool(first: int, end: int) -> None:
        top, bottom = max(first - REACH_HR_PX, 0), min(end + REACH_HR_PX, len(phase))
        part = [one[top:bottom].copy() for one in sums]
        _pool(*(one[top:bottom] for one in guesses), *part)
        for one, found in zip(sums, part, strict=True):
            one[first:end] = found[first - top : end - top]

    cores = core_count() if phase.size >= WORTH_THREADS else 1
    on_threads([partial(pool, *band) for band in bands(len(phase), cores)])
    off, pixels = moved / total, 2.0 * s2 * total
    left = 1.0 - np.square(shared_rad) / s2 * pixels / (pixels + shared_hr_px)
    variance = left * np.maximum(own / total, spread / total - off**2)
    return phase + off, np.sqrt(variance, dtype=np.float64)


@njit(cache=True, fastmath=True, nogil=True, error_model="numpy")
def _pool(
    phase: Array, amplitude: Array, t2: Array, s2: Array,
    total: Array, own: Array, moved: Array, spread: Array,
) -> None:  # fmt: skip
    """Add w, w s^2, w off and w off^2 of all pairs to total, own, moved and spread.

    What two pixels are worth to each other is the same: each pair is looked at once, a row of pairs
    after the other, in loops that a compiler turns into vectors. exp(-x / 2) = (1 - x / 128)^64.
    """
    rows, cols = phase.shape
    turn, half, zero = np.float32(2.0 * np.pi), np.float32(np.pi), np.float32(0.0)
    one, step = np.float32(1.0), np.float32(1.0 / 128.0)
    w, off = np.empty(cols, np.float32), np.empty(cols, np.float32)
    for down in range(REACH_HR_PX + 1):
        for right in range(-REACH_HR_PX if down else 1, REACH_HR_PX + 1):
            # Unsigned, so that no index is tested for counting from the end.
            here, there = np.uintp(max(0, -right)), np.uintp(max(0, right))
            n = np.uintp(max(0, cols - abs(right)))
            for above in range(rows - down):
                i, i_2 = np.uintp(above), np.uintp(above + down)
                for j in range(n):
                    p, q = here + j, there + j
                    apart = phase[i_2, q] - phase[i, p]
                    apart -= turn if apart > half else -turn if apart < -half else zero
                    differ = amplitude[i_2, q] - amplitude[i, p]
                    known = one / (s2[i, p] + s2[i_2, q])
                    x = apart * apart * known + differ * differ / (t2[i, p] + t2[i_2, q])
                    e = max(one - x * step, zero)
                    for _ in range(6):
                        e *= e
                    w[j], off[j] = e * known, apart
                for j in range(n):
                    p, q = here + j, there + j
                    total[i, p] += w[j]
                    own[i, p] += w[j] * s2[i_2, q]
                    moved[i, p] += w[j] * off[j]
                    spread[i, p] += w[j] * off[j] * off[j]
                for j in range(n):
                    p, q = here + j, there + j
                    total[i_2, q] += w[j]
                    own[i_2, q] += w[j] * s2[i, p]
                    moved[i_2, q] -= w[j] * off[j]
                    spread[i_2, q] += w[j] * off[j] * off[j]
