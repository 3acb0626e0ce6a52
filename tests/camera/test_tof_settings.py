"""What a camera may be, what is refused, and what is written into a burst."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tof_worlds import ODD, make_camera, quiet, still, wall

from lensshift.camera import (
    Ambient,
    Drift,
    Illumination,
    LensOptics,
    Multipath,
    Pixels,
    PlainOptics,
    Readout,
    Scatter,
    TofCamera,
    Validity,
    camera_preset,
    preset_names,
    simulate_tof_burst,
)
from lensshift.core.errors import DataError
from lensshift.core.grid import Grid
from lensshift.io import load_burst, save_burst
from lensshift.optics.lens_file import load_lens
from lensshift.scene import Scene


@pytest.mark.parametrize("name", preset_names())
def test_presets_see_a_wall(name: str) -> None:
    camera = camera_preset(name)
    assert camera.name == name
    small = replace(camera, grid=Grid((7, 11), camera.grid.pitch_mm))
    burst, truth = simulate_tof_burst(wall(2.5, 0.5), small, seed=3)
    assert burst.valid.mean() > 0.99
    error_m = burst.distance_m - 2.5
    assert np.abs(error_m).max() < 0.08
    assert 0.01 < burst.amplitude.mean() < 2.0
    np.testing.assert_allclose(burst.amplitude.mean(), truth.amplitude.mean(), rtol=0.03)


def test_preset_of_the_studied_camera() -> None:
    camera = camera_preset("o3m151")
    assert preset_names() == ("o3m151", "pmd_176x132", "vga")
    assert camera.grid == Grid((16, 64), (0.155, 0.155))
    assert isinstance(camera.optics, PlainOptics)
    assert (camera.optics.focal_length_mm, camera.optics.f_number) == (42.7, 2.1)
    assert camera.illumination.wavelength_nm == 850.0
    assert camera_preset("pmd_176x132").grid.shape == (132, 176)
    assert camera_preset("vga").grid.shape == (480, 640)


def test_every_preset_stays_valid_in_the_sun() -> None:
    camera = replace(camera_preset("o3m151"), grid=Grid((5, 9), (0.155, 0.155)))
    sunny = replace(camera, ambient=Ambient(120.0))
    burst = still(wall(3.5, 0.5), sunny).burst
    assert burst.valid.all()
    assert np.std(burst.distance_m) > 2 * np.std(still(wall(3.5, 0.5), camera).burst.distance_m)


def test_a_burst_tells_how_it_was_made_also_from_a_file(tmp_path: Path) -> None:
    optics = LensOptics(load_lens("petzval_a"), element=1)
    camera = replace(camera_preset("o3m151"), grid=Grid((3, 5), (0.155, 0.155)), optics=optics)
    burst, _ = simulate_tof_burst(wall(), camera, seed=17)
    save_burst(burst, tmp_path / "burst.nc")
    for meta in (burst.meta, load_burst(tmp_path / "burst.nc").meta):
        assert meta["origin"] == "simulated"
        assert meta["seed"] == 17
        assert meta["camera"] == "o3m151"
        assert meta["optics"]["lens"] == "Petzval A"
        assert meta["readout"]["full_well_electrons"] == 5e5
        assert meta["multipath"] is None


def test_ideal_turns_everything_off() -> None:
    camera = replace(
        camera_preset("vga"),
        ambient=Ambient(50.0),
        multipath=Multipath(),
        drift=Drift(1.0, 10.0),
        pixels=Pixels(contrast=0.5, harmonic_3=0.1, dark_electrons_per_s=1e6),
    )
    ideal = camera.ideal()
    assert (ideal.ambient, ideal.multipath, ideal.drift, ideal.scatter) == (None,) * 4
    assert ideal.pixels == Pixels(contrast=0.5)
    assert ideal.optics == camera.optics
    assert not ideal.readout.shot_noise
    small = replace(ideal, grid=Grid((3, 5), (0.007, 0.007)))
    burst = still(wall(4.0), small).burst
    np.testing.assert_allclose(burst.distance_m, 4.0, atol=1e-3)


BAD: list[tuple[Any, str]] = [
    (lambda: Illumination(()), "at least one"),
    (lambda: Illumination((1e7, 1e7)), "different modulation_hz"),
    (lambda: Illumination((1e7, 1.5e6 + 0.5)), "whole Hz"),
    (lambda: Illumination((-1e7,)), "positive"),
    (lambda: Illumination(intensity_w_per_sr=0.0), "intensity_w_per_sr"),
    (lambda: PlainOptics(0.0, 2.0), "focal_length_mm"),
    (lambda: PlainOptics(10.0, 0.49), "f_number of at least 0.5"),
    (lambda: PlainOptics(10.0, 2.0, transmission=1.2), "transmission"),
    (lambda: PlainOptics(10.0, 2.0, blur_sigma_px=-0.1), "blur_sigma_px from 0 to 10 LR pixels"),
    (lambda: Scatter(1.5), "scattered"),
    (lambda: Scatter(0.1, 0.0), "sigma_px"),
    (lambda: Pixels(fill_factor=0.0), "fill_factor above 0"),
    (lambda: Pixels(contrast=1.1), "contrast above 0"),
    (lambda: Pixels(contrast=0.9, harmonic_3=-0.2), "no tap goes below 0"),
    (lambda: Pixels(dark_electrons_per_s=-1.0), "dark_electrons_per_s"),
    (lambda: Ambient(-1.0), "illuminance_klx"),
    (lambda: Ambient(10.0, 0.0), "filter_width_nm"),
    (lambda: Readout(exposure_s=()), "rising exposure_s"),
    (lambda: Readout(exposure_s=(2e-3, 1e-3)), "rising exposure_s"),
    (lambda: Readout(gain=(1.0, 1.0)), "rising gain"),
    (lambda: Readout(bits=1), "2 to 16 bits"),
    (lambda: Readout(full_well_electrons=0.0), "full_well_electrons"),
    (lambda: Readout(read_noise_electrons=-1.0), "read_noise_electrons"),
    (lambda: Readout(background_electrons=float("nan")), "background_electrons"),
    (lambda: Multipath((0, 4)), "patches"),
    (lambda: Drift(float("inf")), "mm_per_k"),
    (lambda: Validity(min_amplitude_electrons=-1.0), "min_amplitude_electrons"),
    (lambda: Validity(flying_std_m=0.0), "flying_std_m"),
    (lambda: make_camera(output="other"), "float, o3m"),
    (lambda: make_camera(output="o3m"), "converter with bits"),
    (lambda: make_camera(output="o3m", readout=Readout(gain=(1.0, 2.0, 4.0))), "2 gains"),
    (lambda: camera_preset("o3m152"), "o3m151, pmd_176x132, vga"),
]


@pytest.mark.parametrize(("make", "words"), BAD, ids=[words for _, words in BAD])
def test_nonsense_is_refused(make: Any, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        make()


def test_wrong_kinds_are_refused() -> None:
    with pytest.raises(TypeError, match="PlainOptics or LensOptics"):
        TofCamera(ODD, optics="lens")  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="number for fill_factor"):
        Pixels(fill_factor="half")  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("planned_px", "options", "words"),
    [
        ([0.25, 0.25], {}, r"planned_px \[frame 2\]"),
        (np.zeros((0, 2)), {}, r"planned_px \[frame 2\]"),
        ([(0.0, np.nan)], {}, "finite planned_px"),
        ([(0.0, 0.0), (1e9, 0.0)], {}, r"of 9 x 13 px in view, got \(1e\+09, 0\) in frame 1"),
        ([(8.9, -13.0)], {}, r"of 9 x 13 px in view, got \(8.9, -13\) in frame 0"),
        ([(0.0, 0.0)], {"scale": 0}, "integer scale"),
        ([(0.0, 0.0)], {"scale": 1.5}, "integer scale"),
        ([(0.0, 0.0)], {"samples_per_px": 0}, "integer samples_per_px"),
        ([(0.0, 0.0)], {"shift_error_px": -0.1}, "shift_error_px of at least 0"),
        ([(0.0, 0.0)], {"shift_error_px": np.inf}, "shift_error_px of at least 0"),
    ],
)
def test_wrong_requests_are_refused(planned_px: Any, options: Any, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        simulate_tof_burst(wall(), make_camera(), planned_px, **options)


def test_nothing_to_see_at_all() -> None:
    with pytest.raises(DataError, match="it sees nothing"):
        still(Scene(()), make_camera())
    bright = replace(quiet(), exposure_s=(10.0,), saturates=True)
    with pytest.raises(DataError, match="100 % are full in the shortest exposure and 0 % have too"):
        still(wall(), make_camera(readout=bright))
    with pytest.raises(DataError, match=r"0 % are full .* and 100 % have too little"):
        still(wall(), make_camera(validity=Validity(min_amplitude_electrons=1e12)))
    with pytest.raises(DataError, match=r"metres, got a median of 3500 .* are they millimetres"):
        still(wall(3500.0), make_camera(readout=replace(quiet(), bits=12)))
