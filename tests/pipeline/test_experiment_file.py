"""Experiments in TOML: what they may say, and how they are refused."""

from pathlib import Path

import numpy as np
import pytest

from lensshift.camera import LensOptics, camera_preset, named_pattern_px
from lensshift.core.errors import DataError
from lensshift.pipeline import default_experiment, load_experiment, named_scene
from lensshift.pipeline.experiment_file import SCENES, default_text
from lensshift.scene import save_scene, slanted_depth_step

EVERYTHING = """
name = "all of it"
[scene]
file = "scene.toml"
[camera]
preset = "o3m151"
output = "float"
[camera.grid]
shape = [9, 13]
[camera.lens]
name = "petzval_b"
element = 2
[camera.illumination]
modulation_hz = [20e6]
[camera.ambient]
illuminance_klx = 40
[burst]
offset_px = [[0.0, 0.0], [0.25, -0.5]]
shift_error_px = 0.0
seed = 4
[reconstruction]
scale = 3
method = "irwsr"
prior_weight = 1
window = 2
channel = "amplitude"
shifts = "traced"
"""


def write(folder: Path, text: str) -> Path:
    file = folder / "mine.toml"
    file.write_text(text, encoding="utf-8")
    return file


def test_the_example_says_what_the_package_does_without_a_file() -> None:
    example = Path(__file__).parents[2] / "examples" / "four_boxes.toml"
    settings = [
        [line for line in text.splitlines() if not line.startswith("# ")]
        for text in (example.read_text(encoding="utf-8"), default_text())
    ]
    assert settings[0] == settings[1]
    assert load_experiment(example).camera == default_experiment().camera


def test_everything_that_a_file_can_say(tmp_path: Path) -> None:
    save_scene(slanted_depth_step(), tmp_path / "scene.toml")
    found = load_experiment(write(tmp_path, EVERYTHING))
    camera = found.camera
    assert (found.name, found.seed, found.scale) == ("all of it", 4, 3)
    assert (found.method, found.channel, found.shifts) == ("irwsr", "amplitude", "traced")
    assert found.options == {"prior_weight": 1.0, "window": 2}
    np.testing.assert_array_equal(found.pattern_px, [(0.0, 0.0), (0.25, -0.5)])
    assert len(found.scene.objects) == len(slanted_depth_step().objects)
    assert camera.grid.shape == (9, 13)
    assert camera.grid.pitch_mm == (0.155, 0.155)
    assert isinstance(camera.optics, LensOptics)
    assert camera.optics.element == 1
    assert camera.illumination.modulation_hz == (20e6,)
    assert camera.illumination.intensity_w_per_sr == 20.0  # as in the preset
    assert camera.ambient is not None
    assert camera.ambient.illuminance_klx == 40
    assert camera.output == "float"


