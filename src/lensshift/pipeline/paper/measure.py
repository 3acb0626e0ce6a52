"""How all experiments of the paper reconstruct a burst and measure an edge."""

from __future__ import annotations

import warnings

import numpy as np
from numpy.typing import NDArray

from lensshift.core.errors import QualityWarning
from lensshift.core.types import Burst, ShiftField
from lensshift.evaluation.slanted_edge import EdgeResult, measure_edge
from lensshift.pipeline.experiment import images_of
from lensshift.pipeline.paper.bench import PITCH_MM
from lensshift.reconstruction.phasor.choice import Channel
from lensshift.reconstruction.reconstruct import reconstruct

Floats = NDArray[np.float64]

# What the reconstruction assumes of a pixel: the fill factor of a square one, None for a Gaussian,
# and the width of the spot, or of the Gaussian.
Response = tuple[float | None, float]
# The paper took 0.3 px. Square pixel and spot have the second moment of 0.293 px; a little more is
# the least with which edges reach the limit of half a pixel (table `responses` of the report).
ASSUMED: Response = (None, 0.32)
_HALF_COLS = 10  # of the region around an edge, in LR pixels


def reconstructed(
    burst: Burst,
    channel: Channel,
    *,
    scale: int = 2,
    method: str = "auto",
    shift_field: ShiftField | None = None,
    prior_weight: float | None = None,
    response: Response = ASSUMED,
) -> dict[str, Floats]:
    """Return the images of a burst by channel; doubts about the shifts are part of the study."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", QualityWarning)
        result = reconstruct(
            burst, scale, method, channel=channel, std=False, shift_field=shift_field,
            prior_weight=prior_weight, fill_factor=response[0], psf_sigma_px=response[1],
        )  # fmt: skip
    return images_of(result)


def as_published(burst: Burst) -> Floats:
    """Return the amplitude that the published toolbox gives with the settings of the paper."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", QualityWarning)
        result = reconstruct(
            burst, 2, "irwsr-toolbox", channel="amplitude", std=False, psf_sigma_px=0.3
        )
    return images_of(result)["amplitude"]


def measured_edge(image: Floats, scale: int, frequency_lpmm: Floats | None = None) -> EdgeResult:
    """Measure the edge through the middle of an image, as straight and evenly lit as it is.

    That a reconstruction with a sparse prior is not linear, and aliasing left in one frame, make
    the measurement doubt; both are in what is compared.
    """
    rows, cols = image.shape
    half = _HALF_COLS * scale
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", QualityWarning)
        return measure_edge(
            image,
            PITCH_MM / scale,
            scale=scale,
            region=(0, rows, cols // 2 - half, cols // 2 + half),
            frequency_lpmm=frequency_lpmm,
            most_bends=0,
            tilt=False,
        )
