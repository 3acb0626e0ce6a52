"""Zemax files as others write them: glasses of several makers, prisms, encodings, what is said."""

import math
import warnings
from pathlib import Path

import numpy as np
import pytest
from foreign import BACK, FAR, FRONT, IMAGE, SINGLET, zmx
from lenses import pupil_grid

from lensshift.camera import LensOptics
from lensshift.cli.optics import LightOptions, read_lens
from lensshift.core.errors import DataError, QualityWarning
from lensshift.core.grid import Grid
from lensshift.optics.agf import load_glass_catalogue
from lensshift.optics.glass import refractive_index
from lensshift.optics.glass_called import glass_called, successor
from lensshift.optics.lens import Lens
from lensshift.optics.lens_file import format_lens, load_lens, parse_lens
from lensshift.optics.movers import which_mover
from lensshift.optics.paraxial import matrices_around_stop, paraxial
from lensshift.optics.trace import trace
from lensshift.optics.zmx import load_zmx, parse_zmx
from lensshift.pipeline.experiment_file import named_optics

FIELD, POINTS = np.array([0.01, -0.02]), pupil_grid(7)
D_NM = 587.5618


def same_rays(one: Lens, other: Lens) -> None:
    rays = [trace(lens, FIELD, POINTS).position_mm for lens in (one, other)]
    assert rays[1] == pytest.approx(rays[0], abs=1e-10)


@pytest.mark.parametrize(
    ("glass", "wavelength_nm", "index", "within"),
    [  # published: the papers and data sheets that the shipped catalogue names
        ("ZNSE", 10600.0, 2.4028, 2e-4),
        ("ZNS_BROAD", 10000.0, 2.2002, 1e-3),
        ("WATER", 589.3, 1.3334, 1e-4),
        ("KRS5", 10000.0, 2.3707, 1e-3),
        ("IG6", 10000.0, 2.7775, 1e-3),
        ("AMTIR1", 10000.0, 2.4976, 2e-3),
        ("YAG", D_NM, 1.8332, 5e-4),
        ("CSI", 10000.0, 1.7392, 1e-3),
        ("SK7", D_NM, 1.60729, 1e-5),
        ("LASFN30", D_NM, 1.80318, 1e-5),
        ("BAFN10", D_NM, 1.67003, 1e-5),
        ("F4", D_NM, 1.61659, 1e-5),
        ("BAF4", D_NM, 1.60562, 1e-5),
    ],
)
def test_glasses_that_files_of_others_name(
    glass: str, wavelength_nm: float, index: float, within: float
) -> None:
    name = glass_called(glass) or successor(glass)
    assert name is not None
    assert refractive_index(name, wavelength_nm) == pytest.approx(index, abs=within)


def test_moulded_glass_is_lower_by_the_same_in_all_light() -> None:
    """As its makers state; by the usual where nobody does, and then it is said."""
    for name, solid, index_d in (
        ("D-ZK3M", "D-ZK3", 1.58642),
        ("D-ZLAF52LA_M", "D-ZLAF52LA", 1.80588),
        ("L-TIM28_MOLD", "L-TIM28", 1.68403),
    ):
        lens = parse_zmx(zmx(FAR, FRONT.replace("N-BK7", name), BACK, IMAGE))
        assert lens.elements[0].glass == (name,)
        lower = refractive_index(solid, D_NM) - index_d
        assert 0.002 < lower < 0.006
        for nm in (450.0, D_NM, 850.0, 940.0):
            got = refractive_index(solid, nm) - refractive_index(name, nm)
            assert got == pytest.approx(lower, abs=1e-6)  # and its air is warmer
    with pytest.warns(QualityWarning, match="N-SK16_MOLD is moulded: index lower by 0.0044, as us"):
        lens = parse_zmx(zmx(FAR, FRONT.replace("N-BK7", "N-SK16_MOLD"), BACK, IMAGE))
    assert lens.indices()[0][0] == pytest.approx(refractive_index("N-SK16", D_NM) - 0.0044)
    assert parse_lens(format_lens(lens)) == lens
    assert glass_called("UNHEARDM") is None
    assert glass_called("M") is None


def test_quartz_is_the_crystal_and_silica_the_glass() -> None:
    for name, index in (("QUARTZ", 1.54426), ("SILICA", 1.45846)):
        lens = parse_zmx(zmx(FAR, FRONT.replace("N-BK7", name), BACK, IMAGE))
        assert lens.indices()[0][0] == pytest.approx(index, abs=2e-5)


