"""
Predict frames that were left out
=================================

Without a truth there is still a test: reconstruct some frames, and predict the others. A method
that only sharpens predicts worse than it looks.
"""

import numpy as np

import lensshift
from lensshift.camera import Sensor, grid_pattern_px, simulate_burst
from lensshift.core.grid import Grid
from lensshift.report.shots import shots_figure
from lensshift.scene import siemens_star

sensor = Sensor(Grid((24, 64), (0.155, 0.155)), full_well_electrons=4000.0)
burst, _ = simulate_burst(siemens_star(1.7), sensor, grid_pattern_px(3), seed=1)
used = (0, 2, 6, 8)
held_out = [k for k in range(burst.frame_count) if k not in used]

shown = {"one frame": {"amplitude": np.kron(burst.amplitude[0], np.ones((2, 2)))}}
for method in ("bicubic", "shift-and-add", "tikhonov", "auto"):
    estimate = lensshift.reconstruct(burst, method=method, frames=used)["amplitude"]
    errors = [estimate.predict(k) - burst.amplitude[k] for k in held_out]
    inner = np.stack(errors)[:, 4:-4, 4:-4]
    print(f"{method:14s} {np.sqrt(np.mean(inner**2)):.4f} rms of {len(held_out)} frames")
    shown[method] = {"amplitude": estimate.image}

figure = shots_figure(shown, "a Siemens star, 4 of 9 frames", wide_in=7.0)
