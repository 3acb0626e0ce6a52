"""Amplitude and distance together: what a time-of-flight pixel averages are phasors."""

from lensshift.reconstruction.phasor.flying import flying_pixels as flying_pixels
