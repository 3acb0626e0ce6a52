"""
Four boxes: one frame, bicubic, reconstruction, truth
=====================================================

The picture of the README, which ``lensshift run`` writes: four simulated frames of 64 x 16 pixels
with noise, whole centimetres and a shift error of 0.02 px that the reconstruction does not know.
"""

from lensshift.pipeline import carry_out, default_experiment
from lensshift.report.shots import shots_figure

experiment = default_experiment()
outcome = carry_out(experiment)
truth = outcome.capture.truth
shown = dict(outcome.images)
shown["truth"] = {"amplitude": truth.amplitude, "distance": truth.distance_m}
figure = shots_figure(shown, "four boxes, 4 frames")

# %%
# How close each one comes to the truth:

for name, numbers in outcome.fidelity.items():
    edge_mm = 1e3 * outcome.depth[name]["edge_rmse_m"]
    print(f"{name:8s} amplitude {numbers['psnr_db']:5.2f} dB, distance {edge_mm:5.1f} mm at edges")
