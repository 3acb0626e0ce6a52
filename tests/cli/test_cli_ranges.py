"""Numbers that cannot be meant: NaN, no end, another unit, named with the option and the value."""

import math
from pathlib import Path

import numpy as np
import pytest
import typer
from stand_in import Call, Refused

from lensshift.cli.ranges import _RANGES, in_range
from lensshift.core.units import MOST_PITCH_MM

A = "petzval_a"
REFINE = ("refine", A, "--focal-length-mm", "42", "--f-number", "2")
OPTIMISE = ("optimise", "al2550", "eo45030", "--focal-length-mm", "42.7")


@pytest.mark.parametrize(
    ("verb", "option", "value", "hint"),
    [
        (("which", A), "--pitch-mm", "155", "155 um are 0.155"),
        (("show", A), "--pitch-mm", "0.000155", "155 um are 0.155"),
        (("show", A), "--shift-px", "nan", "a quarter of one is 0.25"),
        (("which", A), "--shift-px", "inf", "a quarter of one is 0.25"),
        (("mtf", A), "--shift-px", "250", "a quarter of one is 0.25"),
        (("mtf", A), "--band-nm", "0", "for one wavelength leave it out"),
        (("report", A), "--band-nm", "nan", "for one wavelength leave it out"),
        (REFINE, "--band-nm", "-5", "for one wavelength leave it out"),
        (OPTIMISE, "--band-nm", "40000", "for one wavelength leave it out"),
        (("show", A), "--wavelength-nm", "0.85", "0.85 um are 850"),
        (("show", A), "--wavelength-nm", "850000", "0.85 um are 850"),
        (("show", A), "--temperature-c", "293", "293 K are 20"),
        (("show", A), "--temperature-c", "nan", "293 K are 20"),
        (("mtf", A), "--highest-lpmm", "inf", "in line pairs per mm"),
        (("field", A), "--reach-px", "nan", "one is 1"),
        (OPTIMISE, "--stop-mm", "20000", "20 mm are 20"),
        (OPTIMISE, "--stop-mm", "0", "20 mm are 20"),
        (OPTIMISE, "--object-mm", "-3500", "3.5 m are 3500"),
        (OPTIMISE, "--mtf", "90", "90 % are 0.9"),
        (OPTIMISE, "--shift-error-px", "-1", "a hundredth of one is 0.01"),
        (REFINE, "--track-mm", "nan", "25 mm are 25"),
        (REFINE, "--track-mm", "25000", "25 mm are 25"),
        (REFINE, "--distortion", "-0.1", "2 % are 0.02"),
        (REFINE, "--distortion", "2", "2 % are 0.02"),
        (OPTIMISE, "--object-mm", "3500000", "3.5 m are 3500"),
        (("mtf", A), "--band-nm", "1000", "for one wavelength leave it out"),
        (("tolerance", A), "--decenter-mm", "50", "50 um are 0.05"),
        (("tolerance", A), "--tilt-deg", "nan", "6 minutes of arc are 0.1"),
        (("tolerance", A), "--limit", "90", "90 % are 0.9"),
        (("budget", A), "--repeatability-um", "1000", "1 um is 1, not 1000 nm"),
        (("budget", A), "--noise", "5", "2 % are 0.02"),
    ],
)
def test_a_number_of_a_lens_in_another_unit(
    refused: Refused, verb: tuple[str, ...], option: str, value: str, hint: str
) -> None:
    said = f"Invalid value for '{option}': expected a number from "
    refused(["lens", *verb, option, value], 2, said)
    refused(["lens", *verb, option, value], 2, f"{hint}; got {float(value):g}")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["lens", "mtf", A, "--field-deg", "0,650"], "in degrees; got 650"),
        (["lens", "mtf", A, "--field-deg", "0,nan"], "a field like 1.6,6.5"),
        (["lens", *OPTIMISE, "--cover", "N-BK7,1000,0.5"], "500 um are 0.5; got 1000"),
        (["lens", *REFINE, "--glass-mm", "800,5000"], "800 um are 0.8; got 800"),
        (["lens", *REFINE, "--glass-mm", "0.8,nan"], "two thicknesses like 0.8,5"),
        (["lens", *REFINE, "--temperatures-c", "20,293"], "293 K are 20; got 293"),
        (["lens", *REFINE, "--grow", "nan,1"], "numbers like 0.4,1"),
        (
            ["evaluate", "mtf", "e.npy", "--focal-length-mm", "0"],
            "42.7, not 42700 or 0.0427; got 0",
        ),
        (["evaluate", "mtf", "e.npy", "--aperture-px", "nan"], "one is 1; got nan"),
        (["evaluate", "mtf", "e.npy", "--at", "inf"], "a finite number; got inf"),
        (["evaluate", "mtf", "e.npy", "--gamma", "2200"], "2.2; got 2200"),
        (["evaluate", "fidelity", "e.npy", "e.npy", "--peak", "nan"], "a finite number; got nan"),
        (["evaluate", "gradient", "e.npy", "--share", "nan"], "a finite number; got nan"),
        (["evaluate", "star", "e.npy", "--cycles", "9", "--levels", "0,nan"], "levels like"),
        (["evaluate", "star", "e.npy", "--cycles", "9", "--center-px", "inf,1"], "a centre like"),
        (["evaluate", "zone", "e.npy", "--chirp", "nan"], "a finite number; got nan"),
        (["evaluate", "depth", "e.npy", "--noise-m", "5"], "5 mm are 0.005; got 5"),
        (["evaluate", "depth", "e.npy", "--edge-width-px", "2000"], "two are 2; got 2000"),
        (["evaluate", "depth", "e.npy", "--scale", "1000"], "'--scale'"),
        (["evaluate", "depth", "e.npy", "--min-step-m", "-1"], "50 mm are 0.05; got -1"),
    ],
)
def test_numbers_within_texts_and_of_images(
    refused: Refused, arguments: list[str], said: str
) -> None:
    np.save("e.npy", np.ones((16, 40)))
    refused(arguments, 2, said)


def test_a_pitch_in_um_is_doubted_where_an_image_is_measured(call: Call, tmp_path: Path) -> None:
    """Seen through a microscope, or on a chart, pixels may be of any size."""
    image = tmp_path / "e.npy"
    np.save(image, np.random.default_rng(0).random((16, 40)))
    done = call("evaluate", "frc", image, image, "--pitch-mm", "155")
    assert "got 155; 155 um are 0.155" in " ".join(done.stderr.split())


def test_ranges_hold_what_is_usual() -> None:
    assert _RANGES["pitch_mm"][1] == MOST_PITCH_MM
    assert in_range("object_mm", math.inf) == math.inf
    assert in_range("wavelength_nm", 10_600.0) == 10_600.0  # of CO2
    assert in_range("not_named", -1e300) == -1e300
    with pytest.raises(typer.BadParameter, match="a finite number; got inf"):
        in_range("not_named", math.inf)
