"""
Points in space
===============

Distances of a time-of-flight camera are radial. lensshift knows where each pixel looks, and
leaves out the pixels that mix two surfaces.
"""

import lensshift
from lensshift.pipeline import default_experiment
from lensshift.pipeline.experiment import simulate
from lensshift.report.result import cloud_figure

burst = simulate(default_experiment()).burst
result = lensshift.reconstruct(burst, scale=2)
cloud = result.point_cloud(normals=True)
figure = cloud_figure(cloud, f"{len(cloud)} points")

# %%
# What is known of each of them:

print(cloud)