@pytest.mark.parametrize("glass", ["___BLANK 1 0 1.5 0", "___BLANK 1 0 1.5 0.0 0.0", "N15"])
def test_an_index_without_dispersion_is_the_same_in_all_light(glass: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", QualityWarning)
        lens = parse_zmx(zmx(FAR, FRONT.replace("N-BK7 0 0 1.5 40", glass), BACK, IMAGE))
    for nm in (248.0, 450.0, 850.0, 10600.0):
        assert lens.indices(nm)[0][0] == pytest.approx(1.5, abs=1e-12)


def test_a_catalogue_knows_better_than_a_code(tmp_path: Path) -> None:
    front = FRONT.replace("N-BK7", "FEL7")
    with pytest.warns(QualityWarning, match="FEL7 is known by index and Abbe number only"):
        parse_zmx(zmx(FAR, front, BACK, IMAGE))
    (tmp_path / "own.agf").write_text("NM FEL7 1 0 1.5 60\nCD 2.25\nLD 0.3 2.5\n")
    load_glass_catalogue(tmp_path / "own.agf")
    lens = parse_zmx(zmx(FAR, front, BACK, IMAGE))
    assert lens.indices(850.0)[0][0] == pytest.approx(1.5, abs=1e-12)
    assert 'name = "FEL7"' in format_lens(lens)


def test_an_image_beside_the_axis() -> None:
    """Part of the field of a centred lens is traced, part of a mirror beside its axis is not."""
    aside = "TYPE COORDBRK; PARM 2 3; DISZ 0"
    with pytest.warns(QualityWarning, match="the image lies 3 mm aside: taken on the axis"):
        lens = parse_zmx(zmx(FAR, FRONT, BACK, aside, IMAGE))
    same_rays(parse_zmx(zmx(*SINGLET)), lens)
    parabola = zmx(
        FAR,
        "STOP; TYPE STANDARD; CURV 0; DISZ 200",
        "TYPE COORDBRK; PARM 2 -100; DISZ 0",
        "TYPE STANDARD; CURV -0.01; CONI -1; DISZ -50; GLAS MIRROR; DIAM 20",
        "TYPE STANDARD; SCBD 1 0 0 0 0 90 0 0; DISZ 0",
    )
    with pytest.raises(DataError, match=r"got one 100 mm aside.*part of a mirror beside"):
        parse_zmx(parabola)


def test_a_name_that_two_makers_have_goes_by_the_catalogues_of_the_file() -> None:
    front = FRONT.replace("N-BK7", "F4")
    for catalogues, index_d in (("SCHOTT MISC", 1.61659), ("CDGM MISC", 1.62005)):
        text = zmx(FAR, front, BACK, IMAGE, header=f"GCAT {catalogues}")
        if catalogues.startswith("CDGM"):
            lens = parse_zmx(text)
        else:
            with pytest.warns(QualityWarning, match="F4 is known by index and Abbe number only"):
                lens = parse_zmx(text)
        assert lens.indices()[0][0] == pytest.approx(index_d, abs=2e-5)
    assert successor("K4") is None  # K4A of CDGM is another glass


def test_a_glass_whose_constants_end_before_the_light_is_replaced_with_a_note() -> None:
    text = zmx(FAR, FRONT.replace("N-BK7", "SK16"), BACK, IMAGE)
    assert parse_zmx(text).elements[0].glass == ("SK16",)
    infrared = text.replace("WAVM 1 0.5875618", "WAVM 1 0.94")
    with pytest.warns(QualityWarning, match="SK16, known from 400 to 700 nm, taken as N-SK16"):
        assert parse_zmx(infrared).elements[0].glass == ("N-SK16",)
    with pytest.warns(QualityWarning, match="taken from its index and Abbe number"):
        lens = parse_zmx(infrared.replace("SK16", "SF12"))
    assert refractive_index(lens.elements[0].glass[0], D_NM) == pytest.approx(
        refractive_index("SF12", D_NM), abs=1e-9
    )
    with pytest.raises(DataError, match="wavelength from"):
        parse_zmx(text.replace("WAVM 1 0.5875618", "WAVM 1 10.6"))


def test_other_light_than_that_of_the_file(tmp_path: Path) -> None:
    (tmp_path / "lens.zmx").write_text(zmx(FAR, FRONT.replace("N-BK7", "SK16"), BACK, IMAGE))
    with pytest.warns(QualityWarning, match="SK16, known from 400 to 700 nm, taken as N-SK16"):
        lens = read_lens(str(tmp_path / "lens.zmx"), LightOptions(850.0))
    assert lens.elements[0].glass == ("N-SK16",)
    assert lens.indices()[0][0] == refractive_index("N-SK16", 850.0)


def test_what_has_no_power_moves_no_image() -> None:
    front, back = (one.replace("CURV 0.02", "CURV 0").replace("CURV -0.01", "CURV 0")
                   for one in (FRONT, BACK))  # fmt: skip
    with pytest.raises(ValueError, match="expected a lens with power"):
        which_mover(parse_zmx(zmx(FAR, front, back, IMAGE)), Grid((5, 9), (0.1, 0.1)))


def test_extended_odd_aspheres_and_diffractive_surfaces_without_phase() -> None:
    shapes = {
        "ODDASPHE": f"PARM 3 {0.01 / 8**3!r}; PARM 4 {0.002 / 8**4!r}",
        "XODDASPH": "XDAT 1 4; XDAT 2 8; XDAT 5 0.01; XDAT 6 0.002",
        "EVENASPH": "PARM 2 1e-6",
        "BINARY_2": "PARM 2 1e-6; XDAT 1 2; XDAT 2 8; XDAT 3 0; XDAT 4 0",
        "BINARY_1": "PARM 0 0; PARM 2 1e-6; XDAT 1 2; XDAT 2 8; XDAT 3 -80; XDAT 4 0",
    }
    odd, odd_too, even, second, first = (
        parse_zmx(zmx(FAR, FRONT.replace("TYPE STANDARD", f"TYPE {t}; {p}"), BACK, IMAGE))
        for t, p in shapes.items()
    )
    same_rays(odd, odd_too)
    same_rays(even, second)
    same_rays(even, first)


def test_a_grating_of_order_0_only_refracts() -> None:
    plain = parse_zmx(zmx(*SINGLET))
    for lines_and_order in ("PARM 1 0; PARM 2 1", "PARM 1 0.6; PARM 2 0"):
        front = FRONT.replace("STANDARD", f"DGRATING; {lines_and_order}")
        same_rays(plain, parse_zmx(zmx(FAR, front, BACK, IMAGE)))
    ruled = FRONT.replace("STANDARD", "DGRATING; PARM 1 0.6; PARM 2 1")
    with pytest.raises(DataError, match="got DGRATING, which diffracts light"):
        parse_zmx(zmx(FAR, ruled, BACK, IMAGE))


def test_a_prism_that_folds_is_the_plate_of_its_glass() -> None:
    turn = "TYPE COORDBRK; PARM 3 45; DISZ {}"
    glass = "CURV 0; DISZ {}; GLAS N-BK7; DIAM 9 1"
    near = BACK.replace("DISZ 60", "DISZ 5")
    straight = ("TYPE STANDARD; " + glass.format(20), "TYPE STANDARD; CURV 0; DISZ 30; DIAM 9 1")
    folded = (
        "TYPE STANDARD; " + glass.format(10), turn.format(0),
        "TYPE STANDARD; CURV 0; DISZ 0; GLAS MIRROR", turn.format(-10),
        "TYPE STANDARD; CURV 0; DISZ -30; DIAM 9 1",
    )  # fmt: skip
    plate, prism = (parse_zmx(zmx(FAR, FRONT, near, *p, IMAGE)) for p in (straight, folded))
    assert prism.elements[1].thickness_mm == pytest.approx((20.0,), abs=1e-12)
    same_rays(plate, prism)


def test_a_half_ball_reaches_to_its_equator() -> None:
    ball = "STOP; TYPE STANDARD; CURV 0.2; DISZ 5; GLAS N-BK7; DIAM 5 1"
    lens = parse_zmx(zmx(FAR, ball, "TYPE STANDARD; CURV 0; DISZ 5; DIAM 5 1", IMAGE))
    index = lens.indices()[0][0]
    assert paraxial(lens).focal_length_mm == pytest.approx(5.0 / (index - 1.0))
    assert lens.elements[0].surfaces[0].semi_diameter_mm == pytest.approx(5.0, rel=1e-8)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("PWAV 1", "PWAV 1\nMNUM 3 2", "one of 3 configurations"),
        ("SURF 3\n  TYPE STANDARD", "SURF 3\n  TYPE STANDARD\n  CURV -0.02", "image surface is c"),
        (
            "SURF 3\n  TYPE STANDARD",
            "SURF 3\n  TYPE TILTSURF\n  PARM 2 0.1",
            "of type TILTSURF: ta",
        ),
        ("PWAV 1", "PWAV 1\nTELE 1", "that the object space is telecentric is left out"),
        ("PWAV 1", "PWAV 1\nAFOC 1", "that the image is afocal is left out"),
        ("PWAV 1", "PWAV 1\nFTYP 1 1 1 1 0 0 0", "that the object space is telecentric is left"),
        ("PWAV 1", "PWAV 1\nFTYP 0 0 1 1 0 0 1", "that the image is afocal is left out"),
        ("PWAV 1", "PWAV 1\nGFAC 1 2", "brighter in the middle of the pupil is taken as even"),
        ("PWAV 1", "PWAV 1\nGFAC 2 0", "brighter in the middle of the pupil is taken as even"),
        ("PWAV 1", "PWAV 1\nVCYN 0 0.3", "vignetting factors are left out"),
        ("  DISZ 0", "  DISZ 4", "surface 3, the last, has more behind it"),
        ("  STOP", "  STOP\n  CLAP 0 5 0\n  OBDC 0 20", "surface 1: its aperture lies aside"),
    ],
)
def test_what_is_taken_otherwise_is_said(old: str, new: str, said: str) -> None:
    text = zmx(*SINGLET)
    assert text.count(old) == 1
    with pytest.warns(QualityWarning, match=said):
        same_rays(parse_zmx(text), parse_zmx(text.replace(old, new)))


