"""How good a result is, measured against the truth; knows nothing of how it was made."""

from lensshift.evaluation.fidelity import Fidelity, fidelity, psnr_db, rmse, ssim

__all__ = ["Fidelity", "fidelity", "psnr_db", "rmse", "ssim"]
