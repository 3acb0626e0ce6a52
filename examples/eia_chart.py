"""Real frames: reconstruct a resolution chart from 4 frames and predict the 12 others.

The EIA sequence has 16 frames on a grid of 0.25 px, frame 4 i + j being moved by i steps along
rows and j along columns. Frames 0, 2, 8, 10 are a square of half a pixel. A reconstruction is worth
what it says about frames that it has not seen: no ground truth is needed.

    python examples/eia_chart.py mdsp_eia.npz
"""

import argparse
from pathlib import Path

import numpy as np

from lensshift import Burst, Reconstruction, reconstruct
from lensshift.report.save import save_figure
from lensshift.report.shots import shots_figure

USED = (0, 2, 8, 10)
BORDER_PX = 4


def load_chart(path: Path) -> Burst:
    """Return the 16 frames with their nominal offsets, centred on the square of the used ones."""
    with np.load(path) as archive:
        frames = archive["frames"]
    step = np.stack(np.divmod(np.arange(len(frames)), 4), axis=1)
    # The stage steps say where a pixel looks; the content moves the other way.
    offset_px = -0.25 * (step - step[list(USED)].mean(axis=0))
    return Burst.from_arrays(frames, offset_px=offset_px, pitch_mm=0.01)


def prediction_rms(burst: Burst, result: Reconstruction) -> float:
    """Return the RMS error, in grey levels, of the frames that were not used."""
    held_out = [k for k in range(burst.frame_count) if k not in USED]
    predicted = np.stack([result.amplitude.predict(k) for k in held_out])
    error = predicted - burst.amplitude[held_out]
    inside = error[:, BORDER_PX:-BORDER_PX, BORDER_PX:-BORDER_PX]
    return float(np.sqrt(np.mean(inside**2)))


def main() -> None:
    """Print the prediction error of three methods and draw them side by side."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("frames", type=Path, help="mdsp_eia.npz")
    parser.add_argument("--out", type=Path, default=Path("eia_chart.png"), help="picture to write")
    arguments = parser.parse_args()
    burst = load_chart(arguments.frames)
    shown = {"one frame": {"amplitude": np.kron(burst.amplitude[0], np.ones((2, 2)))}}
    for method in ("bicubic", "shift-and-add", "auto"):
        result = reconstruct(burst, scale=2, method=method, frames=USED)
        print(f"{method:<14}{prediction_rms(burst, result):6.2f} grey levels RMS")
        shown[f"{method} x2"] = {"amplitude": result.amplitude.image}
    save_figure(shots_figure(shown, "EIA chart, frames 0, 2, 8, 10"), arguments.out)
    print(f"wrote {arguments.out}")


if __name__ == "__main__":
    main()
