"""Which channel `auto` stands for.

The phasor channel is chosen where it is known to be the better one and can be had:

1. the burst holds real amplitudes, distances and their one modulation frequency, or the phasors
   of each frequency; a frequency guessed from the distances, or one of several, mixes surfaces in
   a way that the camera did not; amplitudes of 0 mix none;
2. the method is "auto"; the linear methods ring through zero beside bright objects, and the
   others know no phasors;
3. nothing is given that counts in the units of a single channel: noise, pixel variances, a weight
   of the prior, gains to estimate.

Otherwise amplitude and distance are reconstructed each on its own, as far as the burst has them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from lensshift.core.errors import warn_quality
from lensshift.core.types import Burst
from lensshift.reconstruction.method import Request

Channel = Literal["auto", "amplitude", "distance", "phasor"]
UNTOLD = (
    "the frames are complex and nobody told how fast their light was modulated: they stay complex, "
    "without distances; --modulation-hz 20e6 (modulation_hz=20e6) would tell 20 MHz"
)


@dataclass(frozen=True, slots=True)
class Choice:
    """What is reconstructed, and why.

    Parameters
    ----------
    channel : "amplitude", "distance", "phasor", or "separate" for the first two
    reason : for people
    """

    channel: str
    reason: str


def choose_channel(
    burst: Burst, channel: str, method: str, request: Request, *, given: bool
) -> Choice:
    """Return what to reconstruct by the rule of this module.

    Parameters
    ----------
    channel : as the caller asked
    given : whether noise, variances or gains of one channel were asked for

    Raises
    ------
    ValueError
        If there is no such channel.

    Warns
    -----
    QualityWarning
        If phasors stay complex because nobody told their frequency; a stream says that itself.
    """
    if channel not in get_args(Channel):
        raise ValueError(f"expected channel auto, amplitude, distance or phasor, got {channel!r}")
    if channel != "auto":
        return Choice(channel, "asked for")
    waves = burst.amplitude.dtype.kind == "c"
    phasors = burst.phasors is not None or waves
    if waves and burst.modulation_hz is None and not request.streamed:
        warn_quality(UNTOLD, 3)
    obstacles = {
        "complex frames of unknown frequency stay complex": waves and burst.modulation_hz is None,
        "the burst has no distance": burst.distance_m is None and not phasors,
        "the modulation frequency is not known": burst.modulation_hz is None,
        "amplitudes of 0 weigh no distance": not np.any(burst.amplitude[burst.valid]),
        "its distances are of several frequencies, and their phasors are not known": (
            len(burst.frequencies_hz) > 1 and burst.phasors is None
        ),
        f"{method} is no method for phasors beside bright objects": method != "auto",
        "noise, gains or a prior weight of one channel are given": given
        or request.prior_weight is not None,
    }
    for reason, holds in obstacles.items():
        if holds:
            return Choice("separate", reason)
    known = "phasors" if phasors else "amplitude, distance"
    return Choice("phasor", f"{known} and modulation frequency are known")
