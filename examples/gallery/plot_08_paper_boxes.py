"""
The paper's figures 6 and 7: four boxes and a line across one edge
==================================================================

Four cubes of different size, reflectance and orientation, in one frame and reconstructed,
amplitude and distance; and a line across the edge of the left small cube.
"""

import numpy as np

import lensshift
from lensshift.pipeline import default_experiment
from lensshift.pipeline.experiment import simulate
from lensshift.report.claims import profiles_figure
from lensshift.report.shots import shots_figure

capture = simulate(default_experiment())
burst, truth = capture.burst, capture.truth
fine = lensshift.reconstruct(burst, scale=2, channel="phasor")
images = {
    "one frame": {"amplitude": burst.amplitude[0], "distance": burst.distance_m[0]},
    "phasors x2": {name: one.image for name, one in fine.channels.items()},
    "truth": {"amplitude": truth.amplitude, "distance": truth.distance_m},
}
doubled = {name: np.kron(image, np.ones((2, 2))) for name, image in images["one frame"].items()}
figure = shots_figure(images | {"one frame": doubled}, "four boxes")

# %%
# One line of the images: LR row 11, columns 1 to 16.

profiles = {"amplitude": {}, "distance": {}}
for label, channels in images.items():
    for name, image in channels.items():
        per_px = image.shape[1] // burst.grid.shape[1]
        cols = np.arange(1 * per_px, 17 * per_px)
        moved_px = burst.offset_px[0, 1] if per_px == 1 else 0.0
        place_px = (cols + 0.5) / per_px - 0.5 - moved_px
        profiles[name][label] = (place_px, image[11 * per_px, cols])
lines = profiles_figure(profiles, "Across the left small cube")

# %%
# How much steeper is it? One line cannot tell: the next script asks 64.