@pytest.mark.parametrize(
    ("kind", "reason"),
    [
        ("GRINSUR5", "in which the index varies"),
        ("SZERNPHA", "which diffracts light"),
        ("ZERNSAG", "no surface of revolution"),
        ("GRIDSAG", "no surface of revolution"),
        ("PARAX_XY", "an ideal lens"),
        ("BIREF_IN", "treats polarisations differently"),
    ],
)
def test_the_kind_of_a_surface_is_the_reason_before_its_glass(kind: str, reason: str) -> None:
    with pytest.raises(DataError, match=f"got {kind}, .*{reason}"):
        parse_zmx(zmx(FAR, f"STOP; TYPE {kind}; DISZ 3; GLAS SLW-1.8", BACK, IMAGE))


@pytest.mark.parametrize("kind", ["utf-16", "utf-16-le", "utf-16-be", "utf-8-sig", "iso-8859-1"])
@pytest.mark.parametrize("end", ["\r\n", "\n", "\r"])
def test_encodings_ends_of_lines_and_what_follows(kind: str, end: str, tmp_path: Path) -> None:
    # \x85 ends a line for Python, in a name it is the dots of "f\xfcr \x85" only.
    text = zmx(*SINGLET, header="NAME f\xfcr \x85SURF").replace("\n", end)
    junk = b"\r" if "16" in kind else b"\x1a\0\0\0\xff%"
    (tmp_path / "lens.zmx").write_bytes(text.encode(kind) + junk)
    same_rays(parse_zmx(zmx(*SINGLET)), load_zmx(tmp_path / "lens.zmx"))


