"""How all experiments of the paper reconstruct a burst and measure an edge."""

from __future__ import annotations

import warnings

from lensshift.camera import named_pattern_px, simulate_tof
from lensshift.core.arrays import Floats
from lensshift.core.errors import QualityWarning
from lensshift.core.types import Burst, ShiftField
from lensshift.evaluation.slanted_edge import EdgeResult, measure_edge
from lensshift.pipeline.calibrate import psf_width_px
from lensshift.pipeline.experiment import images_of
from lensshift.pipeline.paper.bench import CARD_LIGHT, PITCH_MM, SHIFT_ERROR_PX, paper_camera
from lensshift.reconstruction.phasor.choice import Channel
from lensshift.reconstruction.reconstruct import reconstruct
from lensshift.scene import slanted_edge_card

SNR = 50.0  # of one frame, as in the paper
# What the reconstruction assumes of a pixel: the fill factor of a square one, None for a Gaussian,
# and the width of the spot, or of the Gaussian. The paper's, and the bench's once it is measured.
Response = tuple[float | None, float]
PUBLISHED: Response = (None, 0.30)
# Of the linear yardstick, fixed: weights chosen by the picture take fine gratings for noise, and
# would make it another solver for an edge than for a grating.
PRIOR_WEIGHT = 0.003
_HALF_COLS = 10  # of the region around an edge, in LR pixels


def calibrated_response(seed: int = 0) -> tuple[Response, float]:
    """Return the width that `calibrate` finds on the edge card of this bench, and its error."""
    burst = simulate_tof(
        slanted_edge_card(), paper_camera(SNR, CARD_LIGHT, CARD_LIGHT, optics="petzval_a"),
        named_pattern_px("4x4"), shift_error_px=SHIFT_ERROR_PX, seed=seed,
    ).burst  # fmt: skip
    found = psf_width_px(burst)
    if found is None:
        raise ValueError("expected an edge in the frames of the card, found none")
    return (None, found[0]), found[1]


def reconstructed(
    burst: Burst,
    channel: Channel,
    *,
    scale: int = 2,
    method: str = "auto",
    shift_field: ShiftField | None = None,
    prior_weight: float | None = None,
    response: Response = PUBLISHED,
) -> dict[str, Floats]:
    """Return the images of a burst by channel; doubts about the shifts are part of the study."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", QualityWarning)
        result = reconstruct(
            burst, scale, method, channel=channel, std=False, shift_field=shift_field,
            prior_weight=prior_weight, fill_factor=response[0], psf_sigma_px=response[1],
        )  # fmt: skip
    return images_of(result)


def solved(burst: Burst, method: str, response: Response = PUBLISHED, scale: int = 2) -> Floats:
    """Return the amplitude by a method; that of `tikhonov` is linear in the frames."""
    weight = PRIOR_WEIGHT if method == "tikhonov" else None
    return reconstructed(
        burst, "amplitude", scale=scale, method=method, prior_weight=weight, response=response
    )["amplitude"]


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
