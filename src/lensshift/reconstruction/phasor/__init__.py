"""Amplitude and distance together: what a time-of-flight pixel averages are phasors."""

from lensshift.reconstruction.phasor.flying import flying_pixels as flying_pixels
from lensshift.reconstruction.phasor.frames import PhasorFrames as PhasorFrames
from lensshift.reconstruction.phasor.frames import phasor_from_phases as phasor_from_phases