def test_a_zemax_file_is_a_lens_wherever_lenses_are_named(tmp_path: Path) -> None:
    (tmp_path / "Lens.ZMX").write_text(zmx(*SINGLET))
    same_rays(parse_zmx(zmx(*SINGLET)), load_lens(tmp_path / "Lens.ZMX"))
    optics = named_optics(str(tmp_path / "Lens.ZMX"), 1)
    assert isinstance(optics, LensOptics)
    assert optics.lens == load_lens(tmp_path / "Lens.ZMX")


def test_without_an_aperture_the_stop_is_as_wide_as_its_surface() -> None:
    text = zmx(*SINGLET)
    with pytest.warns(QualityWarning, match="no aperture is given"):
        lens = parse_zmx(text.replace("ENPD 10", ""))
    same_rays(parse_zmx(text.replace("ENPD 10", "FLOA")), lens)


def test_a_cone_from_infinitely_far_is_said_to_mean_nothing() -> None:
    with pytest.warns(QualityWarning, match=r"^a cone from infinitely far is given: [^;]*$"):
        lens = parse_zmx(zmx(*SINGLET, aperture="OBNA 0.1 0"))
    assert lens.stop.diameter_mm == 24.0


def test_a_file_that_is_cut_off_is_refused() -> None:
    text = zmx(*SINGLET)
    for number in (1, 2):
        with pytest.raises(DataError, match=r"cut off|at least one surface"):
            parse_zmx(text[: text.index(f"SURF {number + 1}")])
    assert math.isinf(parse_zmx(text).object_mm)


