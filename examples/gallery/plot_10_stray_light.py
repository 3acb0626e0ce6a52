"""
Take stray light out of distances
=================================

A hundredth of the light goes astray in the lens of the simulated O3M, and pulls the dark wall
towards the bright boxes before it. A white card held into another scene tells how much it is, and
how far it goes; with that the wall is where it is.
"""

import matplotlib.pyplot as plt
import numpy as np

import lensshift
from lensshift.camera import camera_preset, simulate_tof
from lensshift.scene import Constant, Cuboid, Plane, Scene, four_boxes

camera = camera_preset("o3m151")
wall = Plane(centre_m=(0.0, 0.0, 5.0), reflectance=Constant(0.2))
card = Cuboid(size_m=(0.08, 0.05, 0.01), centre_m=(0.0, 0.0, 2.5), reflectance=Constant(0.9))
seen = [
    simulate_tof(Scene(objects, wall), camera, seed=seed).burst
    for seed, objects in enumerate([(card,), ()])
]
measured = lensshift.measure_stray_light(*seen)
error, away_px = 100 * measured.share_std, measured.sigma_px
print(f"{100 * measured.share:.2f} +- {error:.2f} % of the light over {away_px:.1f} px")

capture = simulate_tof(four_boxes(), camera, seed=0)
told = {"left in": lensshift.StrayLight(0.0, 8.0), "taken out": measured}
figure, axes = plt.subplots(len(told), 1, figsize=(7, 4.4), sharex=True, layout="constrained")
for axis, (name, stray_light) in zip(axes, told.items(), strict=True):
    found = lensshift.reconstruct(capture.burst, stray_light=stray_light).distance_m
    off_mm = 1e3 * (found.image - capture.truth.distance_m)
    flat = ~capture.truth.flying
    held = 100 * np.mean(np.abs(off_mm[flat]) < 2e3 * found.std[flat])
    rms = np.sqrt(np.mean(off_mm[flat] ** 2))
    axis.set_title(f"stray light {name}: {rms:.1f} mm rms of surfaces, {held:.0f} % within two std")
    shown = axis.imshow(off_mm, vmin=-40, vmax=40, cmap="RdBu_r")
figure.colorbar(shown, ax=axes, label="distance off (mm)")
