"""What a plain method returns."""

from __future__ import annotations

from dataclasses import dataclass

from lensshift.core.arrays import Array, Floats


@dataclass(frozen=True, slots=True, eq=False)
class Baseline:
    """The HR image of a plain method.

    Parameters
    ----------
    image : [row col], real or complex
    noise_gain : [row col] standard deviation of an HR pixel where that of every LR pixel is 1
        and their noises are independent; None where the method is not linear
    """

    image: Array
    noise_gain: Floats | None = None