def test_an_empty_file_is_the_default(tmp_path: Path) -> None:
    empty, default = load_experiment(write(tmp_path, "")), default_experiment()
    assert empty.camera == default.camera == camera_preset("o3m151")
    np.testing.assert_array_equal(empty.pattern_px, default.pattern_px)
    np.testing.assert_array_equal(default.pattern_px, named_pattern_px("square"))
    assert (empty.scale, empty.method, empty.channel) == (2, "auto", "auto")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("nam = 1", "mine.toml: nam: is not known, expected name, scene"),
        ("[scene]\nname = 'moon'", "mine.toml: scene.name: expected one of four_boxes"),
        ("[scene]\nfile = 'none.toml'", "none.toml: "),
        ("[camera]\npreset = 'phone'", "mine.toml: camera.preset: expected a camera of o3m151"),
        ("[camera.pixels]\nfill = 1", "camera.pixels.fill: is not known, expected fill_factor"),
        (
            "[camera.pixels]\nfill_factor = 2",
            "mine.toml: camera.pixels: expected fill_factor above 0",
        ),
        ("[camera.illumination]\nwavelength_nm = 0.85", "camera.illumination: expected wavelength"),
        ("[camera.optics]\nblur_sigma_px = 11", "camera.optics: expected blur_sigma_px from 0 to"),
        ("[camera.grid]\npitch_mm = [30, 30]", "mine.toml: camera"),
        ("[burst]\nseed = 9223372036854775808", "burst.seed: expected an integer within 64 bits"),
        ("[camera]\npixels = 3", "camera.pixels: expected a table, got 3"),
        ("[camera.lens]\nname = 'none'", "none"),
        ("[camera.lens]\nelement = -1", "camera.lens.element: expected at least 0, got -1"),
        ("[burst]\npattern = 'star'", "expected a pattern of square, 3x3, 4x4, still"),
        ("[burst]\nseed = 1.5", "burst.seed: expected int, got 1.5"),
        ("[reconstruction]\nmethod = 'magic'", "mine.toml: "),
        (
            "[reconstruction]\nchannel = 'colour'",
            "reconstruction.channel: expected auto, amplitude",
        ),
        (
            "[reconstruction]\nshifts = 'guessed'",
            "reconstruction.shifts: expected planned, true, traced",
        ),
        ("[reconstruction]\nshifts = 'traced'", "a camera whose lens is traced and moves"),
        ("[reconstruction]\npsf_sigma_px = -1", "mine.toml: expected psf_sigma_px of at least 0"),
        (
            "[reconstruction]\npsf_sigma_px = 'a'",
            "reconstruction.psf_sigma_px: expected float, got 'a'",
        ),
        ("[reconstruction]\npsf_sigma_px = nan", "mine.toml: expected psf_sigma_px of at least 0"),
        ("[reconstruction]\nscale = 'a'", "reconstruction.scale: expected int, got 'a'"),
        (
            "[reconstruction]\nmethod = 'tv'\nwindow = 2",
            "reconstruction.window: is not known, expected scale, method",
        ),
        (
            "[reconstruction]\nmethod = 'tv'\niterations = '2'",
            "reconstruction.iterations: expected int, got '2'",
        ),
        (
            "[reconstruction]\nmethod = 'tv'\niterations = 0",
            "iterations: expected a whole number of at least 1, got 0",
        ),
        ("= 3", "mine.toml: is not TOML"),
        ("name = 3", "mine.toml: name: expected str, got 3"),
        ("[scene]\nfile = 3", "scene.file: expected str, got 3"),
        ("[camera]\noutput = 'raw'", "camera.output: expected float, o3m, got 'raw'"),
        ("[camera.grid]\nshape = [9.5, 13]", "camera.grid.shape[0]: expected int, got 9.5"),
        ("[camera.grid]\nshape = [9]", "camera.grid.shape: expected [int, int], got [9]"),
        ("[camera.lens]\nelement = true", "camera.lens.element: expected int, got True"),
        ("[camera.lens]\ndiffraction = 'no'", "camera.lens.diffraction: expected bool, got 'no'"),
        ("[camera.readout]\nsaturates = 'false'", "camera.readout.saturates: expected bool"),
        ("[camera.readout]\nbits = 12.5", "camera.readout.bits: expected int, got 12.5"),
        ("[camera.multipath]\nshadows = 0", "camera.multipath.shadows: expected bool, got 0"),
        ("[camera.ambient]\nilluminance_klx = '5'", "illuminance_klx: expected float, got '5'"),
        ("[camera.illumination]\nmodulation_hz = [15]", "expected a frequency in Hz, got 15"),
        ("[camera.ambient]\nilluminance_klx = 50000", "illuminance_klx of at most 1000, got 50000"),
        ("[burst]\nshift_error_px = 1979", "shift_error_px from 0 to 5 LR pixels, got 1979"),
        ("[burst]\nshift_error_px = nan", "shift_error_px from 0 to 5 LR pixels, got nan"),
        ("[burst]\nshift_error_px = '0.1'", "burst.shift_error_px: expected float, got '0.1'"),
        ("[burst]\noffset_px = [['0', 1]]", "burst.offset_px[0][0]: expected float, got '0'"),
        ("[reconstruction]\nscale = 2.0", "reconstruction.scale: expected int, got 2.0"),
    ],
)
def test_what_does_not_fit_is_named(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(DataError) as caught:
        load_experiment(write(tmp_path, text))
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"none\.toml: cannot be read"):
        load_experiment(tmp_path / "none.toml")


@pytest.mark.parametrize("name", SCENES)
def test_scenes_by_name(name: str) -> None:
    assert named_scene(name).objects


def test_patterns_sample_a_pixel_evenly() -> None:
    for name, per_side in (("still", 1), ("square", 2), ("3x3", 3), ("4x4", 4)):
        offset_px = named_pattern_px(name)
        assert offset_px.shape == (per_side**2, 2)
        np.testing.assert_allclose(offset_px.mean(axis=0), 0.0, atol=1e-15)
        places = np.unique(offset_px.round(9))
        np.testing.assert_allclose(np.diff(places), 1 / per_side)
        steps = np.abs(np.diff(offset_px, axis=0)).sum(axis=1)
        np.testing.assert_allclose(steps, 1 / per_side)  # each to a neighbour
    with pytest.raises(ValueError, match="3x3"):
        named_pattern_px("5x5")
