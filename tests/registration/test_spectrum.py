"""The power law of scene, noise and fixed pattern, fitted to spectra that were drawn from one."""

import numpy as np
import pytest

from lensshift.registration.spectrum import Frequencies, Spectrum, first_spectrum

MOST_STEPS = 40


@pytest.mark.parametrize("exponent", [0.3, 0.5, 0.8, 1.2, 2.0])
@pytest.mark.parametrize(("seed", "log_pattern"), [(0, -20.0), (1, -20.0), (2, -3.0), (3, -3.0)])
def test_the_fit_comes_to_the_law_that_spectra_were_drawn_from(
    exponent: float, seed: int, log_pattern: float
) -> None:
    rng = np.random.default_rng(seed)

    def white(shape: tuple[int, ...]) -> np.ndarray:
        return (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)) / np.sqrt(2.0)

    frames, rows, cols = 5, 16, 64
    at = Frequencies.of((frames, rows, cols), whole_plane=False)
    steering = at.steering(rng.uniform(-1.0, 1.0, (frames, 2)), np.ones(frames))
    true = Spectrum(at, 0.0, exponent, -2.0, log_pattern, np.ones_like(at.down))
    scene = np.sqrt(true.power) * white(true.power.shape)
    noise = np.sqrt(true.noise_power) * white((len(scene), frames))
    pattern = np.exp(0.5 * log_pattern) * white((len(scene), 1))
    spectra = np.conj(steering.back) * (scene @ steering.alias) + noise + pattern

    found, step = first_spectrum(at, spectra, steering).asking_pattern(), np.inf
    for _ in range(MOST_STEPS):
        if step < 1e-3:
            break
        found, step, *_ = found.learned(spectra, steering, whole=True)
    assert step < 1e-3
    # Some 2000 numbers tell the noise to a few hundredths, and the law as well.
    assert found.log_noise == pytest.approx(true.log_noise, abs=0.1)
    assert found.exponent == pytest.approx(exponent, abs=0.15)
    assert found.log_level == pytest.approx(0.0, abs=0.25)
    if log_pattern > -20.0:
        assert found.log_pattern == pytest.approx(log_pattern, abs=0.4)
    else:
        assert found.log_pattern < true.log_noise - 2.0
