"""Distances of several modulation frequencies: each has its phasors, together they have one turn.

A pixel that sees two surfaces mixes the light of each frequency by itself, so each gives its own
picture of phasors. Which turn the highest one is in is asked afterwards, in the fine picture, where
few pixels are mixed: pixels that know it tell those that do not.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import permutations

import numpy as np
from numpy.typing import NDArray

from lensshift.core.arrays import Array, Floats, Mask
from lensshift.core.units import SPEED_OF_LIGHT_MPS, within_half_a_turn

AROUND_HR_PX = 7  # along the window in which surfaces are looked for
BESIDE_HR_PX = 5  # along that of the two which a pixel mixes
ALIKE = 1.0 / 16.0  # of a turn: what four pixels of one surface may differ by
FARTHEST_M = 200.0  # no camera that counts turns sees farther
RELATED = 1.0 / 20.0  # of a turn, over its number: frequencies are multiples of another, or nearly
# Harmonics of light that is no sine turn phases by some hundredths, in any camera.
CALIBRATED_RAD = 0.05
SURE = 3.0**2  # chi-square by which a turn is sure: the usual 3 sigma
LINE = 2  # neighbours alike, in a line of pixels
MIXTURES = np.linspace(0.0, 1.0, 33)  # of equal parts of two distances, to 1/64 of the light
CORNER = 3  # neighbours alike, where a surface of four pixels or more ends
FORBIDDEN = 1e12  # chi-square that no noise reaches
AROUND = [(row, col) for row in range(3) for col in range(3) if (row, col) != (1, 1)]
ROUNDS = 8  # in which a turn is told on, by a pixel each
EM_ROUNDS, SETTLED_PIXELS = 200, 0.1  # until no turn gains or loses more


@dataclass(frozen=True, slots=True, eq=False)
class Tones:
    """Pictures of one scene, one for each modulation frequency.

    Parameters
    ----------
    hz : [frequency]
    phase_rad : [frequency ...]
    std_rad : same shape, standard deviation of the phases
    repeat_m : where all phases are back; as `repeats_m` says if it is not told
    """

    hz: tuple[float, ...]
    phase_rad: Floats
    std_rad: Floats
    repeat_m: float = 0.0

    def __post_init__(self) -> None:
        if not self.repeat_m:
            usual_rad = np.median(self.std_rad.reshape(len(self.hz), -1), axis=1)
            object.__setattr__(self, "repeat_m", repeats_m(self.hz, usual_rad))

    @property
    def turn_m(self) -> float:
        """c / 2f of the highest frequency."""
        return SPEED_OF_LIGHT_MPS / 2.0 / max(self.hz)

    def turns(self, low_m: float = 0.0, high_m: float = np.inf) -> range:
        """Return the turns of the highest frequency that reach from low to high, or so far."""
        last = math.ceil(min(self.repeat_m, high_m) / self.turn_m - 1e-6)
        return range(min(max(math.floor(low_m / self.turn_m), 0), last - 1), last)

    def at(self, where: Mask) -> Tones:
        """Return some pixels [row col] of the pictures, [frequency pixel]."""
        return Tones(self.hz, self.phase_rad[:, where], self.std_rad[:, where], self.repeat_m)

    @property
    def sigma_m(self) -> Floats:
        """Standard deviation [...] of the distance within its turn."""
        return np.asarray(1.0 / np.sqrt(np.sum(self._weight(), axis=0)))

    @property
    def shared_m(self) -> Floats:
        """The same where all phases have one error: sum of 1 / s_f over sum of 1 / s_f^2."""
        weight = self._weight()
        return np.asarray(np.sum(np.sqrt(weight), axis=0) / np.sum(weight, axis=0))

    def in_turn(self, number: int) -> tuple[Floats, Floats]:
        """Return the distance [...] in a turn of the highest frequency, and its chi-square.

            d_n = argmin_d C_n,   C_n = min_d sum_f (phi_f - 4 pi f d / c)^2 / s_f^2

        with phase differences within half a turn of d_fastest + n c / 2f.
        """
        per_m, fastest = self.rad_per_m, int(np.argmax(self.hz))
        first_m = np.mod(self.phase_rad[fastest] / per_m[fastest], self.turn_m)
        tried_m = first_m + number * self.turn_m
        off_rad = within_half_a_turn(self.phase_rad - per_m * tried_m)
        weight = self._weight()
        more_m = np.sum(weight * off_rad / per_m, axis=0) / np.sum(weight, axis=0)
        chi_square = np.sum(((off_rad - per_m * more_m) / self.std_rad) ** 2, axis=0)
        return tried_m + more_m, chi_square

    def alone(self) -> tuple[Floats, Floats, Mask]:
        """Return the distance [...] that fits all phases best, its chi-square, where it is sure.

        It is where the second best turn is worse by 9.
        """
        shape = self.phase_rad.shape[1:]
        best_m, least, second = np.zeros(shape), np.full(shape, np.inf), np.full(shape, np.inf)
        for number in self.turns():
            tried_m, cost = self.in_turn(number)
            second = np.minimum(np.maximum(cost, least), second)
            best_m, least = np.where(cost < least, tried_m, best_m), np.minimum(cost, least)
        return best_m, least, second - least > SURE

    def mixed(self, near_m: Array, far_m: Array) -> Floats:
        """Return the chi-square [...] of the best mixtures of light from two distances.

            sum_f min_w (phi_f - arg(w e_f(near) + (1 - w) e_f(far)))^2 / s_f^2

        with e_f(d) = exp(4 pi i f d / c). Each picture draws an edge a little elsewhere, and mixes
        by its own w.
        """
        near, far = (np.exp(1j * self.rad_per_m * one_m) for one_m in (near_m, far_m))
        least = np.full(self.phase_rad.shape, np.inf)
        for share in MIXTURES:
            off_rad = within_half_a_turn(
                self.phase_rad - np.angle(share * near + (1 - share) * far)
            )
            least = np.minimum(least, (off_rad / self.std_rad) ** 2)
        return np.asarray(least.sum(axis=0))

    def sees_beyond(self, low_m: Array, high_m: Array, farthest_m: float) -> Mask:
        """Return where the lowest frequency surely sees what is nearer or farther than that.

        Mixed light of it comes from between the surfaces that are mixed, if none has another turn.
        """
        lowest = int(np.argmin(self.hz))
        turn_m = SPEED_OF_LIGHT_MPS / 2.0 / self.hz[lowest]
        if turn_m < farthest_m:
            return np.zeros(low_m.shape, np.bool_)
        m_per_rad = turn_m / (2.0 * np.pi)
        seen_m = np.mod(self.phase_rad[lowest], 2.0 * np.pi) * m_per_rad
        beyond_m = np.maximum(low_m - seen_m, seen_m - high_m)
        return np.asarray(beyond_m > math.sqrt(SURE) * self.std_rad[lowest] * m_per_rad)

    @property
    def spare(self) -> int:
        """How many phases there are beyond the one that tells the distance, at least 1."""
        return max(len(self.hz) - 1, 1)

    @property
    def rad_per_m(self) -> Floats:
        """4 pi f / c, [frequency ...]."""
        per_m = 4.0 * np.pi / SPEED_OF_LIGHT_MPS * np.asarray(self.hz)
        return per_m.reshape(-1, *(1,) * (self.phase_rad.ndim - 1))

    def _weight(self) -> Floats:
        return np.asarray((self.rad_per_m / self.std_rad) ** 2)


def repeats_m(hz: tuple[float, ...], std_rad: Floats) -> float:
    """Return the distance at which all phases are back, nearly; at most 200 m.

        n c / 2f:  |n f_i / f - integer| < 1 / 20n for all i, and less than for less n;  C_n < 9

    Frequencies of a camera have a common divisor, c / (2 gcd f) in distance; but they are told
    rounded, 80.3 and 60.2 MHz, and then come back a little beside, which no phase can tell.
    Unrelated ones come as near in 7 % of cases; two that are nearly the same count turns by that.

    Parameters
    ----------
    std_rad : [frequency] of the phases of a usual pixel

    Source of the 7 %: Kuzmin (1928), log2(1 + 1/20), the law of continued fractions.
    """
    high_hz = max(hz)
    turn_m = SPEED_OF_LIGHT_MPS / 2.0 / high_hz
    number = np.arange(1, max(int(FARTHEST_M / turn_m), 1) + 1)
    share = np.array(hz) / high_hz
    off = number[:, None] * share - np.rint(number[:, None] * share)
    weight = 1.0 / np.maximum(std_rad, 1e-9) ** 2
    more = (off @ (weight * share)) / np.sum(weight * share**2)
    chi_square = ((2.0 * np.pi * (off - more[:, None] * share)) ** 2) @ weight
    most = np.abs(off).max(axis=1)
    nearest = most < np.append(np.inf, np.minimum.accumulate(most)[:-1])
    nearest[0] = np.ptp(hz) == 0.0
    back = nearest & (most * number < RELATED) & (chi_square < SURE)
    return float(min(number[back][0] * turn_m if back.any() else FARTHEST_M, FARTHEST_M))


def doubt_about_phases(pictures: Tones) -> str:
    """Say why most phases fit no distance, as far as another reading of them does; or "".

    Phases of another frequency than they are told to be of, or that run backwards, fit none.
    """
    found_m, chi_square, _ = pictures.alone()
    off_rad = within_half_a_turn(pictures.phase_rad - pictures.rad_per_m * found_m)
    given = float(np.median(chi_square))
    if given < SURE or np.median(np.abs(off_rad).max(axis=0)) < CALIBRATED_RAD:
        return ""
    told = _names(pictures.hz)
    readings = [
        (
            replace(pictures, hz=order, repeat_m=0.0),
            f"the phases of the frequencies fit no distance in the order of modulation_hz, {told} "
            f"Hz, but do in another: is phasors [frequency frame row col] in that of "
            f"{_names(order)} Hz?",
        )
        for order in permutations(pictures.hz)
        if order != pictures.hz
    ]
    for number, hz in enumerate(pictures.hz):
        sign = np.where(np.arange(len(pictures.hz)) == number, -1.0, 1.0)[:, None, None]
        one = f"{hz:g}" if len(pictures.hz) > 2 else f"one of {told}"
        readings.append(
            (
                replace(pictures, phase_rad=sign * pictures.phase_rad),
                f"the phases of {told} Hz fit no distance, but do if those of {one} Hz run "
                "backwards: give the conjugate of its phasors, so that phases grow with distance",
            )
        )
    costs = [float(np.median(reading.alone()[1])) for reading, _ in readings]
    best = int(np.argmin(costs))
    if costs[best] < min(SURE, given / SURE):
        return readings[best][1]
    return (
        f"the phases of {told} Hz fit no distance (chi-square {given:.3g}, by the noise "
        f"{pictures.spare}): is a frequency another one, or are its phases not calibrated (an "
        "offset, other light that took part)? Distances may be turns off"
    )


def _names(some_hz: tuple[float, ...]) -> str:
    return ", ".join(f"{hz:g}" for hz in some_hz)


def common_distance(pictures: Tones) -> tuple[Floats, Floats]:
    """Return the distance [row col] of all frequencies, and its standard deviation.

        n = argmin  C_n / max(1, min C / (F - 1)) + 9 mean_around min(1, |d_n - d_around| 2f / c)

    A pixel that is sure and like three around keeps the turn of its own phases. Any other asks its
    phases and those around: all of them a turn away, or farther as the wall behind a pole is, are
    worth 3 sigma. A pixel that sees two surfaces has phases of none, fits no turn, and must be
    among or between the surfaces near it, unless it is of a line of pixels alike, as a pole is, and
    no mixture of those has its phases (by 9). Turns that no surface and no line has are not asked.
    Of these pixels the distance is the mean over all turns, by how likely they are, and their
    variance is in that of it; besides there is what phases allow, more where they contradict each
    other. Beside an edge what a picture hides is the same in all of them, as noise is not.
    """
    found_m, least, sure = pictures.alone()
    doubt = np.maximum(least / pictures.spare, 1.0)
    alike = _alike(found_m, pictures.sigma_m, pictures.turn_m)
    edge = alike < _alike(np.zeros(alike.shape), pictures.sigma_m, pictures.turn_m)
    std_m = np.where(edge, pictures.shared_m, pictures.sigma_m) * np.sqrt(doubt)
    asked = (alike < CORNER) | ~sure
    if not asked.any():
        return found_m, std_m
    some, half_m = pictures.at(asked), 0.5 * pictures.turn_m
    inside = (alike > len(AROUND) // 2) | (sure & (alike >= LINE))
    seen_m = _seen_from_to(pictures.at(inside if inside.any() else np.full_like(inside, 1)))
    numbers = some.turns(seen_m[0] - half_m, seen_m[1] + half_m)
    tried_m, cost = (np.stack(both) for both in zip(*map(some.in_turn, numbers), strict=True))
    cost /= doubt[asked]
    found_m[asked] = _least(tried_m, cost)
    for _ in range(ROUNDS):
        before_m = found_m[asked]
        total = cost + SURE * _apart(tried_m, found_m, asked, pictures.turn_m)
        found_m[asked] = _least(tried_m, total)
        if np.array_equal(before_m, found_m[asked]):
            break
    alike = _alike(found_m, pictures.sigma_m, pictures.turn_m)
    surface = alike >= CORNER
    beside_m = _reach(found_m, surface, 0.0, BESIDE_HR_PX)
    thin = asked & ~surface & (alike >= LINE) & np.isfinite(beside_m[0])
    thin[[0, -1]] = thin[:, [0, -1]] = False  # which may mix what the picture does not show
    mixed = pictures.at(thin).mixed(*(one_m[thin] for one_m in beside_m))
    surface[thin] = mixed / doubt[thin] - _least(cost, total)[thin[asked]] > SURE
    low_m, high_m = _reach(found_m, surface, ALIKE * pictures.turn_m)
    beyond_m = np.maximum(low_m[asked] - tried_m, tried_m - high_m[asked])
    beyond_m[:, some.sees_beyond(low_m[asked], high_m[asked], seen_m[1])] = 0.0
    total += FORBIDDEN * np.maximum(beyond_m, 0.0)
    found_m[asked] = _least(tried_m, total)
    likely = np.exp(0.5 * (total.min(axis=0) - total))
    likely /= likely.sum(axis=0)
    contradiction = np.maximum(_least(cost, total) / pictures.spare, 1.0)
    found_m[asked] = np.sum(likely * tried_m, axis=0)
    others = np.sum(likely * (tried_m - found_m[asked]) ** 2, axis=0)
    std_m[asked] = np.sqrt(std_m[asked] ** 2 * contradiction + others)
    return found_m, std_m


def _seen_from_to(some: Tones) -> tuple[float, float]:
    """Return the least and largest distance in the turns that pixels [pixel] of surfaces have.

        p_n = mean of r_n,   r_n = p_n L_n / sum p L,   L = exp(-C / 2 max(1, min C / (F - 1)))

    Frequencies without a large common divisor have many turns, of which some fit any phases by
    chance, but each pixel others: how often each occurs is found by maximum likelihood (EM), and
    less than a pixel is never. Errors of a surface are much the same all over it, so that many
    pixels are no surer than one: where their median is not sure to be in no nearer turn, it is.
    """
    numbers = some.turns()
    cost = np.stack([some.in_turn(number)[1].astype(np.float32) for number in numbers])
    least = cost.min(axis=0)
    doubt = np.maximum(least / some.spare, 1.0)
    fits = np.exp((least - cost) / (2.0 * doubt))
    often: Floats = np.full(len(numbers), 1.0 / len(numbers))
    for _ in range(EM_ROUNDS):
        before = often
        often = often * (fits @ (1.0 / (often @ fits))) / least.size
        if least.size * np.abs(often - before).max() < SETTLED_PIXELS:
            break
    often[least.size * often < 1.0] = 0.0
    number = np.argmax(often[:, None] * fits, axis=0)
    for n in range(len(numbers) - 1, 0, -1):
        own = np.flatnonzero(number == n)
        more = (cost[:n, own].min(axis=0) - cost[n, own]) / doubt[own]
        if own.size and np.median(more) < SURE:
            number[own] = np.argmin(cost[:n, own], axis=0)
    seen_m = np.concatenate([some.at(number == n).in_turn(numbers[n])[0] for n in set(number)])
    return float(seen_m.min()), float(seen_m.max())


def _alike(distance_m: Array, sigma_m: Array, turn_m: float) -> NDArray[np.int_]:
    """Return how many [row col] of the 8 neighbours have that distance, within 3 sigma.

    It may differ by 1/16 of a turn besides, as surfaces are slanted.
    """
    rows, cols = distance_m.shape
    wide_m = np.pad(distance_m, 1, constant_values=np.inf)
    variance_m2 = np.pad(sigma_m**2, 1)
    count = np.zeros(distance_m.shape, np.int_)
    for down, right in AROUND:
        at = np.s_[down : down + rows, right : right + cols]
        beyond_m = np.abs(wide_m[at] - distance_m) - ALIKE * turn_m
        count += beyond_m < np.sqrt(SURE * (variance_m2[at] + sigma_m**2))
    return count


def _apart(tried_m: Array, distance_m: Array, asked: Mask, turn_m: float) -> Floats:
    """Return by how much of a turn [turn pixel] the 8 neighbours of pixels would be away, the mean.

    At most one of each.
    """
    rows, cols = distance_m.shape
    wide_m = np.pad(distance_m, 1, mode="edge")
    apart = np.zeros(tried_m.shape)
    for down, right in AROUND:
        near_m = wide_m[down : down + rows, right : right + cols]
        apart += np.minimum(np.abs(tried_m - near_m[asked]) / turn_m, 1.0)
    return apart / len(AROUND)


def _least(values: Array, cost: Array) -> Floats:
    """Return the values [pixel] of the turns [turn pixel] that cost least."""
    number = np.argmin(cost, axis=0)[None]
    return np.asarray(np.take_along_axis(values, number, axis=0)[0])


def _reach(
    distance_m: Array, surface: Mask, margin_m: float, side_px: int = AROUND_HR_PX
) -> tuple[Floats, Floats]:
    """Return from where to where [row col] the surfaces around go, any distance where none is."""
    from scipy.ndimage import maximum_filter, minimum_filter

    low_m = minimum_filter(np.where(surface, distance_m, np.inf), side_px)
    high_m = maximum_filter(np.where(surface, distance_m, -np.inf), side_px)
    known = np.isfinite(low_m)
    return np.where(known, low_m - margin_m, -np.inf), np.where(known, high_m + margin_m, np.inf)
