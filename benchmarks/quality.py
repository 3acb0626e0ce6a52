"""How good the methods are on stored cases with a ground truth, and on real frames.

    python benchmarks/quality.py [REFERENCE_FOLDER]

Every method is called alike on every case (scale and blur of the case, default settings).
PSNR with peak 1 and SSIM on the interior, 4 HR pixels of border left out.
"""

import argparse
import sys
import time
import warnings
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "examples"))

from eia_chart import USED, load_chart, prediction_rms

from lensshift import Burst, QualityWarning, fidelity, method_names, reconstruct


def load_case(path: Path) -> tuple[Burst, np.ndarray, int, float]:
    """Return burst, truth, scale and blur of a stored case."""
    with np.load(path) as case:
        # Stored as [row col frame], and as (x, y) of where the pixel looks.
        burst = Burst.from_arrays(
            np.moveaxis(case["LR"], -1, 0), offset_px=-case["shifts"][:, ::-1], pitch_mm=0.155
        )
        return burst, case["gt"], int(case["mag"]), float(case["psf"])


def table(rows: dict[str, dict[str, str]]) -> str:
    """Return a Markdown table, methods down, cases across."""
    cases = list(next(iter(rows.values())))
    lines = [["method", *cases], ["---"] * (len(cases) + 1)]
    lines += [[method, *cells.values()] for method, cells in rows.items()]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def main() -> None:
    """Print one table of the stored cases and one of the EIA chart."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "reference", type=Path, nargs="?", default=ROOT.parent / "shared" / "reference"
    )
    parser.add_argument("--methods", nargs="*", default=method_names(), choices=method_names())
    parser.add_argument("--psf-sigma-px", type=float, help="instead of the blur of each case")
    arguments = parser.parse_args()
    inputs = sorted((arguments.reference / "irwsr").glob("*_input.npz"))
    cases = {path.name.removesuffix("_input.npz"): load_case(path) for path in inputs}
    cases = {name: case for name, case in cases.items() if not np.iscomplexobj(case[0].amplitude)}
    chart = load_chart(arguments.reference / "real_sequences" / "mdsp_eia.npz")
    fits: dict[str, dict[str, str]] = {}
    predicts: dict[str, dict[str, str]] = {}
    warnings.simplefilter("ignore", QualityWarning)
    for method in arguments.methods:
        fits[method] = {}
        for name, (burst, truth, scale, blur_px) in cases.items():
            sigma_px = arguments.psf_sigma_px or blur_px
            start_s = time.perf_counter()
            result = reconstruct(burst, scale, method, psf_sigma_px=sigma_px, std=False)
            taken_s = time.perf_counter() - start_s
            close = fidelity(result.amplitude.image, truth)
            fits[method][name] = f"{close.psnr_db:.2f} / {close.ssim:.3f}"
            print(f"{method} {name}: {fits[method][name]}, {taken_s:.2f} s", file=sys.stderr)
        result = reconstruct(chart, 2, method, frames=USED, std=False)
        predicts[method] = {"EIA chart, RMS in grey levels": f"{prediction_rms(chart, result):.2f}"}
    print("PSNR in dB / SSIM\n\n" + table(fits))
    print("\nPrediction of 12 held-out real frames\n\n" + table(predicts))


if __name__ == "__main__":
    main()