@pytest.mark.parametrize(
    ("suffix", "program"), [(".seq", "CODE V"), (".LEN", "OSLO"), (".zar", "archive")]
)
def test_files_of_other_programs_are_refused_by_name(
    tmp_path: Path, suffix: str, program: str
) -> None:
    path = tmp_path / f"bought{suffix}"
    path.write_text("RDM;LEN\nEPD 10\nS 50 4 NBK7_SCHOTT\nGO\n")
    with pytest.raises(DataError, match=program):
        load_lens(path)


def test_a_surface_that_is_not_traced_is_refused_for_its_shape_and_not_for_its_parameters() -> None:
    front = FRONT.replace("STANDARD", "SZERNSAG; PARM 13 3")
    with pytest.raises(DataError, match="SZERNSAG"):
        parse_zmx(zmx(FAR, front, BACK, IMAGE))


def test_a_curved_object_is_said_where_it_is_near() -> None:
    """Its vertex is imaged as that of a plane; of one infinitely far nothing is to be said."""
    near = "TYPE STANDARD; CURV {}; DISZ 300"
    with pytest.warns(QualityWarning, match="the object is curved: taken as the plane at its"):
        curved = parse_zmx(zmx(near.format(0.002), FRONT, BACK, IMAGE))
    flat = parse_zmx(zmx(near.format(0.0), FRONT, BACK, IMAGE))
    assert paraxial(curved).image_mm == paraxial(flat).image_mm
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        parse_zmx(zmx(FAR + "; CURV 0.002", FRONT, BACK, IMAGE))


