"""How good a result is: resolution, noise, errors; knows nothing of how it was made.

Slanted edges (`slanted_edge`) and what is compared through them (`gain`) are modules of their
own: they load compiled code.
"""

from lensshift.evaluation.agreement import Agreement, edge_and_pattern
from lensshift.evaluation.depth import (
    DepthError,
    depth_error,
    edge_location_error,
    fill_rate,
    near_edges,
)
from lensshift.evaluation.edge_gradient import EdgeGradient, edge_gradient, gradient_ratio
from lensshift.evaluation.fidelity import Fidelity, fidelity, psnr_db, rmse, ssim
from lensshift.evaluation.gratings import GratingResult, gratings_mtf
from lensshift.evaluation.noise import noise_autocovariance, temporal_noise
from lensshift.evaluation.ring_correlation import RingCorrelation, fourier_ring_correlation
from lensshift.evaluation.siemens import SiemensResult, siemens_star_mtf
from lensshift.evaluation.surface import fit_plane, flying_pixel_fraction
from lensshift.evaluation.zone_plate import ZonePlateResult, zone_plate_response

__all__ = [
    "Agreement", "DepthError", "EdgeGradient", "Fidelity", "GratingResult", "RingCorrelation",
    "SiemensResult", "ZonePlateResult", "depth_error", "edge_and_pattern", "edge_gradient",
    "edge_location_error", "fidelity", "fill_rate", "fit_plane", "flying_pixel_fraction",
    "fourier_ring_correlation", "gradient_ratio", "gratings_mtf", "near_edges",
    "noise_autocovariance", "psnr_db", "rmse", "siemens_star_mtf", "ssim",
    "temporal_noise", "zone_plate_response",
]  # fmt: skip
