"""
A result and its error bars
===========================

Every picture comes with the standard deviation of its error, and with what the frames say against
it.
"""

import lensshift
from lensshift.pipeline import demo_burst

burst, truth = demo_burst()
result = lensshift.reconstruct(burst, scale=2)
figure = result.plot()

# %%
# How many standard deviations the truth lies away. On worlds like those that the prior was
# trained on about
# 95 % lie within two; this is one picture.

import numpy as np

estimate = result["amplitude"]
away = np.abs(estimate.image - truth.image) / estimate.std
print(f"within one: {np.mean(away < 1):.0%}, within two: {np.mean(away < 2):.0%}")

# %%
# Frames that were told a shift with the wrong sign are contradicted, and the warning names the
# mistake:

import warnings
from dataclasses import replace

with warnings.catch_warnings(record=True) as said:
    warnings.simplefilter("always")
    lensshift.reconstruct(replace(burst, offset_px=-burst.offset_px))
for one in said:
    print(one.message)