def test_a_catalogue_goes_before_the_package(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Glass of a melt of its own, and a name that the package has for another glass."""
    monkeypatch.setattr("lensshift.optics.glass._added", {})
    melt = "NM N-BK7 1 0 1.517 64\nCD 2.3013\nLD 0.3 2.5\n"
    other = "NM SILICA 1 0 1.6 60\nCD 2.56\nLD 0.3 2.5\n"
    (tmp_path / "own.agf").write_text(melt + other)
    with pytest.warns(QualityWarning, match="N-BK7: taken as given, which is another glass"):
        load_glass_catalogue(tmp_path / "own.agf")
    for name, index in (("N-BK7", math.sqrt(2.3013)), ("SILICA", 1.6)):
        lens = parse_zmx(zmx(FAR, FRONT.replace("N-BK7", name), BACK, IMAGE))
        assert lens.indices(850.0)[0][0] == pytest.approx(index, abs=1e-12)
        assert f'name = "{name}"' in format_lens(lens)


def test_of_two_catalogues_the_first_goes_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Makers use names of others for other glasses; the rest of a catalogue was lost with them."""
    monkeypatch.setattr("lensshift.optics.glass._added", {})
    one = "NM MINE 1 0 1.5 60\nCD 2.25\nLD 0.3 2.5\n"
    two = one.replace("2.25", "2.56") + one.replace("MINE", "YOURS").replace("2.25", "2.89")
    again = one + one.replace("2.25", "2.2801")
    for name, text in (("one", one), ("two", two), ("again", again)):
        (tmp_path / f"{name}.agf").write_text(text.replace(" 1.5 60", ""))
    load_glass_catalogue(tmp_path / "one.agf")
    with pytest.warns(QualityWarning, match="MINE: left out, as another glass of this name"):
        load_glass_catalogue(tmp_path / "two.agf")
    assert refractive_index("MINE", 850.0) == pytest.approx(1.5, abs=1e-12)
    assert refractive_index("YOURS", 850.0) == pytest.approx(1.7, abs=1e-12)
    with pytest.warns(QualityWarning, match="line 4: MINE is there twice, the first is taken"):
        load_glass_catalogue(tmp_path / "again.agf")


def test_light_beside_a_narrow_range_is_told_and_not_that_of_the_d_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of a glass that is known about the C line only no Abbe number can be taken."""
    monkeypatch.setattr("lensshift.optics.glass._added", {})
    (tmp_path / "own.agf").write_text("NM NARROW 1 0\nCD 2.25\nLD 0.6 0.7\n")
    load_glass_catalogue(tmp_path / "own.agf")
    text = zmx(FAR, FRONT.replace("N-BK7", "NARROW"), BACK, IMAGE)
    with pytest.raises(DataError, match="from 600 to 700 nm for NARROW, got 850"):
        parse_zmx(text.replace("WAVM 1 0.5875618", "WAVM 1 0.85"))


def test_an_image_in_glass_is_refused_for_that() -> None:
    wet = BACK.replace("DIAM", "GLAS ___BLANK 1 0 1.333 55; DIAM")
    with pytest.raises(DataError, match=r"got model:1\.333:55.*image in glass or a liquid"):
        parse_zmx(zmx(FAR, FRONT, wet, IMAGE))


def test_a_catalogue_that_agrees_with_the_package_changes_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("lensshift.optics.glass._added", {})
    one = "NM N-BK7 2 517642.251 1.5168 64.17\nCD 1.03961212 0.00600069867 0.231792344 "
    (tmp_path / "own.agf").write_text(
        one + "0.0200179144 1.01046945 103.560653\nTD _ _ _ _ _ _\nLD 0.31 2.4\n"
    )
    load_glass_catalogue(tmp_path / "own.agf")
    assert "[[glass]]" not in format_lens(parse_zmx(zmx(*SINGLET)))


def test_constants_that_contradict_their_entry_are_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("lensshift.optics.glass._added", {})
    (tmp_path / "own.agf").write_text("NM ODD3 1 0 1.6 60\nCD 2.25\nLD 0.3 2.5\n")
    with pytest.warns(QualityWarning, match=r"line 1: the constants of ODD3 give n_d 1.5, its ent"):
        load_glass_catalogue(tmp_path / "own.agf")


def test_semi_diameters_for_the_axis_alone_do_not_stop_the_field() -> None:
    """A program makes surfaces as wide as the light of the fields that the file has."""
    surfaces = (
        FAR,
        FRONT.replace("DIAM 12 1", "DIAM 5 0"),
        BACK.replace("DIAM 12 1", "DIAM 4.7 0"),
    )
    axis, wide = "XFLN 0 0\nYFLN 0 0", "XFLN 0 0\nYFLN 0 14"
    with pytest.warns(QualityWarning, match="hold for the axis only"):
        lens = parse_zmx(zmx(*surfaces, IMAGE, header=axis))
    field, points = np.array([0.1, -0.2]), pupil_grid(9)
    assert trace(lens, field, points).passed.all()
    assert lens.stop.diameter_mm == pytest.approx(10.0)
    clipped = parse_zmx(zmx(*surfaces, IMAGE, header=wide))
    assert not trace(clipped, field, points).passed.all()
    fixed = (one.replace("DIAM 4.7 0", "DIAM 4.7 1").replace("DIAM 5 0", "") for one in surfaces)
    assert not trace(parse_zmx(zmx(*fixed, IMAGE, header=axis)), field, points).passed.all()


@pytest.mark.parametrize("apart_mm", [40.0, 70.0])
def test_a_numerical_aperture_in_front_of_and_behind_the_telecentric_stop(apart_mm: float) -> None:
    """Behind the focal plane of the first lens the entrance pupil lies in front of the object."""
    near, lens_mm = "TYPE STANDARD; DISZ 60", "TYPE STANDARD; CURV 0.016; DISZ 4; GLAS N-BK7"
    back = "TYPE STANDARD; CURV -0.016; DISZ {}"
    text = zmx(
        near, lens_mm, back.format(apart_mm), "STOP; TYPE STANDARD; DISZ 20", lens_mm,
        back.format(60), IMAGE, aperture="OBNA 0.05 0",
    )  # fmt: skip
    lens = parse_zmx(text)
    slope = math.tan(math.asin(0.05))
    at_stop_mm = matrices_around_stop(lens)[0] @ [60.0 * slope, slope]
    assert lens.stop.diameter_mm == pytest.approx(2.0 * abs(at_stop_mm[0]), rel=1e-9)
