"""Lens files and glass catalogues as other programs write them, construct by construct."""

import math
import re
import warnings
from pathlib import Path

import numpy as np
import pytest
from foreign import BACK, FAR, FRONT, IMAGE, SINGLET, zmx
from lenses import pupil_grid

from lensshift.core.errors import DataError, QualityWarning
from lensshift.optics.agf import load_glass_catalogue, parse_agf
from lensshift.optics.forbes import forbes_terms
from lensshift.optics.glass import model_glass, refractive_index
from lensshift.optics.glass_called import glass_called
from lensshift.optics.layout import layout
from lensshift.optics.lens import Lens
from lensshift.optics.lens_file import format_lens, parse_lens
from lensshift.optics.paraxial import paraxial
from lensshift.optics.trace import trace
from lensshift.optics.zmx import load_zmx, parse_zmx
from lensshift.optics.zmx_writer import format_zmx

POINTS = pupil_grid(7)
AXIS, FIELD = np.zeros(2), np.array([0.01, -0.02])


def check_written_again(lens: Lens) -> None:
    """Check that the lens reads back from both formats and traces the same to 1e-9 mm."""
    for back in (parse_zmx(format_zmx(lens)), parse_lens(format_lens(lens))):
        one, other = trace(lens, FIELD, POINTS), trace(back, FIELD, POINTS)
        assert other.position_mm == pytest.approx(one.position_mm, abs=1e-9, nan_ok=True)
        assert other.passed.tolist() == one.passed.tolist()


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "iso-8859-1"])
def test_encodings(tmp_path: Path, encoding: str) -> None:
    text = zmx(*SINGLET, header="NAME Linse für 0°")
    (tmp_path / "lens.zmx").write_text(text, encoding=encoding)
    assert load_zmx(tmp_path / "lens.zmx").name == "Linse für 0°"


@pytest.mark.parametrize(("unit", "mm"), [("MM", 1.0), ("CM", 10.0), ("IN", 25.4), ("METER", 1e3)])
def test_lengths_of_every_kind_scale_with_the_unit(unit: str, mm: float) -> None:
    def text(of: float, unit: str) -> str:
        return zmx(
            f"TYPE STANDARD; DISZ {500 / of!r}",
            f"TYPE COORDBRK; PARM 1 {0.1 / of!r}; PARM 2 {-0.2 / of!r}; PARM 3 0.3; DISZ 0",
            f"STOP; TYPE EVENASPH; CURV {0.02 * of!r}; PARM 1 {1e-4 * of!r}; "
            f"PARM 2 {1e-6 * of**3!r}; DISZ {4 / of!r}; GLAS N-BK7; DIAM {12 / of!r} 1",
            f"TYPE ODDASPHE; CURV {-0.01 * of!r}; PARM 3 {1e-5 * of**2!r}; DISZ {-4 / of!r}",
            f"TYPE COORDBRK; PARM 1 {-0.1 / of!r}; PARM 2 {0.2 / of!r}; PARM 3 -0.3; PARM 6 1; "
            f"DISZ {70 / of!r}",
            IMAGE,
            unit=unit,
            aperture=f"ENPD {10 / of!r}",
        )

    wanted = trace(parse_zmx(text(1.0, "MM")), FIELD, POINTS)
    got = trace(parse_zmx(text(mm, unit)), FIELD, POINTS)
    assert wanted.passed.all()
    assert got.position_mm == pytest.approx(wanted.position_mm, abs=1e-9)


def test_terms_in_odd_powers_and_in_r2_are_the_shapes_they_say() -> None:
    # 1/2 c r^2 alone is a paraboloid, and even powers may be written as odd aspheres.
    square = FRONT.replace("STANDARD; CURV 0.02", "EVENASPH; CURV 0; PARM 1 0.01")
    parabola = FRONT.replace("CURV 0.02", "CURV 0.02; CONI -1")
    odd = FRONT.replace("STANDARD; CURV 0.02", "ODDASPHE; CURV 0; PARM 2 0.01; PARM 4 1e-6")
    even = FRONT.replace("STANDARD; CURV 0.02", "EVENASPH; CURV 0.02; CONI -1; PARM 2 1e-6")
    for one, other in ((square, parabola), (odd, even)):
        lenses = [parse_zmx(zmx(FAR, front, BACK, IMAGE)) for front in (one, other)]
        rays = [trace(lens, FIELD, POINTS).position_mm for lens in lenses]
        assert rays[0] == pytest.approx(rays[1], abs=1e-10)
        data = [paraxial(lens).focal_length_mm for lens in lenses]
        assert data[0] == pytest.approx(data[1], rel=1e-12)
        check_written_again(lenses[0])


def test_an_odd_power_against_the_slope_of_its_surface() -> None:
    # z = B3 r^3 on a plate: one ray, Snell's law written out.
    text = zmx(
        FAR, "STOP; TYPE ODDASPHE; CURV 0; PARM 3 1e-4; DISZ 5; GLAS N-BK7", BACK, IMAGE
    ).replace("CURV -0.01", "CURV 0")
    lens = parse_zmx(text)
    height = 5.0
    got = trace(lens, AXIS, [[1.0, 0.0]], crossings=True).crossing_mm
    assert got is not None
    slope, sag = 3e-4 * height**2, 1e-4 * height**3
    inside = math.atan(slope) - math.asin(math.sin(math.atan(slope)) / lens.indices()[0][0])
    assert got[0, 0] == pytest.approx([height, 0.0, sag], abs=1e-9)
    assert got[0, 1, 0] == pytest.approx(height - math.tan(inside) * (5.0 - sag), abs=1e-9)


def test_extended_asphere() -> None:
    unit = 8.0
    extended = FRONT.replace(
        "TYPE STANDARD", f"TYPE XASPHERE; XDAT 1 3; XDAT 2 {unit}; XDAT 3 0.064; XDAT 4 0.004"
    )
    even = FRONT.replace(
        "TYPE STANDARD", f"TYPE EVENASPH; PARM 1 {0.064 / unit**2}; PARM 2 {0.004 / unit**4}"
    )
    rays = [trace(parse_zmx(zmx(FAR, f, BACK, IMAGE)), FIELD, POINTS) for f in (extended, even)]
    assert rays[0].position_mm == pytest.approx(rays[1].position_mm, abs=1e-10)


def q_type(kind: int, unit: float, *terms: float) -> str:
    data = (kind, len(terms), unit, *terms)
    told = "; ".join(f"XDAT {i} {value!r}" for i, value in enumerate(data, start=1))
    return FRONT.replace("TYPE STANDARD", f"TYPE QED_TYPE; CONI -0.6; {told}")


def test_q_type_aspheres_are_the_shapes_that_forbes_defines() -> None:
    unit, first, second = 14.0, 0.3, -0.05
    heights = np.linspace(0.0, 12.0, 40)
    square = (heights / unit) ** 2
    slope = (0.02 * heights) ** 2 / (1.0 - 0.4 * (0.02 * heights) ** 2)  # of the conic, squared
    series = first + second * (13.0 - 16.0 * square) / math.sqrt(19.0)
    added = {
        0: square * (1.0 - square) * series * np.sqrt(1.0 + slope),
        1: square**2 * (first + second * (6.0 * square - 5.0)),
    }
    conic = parse_zmx(zmx(FAR, FRONT.replace("CURV", "CONI -0.6; CURV"), BACK, IMAGE))
    for kind, wanted in added.items():
        lens = parse_zmx(zmx(FAR, q_type(kind, unit, first, second), BACK, IMAGE))
        one, other = (a.elements[0].surfaces[0].sag_mm(heights) for a in (lens, conic))
        assert one - other == pytest.approx(wanted, abs=2e-9)
        check_written_again(lens)
    with pytest.raises(DataError, match=r"surface 1, line .*: expected a conic up to the edge"):
        parse_zmx(zmx(FAR, q_type(0, unit, first).replace("CURV 0.02", "CURV 0.2"), BACK, IMAGE))


def test_the_slopes_of_q_type_aspheres_are_orthonormal() -> None:
    nodes = np.cos(math.pi * (np.arange(200) + 0.5) / 200)  # weight 1 / sqrt(1 - u^2)
    slopes = []
    for number in range(6):
        terms = forbes_terms(False, [0.0] * number + [1.0], 1.0, (0.0, 0.0), 1.0)
        slopes.append(sum(2 * i * a * nodes ** (2 * i - 1) for i, a in enumerate(terms, start=1)))
    products = np.mean(np.array(slopes)[:, None] * np.array(slopes), axis=-1)
    assert products == pytest.approx(np.eye(6), abs=1e-9)


def test_more_powers_than_an_even_asphere_has_are_written_as_an_extended_one() -> None:
    terms = "; ".join(f"XDAT {2 + i} {1e-3 / i}" for i in range(1, 11))
    for kind in ("XASPHERE", "XODDASPH"):
        front = FRONT.replace("TYPE STANDARD", f"TYPE {kind}; XDAT 1 10; XDAT 2 13; {terms}")
        check_written_again(parse_zmx(zmx(FAR, front, BACK, IMAGE)))


def test_model_glass() -> None:
    front = FRONT.replace("N-BK7 0 0 1.5 40", "___BLANK 1 0 1.5168 64.17")
    lens = parse_zmx(zmx(FAR, front, BACK, IMAGE))
    assert lens.indices()[0][0] == pytest.approx(1.5168, abs=1e-12)
    name = lens.elements[0].glass[0]
    d, f, c = (refractive_index(name, nm) for nm in (587.5618, 486.1327, 656.2725))
    assert (d - 1.0) / (f - c) == pytest.approx(64.17)
    # Real glasses follow within a few 1e-4 up to the near infrared.
    for glass, index_d, abbe in (("N-BK7", 1.5168, 64.17), ("N-SF11", 1.78472, 25.68)):
        made = model_glass(index_d, abbe)
        for nm in (450.0, 700.0, 850.0, 940.0):
            assert refractive_index(made, nm) == pytest.approx(
                refractive_index(glass, nm), abs=1.5e-3
            )
    check_written_again(lens)


def test_names_of_glasses() -> None:
    assert glass_called("bk7") == "N-BK7"
    assert glass_called("F_Silica") == "fused silica"
    assert glass_called("n-baf10") == "N-BAF10"
    assert refractive_index("N-BAF10", 587.5618) == pytest.approx(1.67003, abs=1e-5)
    assert refractive_index("CAF2", 587.5618) == pytest.approx(1.43384, abs=2e-5)
    assert refractive_index("PMMA", 587.5618) == pytest.approx(1.4906, abs=1e-3)
    code = glass_called("517642")
    assert code is not None
    assert refractive_index(code, 587.5618) == pytest.approx(1.517)
    with pytest.warns(QualityWarning, match="glass SK11 taken as N-SK11"):
        parse_zmx(zmx(FAR, FRONT.replace("N-BK7", "SK11"), BACK, IMAGE))
    front = FRONT.replace("N-BK7 0 0 1.5 40", "UNHEARD 0 0 1.61 55.2")
    with pytest.warns(QualityWarning, match="glass UNHEARD taken from its index 1.61"):
        parse_zmx(zmx(FAR, front, BACK, IMAGE))
    with pytest.raises(DataError, match="got UNHEARD: load the catalogue"):
        parse_zmx(zmx(FAR, FRONT.replace("N-BK7", "UNHEARD"), BACK, IMAGE))


def test_a_virtual_image_lies_in_front_of_the_last_surface() -> None:
    front, back = FRONT.replace("0.02", "-0.02"), BACK.replace("-0.01", "0.02")
    away = paraxial(parse_zmx(zmx(FAR, front, back, IMAGE))).back_focal_mm
    lens = parse_zmx(zmx(FAR, front, back.replace("DISZ 60", f"DISZ {away!r}"), IMAGE))
    assert lens.gaps_mm[-1] == away < 0
    near = trace(lens, AXIS, 0.01 * POINTS).position_mm
    assert np.abs(near).max() < 1e-4  # paraxial rays meet there
    check_written_again(lens)


@pytest.mark.parametrize("aside_mm", [-9.0, -3.0, -1.0, 70.0])
def test_a_stop_that_lies_where_its_light_does_not_go_is_a_virtual_one(aside_mm: float) -> None:
    lens_alone = (FRONT.replace("STOP; ", ""), BACK)
    stop = "STOP; TYPE STANDARD; CURV 0; DISZ {}; DIAM 9 1"
    far = abs(aside_mm) if aside_mm < 0 else 70.0  # behind the first vertex, behind the sensor too
    before = parse_zmx(zmx(FAR, stop.format(-far), *lens_alone, IMAGE))
    data = paraxial(before)  # the plane itself, as no element stands in front of it
    assert (data.entrance_pupil_mm, before.stop.diameter_mm) == (far, 10.0)
    chief = trace(before, FIELD, np.zeros((1, 2)), crossings=True).crossing_mm
    assert chief is not None
    slope = np.array([*FIELD, 1.0])
    assert chief[0, 0] - slope * (chief[0, 0, 2] - far) == pytest.approx([0, 0, far], abs=1e-9)
    assert layout(before).virtual_stop
    assert not layout(parse_zmx(zmx(*SINGLET))).virtual_stop
    check_written_again(before)
    front, back = lens_alone[0], BACK.replace("DISZ 60", f"DISZ {-abs(aside_mm)}")
    behind = parse_zmx(zmx(FAR, front, back, stop.format(60.0 + abs(aside_mm)), IMAGE))
    assert paraxial(behind).exit_pupil_mm == pytest.approx(-abs(aside_mm), abs=1e-9)
    check_written_again(behind)


def test_a_pupil_wider_than_the_clear_aperture_is_clipped() -> None:
    front = FRONT.replace("DIAM 12 1", "DIAM 12.5 1; CLAP 0 11.25 0")
    with pytest.warns(QualityWarning, match=r"stop of 25 mm clipped .* 22\.5 mm"):
        lens = parse_zmx(zmx(FAR, front, BACK, IMAGE, aperture="ENPD 25"))
    assert lens.stop.diameter_mm == 22.5
    float_lens = parse_zmx(zmx(FAR, front, BACK, IMAGE, aperture="ENPD 0"))
    assert float_lens.stop.diameter_mm == 22.5


def test_apertures_of_every_kind_are_the_same_pupil() -> None:
    near = ("TYPE STANDARD; DISZ 200", *SINGLET[1:])
    lens = parse_zmx(zmx(*near))
    data = paraxial(lens)
    sine = math.sin(math.atan(5.0 / 200.0))
    for aperture in (
        f"FNUM {data.f_number!r} 0", f"FNUM {data.working_f_number!r} 1", f"OBNA {sine!r} 0",
        f"OBNA {math.degrees(math.asin(sine))!r} 1",
    ):  # fmt: skip
        other = parse_zmx(zmx(*near, aperture=aperture))
        assert other.stop.diameter_mm == pytest.approx(10.0, rel=1e-9)


def test_the_temperature_of_a_file_counts_only_where_it_is_adjusted_to() -> None:
    def read(surroundings: str) -> float:
        lens = parse_zmx(zmx(*SINGLET, header=f"ENVD {surroundings}"))
        return lens.indices()[0][0]

    warm, cold = (refractive_index("N-BK7", 587.5618, at_c) for at_c in (80.0, 20.0))
    assert read("80 1 1") == pytest.approx(warm, abs=1e-12)
    with pytest.warns(QualityWarning, match="not adjusted to 80 C"):
        assert read("80 0 0") == pytest.approx(cold, abs=1e-12)
    with pytest.warns(QualityWarning, match="air of 0 atm"):
        read("20 0 1")


def test_a_pupil_wider_than_the_clear_aperture_of_its_stop_is_clipped() -> None:
    stop = "STOP; TYPE STANDARD; CURV 0; DISZ 2; CLAP 0 4 0; DIAM 6 1"
    text = zmx(FAR, stop, FRONT.replace("STOP; ", ""), BACK, IMAGE, aperture="ENPD 10")
    with pytest.warns(QualityWarning, match="stop of 10 mm clipped to what is clear at it, 8 mm"):
        assert parse_zmx(text).stop.diameter_mm == 8.0


def test_a_stop_may_be_wider_than_the_mirror_in_front_of_it() -> None:
    # f -60 mm, and 60 mm on the beam is twice as wide.
    text = zmx(
        FAR,
        f"TYPE STANDARD; CURV {1 / 120!r}; DISZ -60; GLAS MIRROR; DIAM 12 1",
        f"STOP; TYPE STANDARD; CURV {1 / 150!r}; DISZ 200; GLAS MIRROR; DIAM 25 1",
        IMAGE,
        aperture="ENPD 20",
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        lens = parse_zmx(text)
    assert lens.stop.diameter_mm == pytest.approx(40.0, rel=1e-12)
    assert paraxial(lens).entrance_pupil_diameter_mm == pytest.approx(20.0, rel=1e-12)
    assert trace(lens, AXIS, POINTS).passed.all()
    check_written_again(lens)


def test_edges_that_cross_are_clipped_with_a_note() -> None:
    front = FRONT.replace("0.02", "0.05").replace("DISZ 4", "DISZ 3")
    with pytest.warns(QualityWarning, match="surface 1: edges cross, clipped to"):
        lens = parse_zmx(zmx(FAR, front, BACK, IMAGE))
    assert 6.0 < lens.elements[0].surfaces[0].semi_diameter_mm < 12.0


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("behind", [False, True])
def test_a_stop_whose_rim_lies_beside_a_curved_surface(behind: bool, seed: int) -> None:
    """As in lenses of telephones: its plane cuts the glass, its rim lies in air."""
    points = np.random.default_rng(seed).uniform(-0.7, 0.7, (9, 2))
    front, stop = FRONT.replace("STOP; ", ""), "STOP; TYPE STANDARD; DISZ {}"
    back = BACK.replace("-0.01", "-0.02")
    surfaces = (
        (front, back.replace("DISZ 60", "DISZ -0.2"), stop.format(60.2))
        if behind
        else (stop.format(-0.2), front, back)
    )
    lens = parse_zmx(zmx(FAR, *surfaces, IMAGE))  # nothing is said: it is as it is written
    rays = trace(lens, FIELD, points)
    wanted_mm = 0.5 * lens.stop.diameter_mm * points
    if behind:
        slopes = rays.direction[..., :2] / rays.direction[..., 2:]
        assert rays.position_mm - 60.2 * slopes == pytest.approx(wanted_mm, abs=1e-9)
    else:  # the same rays through the plane of the vertex
        at_vertex = parse_zmx(zmx(FAR, FRONT, back, IMAGE))
        same = trace(at_vertex, FIELD, points - 0.2 * FIELD / (0.5 * lens.stop.diameter_mm))
        assert rays.position_mm == pytest.approx(same.position_mm, abs=1e-10)
    check_written_again(lens)


def test_a_stop_in_cemented_glass_is_taken_in_the_air_beside_it() -> None:
    front = FRONT.replace("STOP; ", "")
    middle = "STOP; TYPE STANDARD; CURV -0.02; DISZ 2; GLAS N-SF11; DIAM 12 1"
    with pytest.warns(
        QualityWarning, match=r"stop lies in element 1 \(surfaces 1-3\): taken in the air"
    ):
        lens = parse_zmx(zmx(FAR, front, middle, BACK, IMAGE))
    assert lens.stop.position_mm == pytest.approx(4.0)
    assert lens.elements_before_stop() == 1


def test_a_paraboloid_and_a_cassegrain_image_an_axial_point_perfectly() -> None:
    mirror = "TYPE STANDARD; CURV -0.005; CONI -1; DISZ {}; GLAS MIRROR; DIAM 30 1"
    lens = parse_zmx(zmx(FAR, f"STOP; {mirror.format(-100)}", IMAGE, aperture="ENPD 50"))
    assert paraxial(lens).focal_length_mm == pytest.approx(100.0)
    assert np.abs(trace(lens, AXIS, POINTS).position_mm).max() < 1e-12
    check_written_again(lens)
    # The secondary, 70 mm in front, images the focus 30 mm behind it to 90 mm: magnification
    # m = 3, radius 2 p m / (m - 1) = 90 mm, conic -((m + 1) / (m - 1))^2 = -4.
    second = f"TYPE STANDARD; CURV {-1 / 90!r}; CONI -4; DISZ 90; GLAS MIRROR; DIAM 12 1"
    lens = parse_zmx(zmx(FAR, f"STOP; {mirror.format(-70)}", second, IMAGE, aperture="ENPD 50"))
    assert paraxial(lens).focal_length_mm == pytest.approx(300.0)
    rays = trace(lens, AXIS, POINTS)
    assert np.abs(rays.position_mm).max() < 1e-11
    assert np.ptp(rays.path_mm) < 1e-11
    check_written_again(lens)


def test_a_sphere_reflects_by_its_angle_of_incidence() -> None:
    mirror = "STOP; TYPE STANDARD; CURV -0.005; DISZ -100; GLAS MIRROR; DIAM 60 1"
    lens = parse_zmx(zmx(FAR, mirror, IMAGE, aperture="ENPD 60"))
    for share in (0.3, 0.7, 1.0):
        height = 30.0 * share
        angle = math.asin(height / 200.0)
        sag = 200.0 - 200.0 * math.cos(angle)
        wanted = height - math.tan(2.0 * angle) * (100.0 - sag)
        got = trace(lens, AXIS, [[share, 0.0]]).position_mm[0, 0]
        assert got == pytest.approx(wanted, abs=1e-12)


def test_a_mangin_mirror_reads_back() -> None:
    glass = "GLAS N-BK7; DIAM 20 1"
    lens = parse_zmx(
        zmx(
            FAR,
            f"STOP; TYPE STANDARD; CURV -0.01; DISZ 4; {glass}",
            "TYPE STANDARD; CURV -0.008; DISZ -4; GLAS MIRROR; DIAM 20 1",
            "TYPE STANDARD; CURV -0.01; DISZ -55; DIAM 20 1",
            IMAGE,
        )
    )
    index = lens.indices()[0][0]
    # Thick lens by hand: refraction, reflection in glass, refraction, all against the axis.
    step = np.array([[1.0, 4.0], [0.0, 1.0]])
    into = np.array([[1.0, 0.0], [-(index - 1.0) / index * -0.01, 1.0 / index]])
    turn = np.array([[1.0, 0.0], [2.0 * -0.008, 1.0]])
    out = np.array([[1.0, 0.0], [-(1.0 - index) * 0.01, index]])
    power = -(out @ step @ turn @ step @ into)[1, 0]
    assert paraxial(lens).focal_length_mm == pytest.approx(1.0 / power)
    check_written_again(lens)


def test_fold_mirrors_only_fold() -> None:
    turn = "TYPE COORDBRK; PARM 3 45; DISZ {}"
    folded = (
        FAR, FRONT, BACK.replace("DISZ 60", "DISZ 25"), turn.format(0),
        "TYPE STANDARD; CURV 0; DISZ 0; GLAS MIRROR", turn.format(-35), IMAGE,
    )  # fmt: skip
    straight, bent = (parse_zmx(zmx(*surfaces)) for surfaces in (SINGLET, folded))
    assert len(bent.elements) == 1
    assert bent.gaps_mm == pytest.approx(straight.gaps_mm)
    one, other = (trace(lens, FIELD, POINTS).position_mm for lens in (straight, bent))
    assert other == pytest.approx(one, abs=1e-10)


@pytest.mark.parametrize(
    ("surface", "reason"),
    [
        ("TYPE TOROIDAL; CURV 0.01; DISZ 3; GLAS N-BK7", "no surface of revolution"),
        ("TYPE DGRATING; DISZ 3; GLAS N-BK7", "diffracts"),
        ("TYPE BINARY_2; XDAT 3 -5.0; DISZ 3; GLAS N-BK7", "diffracts"),
        ("TYPE PARAXIAL; PARM 1 100; DISZ 3", "ideal lens"),
        ("TYPE SUPERCON; DISZ 3", "shape is not known"),
        ("TYPE STANDARD; SCBD 1 0 0 0.5 0 5 0 0; DISZ 3", "as a property of the surface"),
    ],
)
def test_what_cannot_be_traced_is_refused_with_its_reason(surface: str, reason: str) -> None:
    with pytest.raises(DataError, match=f"surface 3.*{reason}"):
        parse_zmx(zmx(*SINGLET[:3], surface, IMAGE))


def test_entries_that_do_not_touch_the_light_are_skipped() -> None:
    noise = (
        "COMM front; MEMO 4; NOTE 0 what a lens; SLAB 3; FIMP ; COAT AR; HIDE 0 0; MIRR 2 0; "
        "PPAR 1; PZUP 3 1 0; MAZH 0 0; MEMA 12.5 0 0; POPS 0 0; XDAT 5 0 0"
    )
    header = "VERS 140124\nGCAT SCHOTT INFRARED\nPRIM 2\nFTYP 0 0 3\nMNUM 1 1\nPUPD 0 0\nRAIM 0 0"
    header += "\nROPD 2\nPICB 1\nXFLN 0 0 0\nYFLN 0 10 20\nWAVM 24 0.55 1\nBLNK"
    text = zmx(FAR, f"{FRONT}; {noise}", BACK, IMAGE, header=header) + "\nTOL TOFF 0\nMOFF 0 1"
    one, other = parse_zmx(text), parse_zmx(zmx(*SINGLET))
    assert trace(one, FIELD, POINTS).position_mm.tolist() == (
        trace(other, FIELD, POINTS).position_mm.tolist()
    )
    assert one.elements[0].name == "front"


# One glass of each formula, with constants that make the index easy to write out.
AGF = """CC constructed
NM T-SCHOTT 1 0 1.5 60 0 1
CD 2.2 -0.01 0.012 0.0003 -1e-6 1e-7
TD 1e-6 1e-8 0 5e-7 0 0.2 25
LD 0.3 2.5
NM T-SELL1 2
CD 1.0 0.006 0.2 0.02 1.0 100
LD 0.3 2.5
NM T-HERZ 3
CD 1.5 0.005 1e-4 -0.002 1e-5 1e-7
LD 0.3 2.5
NM T-SELL2 4
CD 0.2 1.0 0.1 -0.01 9.0
LD 0.3 2.5
NM T-CONRADY 5
CD 1.5 0.005 0.0003
TD _ _ _ _ _ _ 20
LD 0.3 2.5
NM T-SELL3 6
CD 1.0 0.006 0.2 0.02 1.0 100 0.05 0.03
LD 0.3 2.5
NM T-SELL4 9
CD 1.2 1.0 0.006 0.9 100
LD 0.3 2.5
NM T-SELL5 11
CD 1.0 0.006 0.2 0.02 1.0 100 0.05 0.03 0.01 0.04
LD 0.3 2.5
"""


def test_formulas_of_catalogues(tmp_path: Path) -> None:
    (tmp_path / "own.agf").write_text(AGF, encoding="utf-16")
    load_glass_catalogue(tmp_path / "own.agf")
    um, s = 0.8, 0.64
    pole = 1.0 / (s - 0.028)
    sell1 = 1.0 + s / (s - 0.006) + 0.2 * s / (s - 0.02) + s / (s - 100.0)
    sell3 = sell1 + 0.05 * s / (s - 0.03)
    squares = {
        "T-SCHOTT": 2.2 - 0.01 * s + 0.012 / s + 3e-4 / s**2 - 1e-6 / s**3 + 1e-7 / s**4,
        "T-SELL1": sell1,
        "T-HERZ": (1.5 + 0.005 * pole + 1e-4 * pole**2 - 0.002 * s + 1e-5 * s**2 + 1e-7 * s**3)
        ** 2,
        "T-SELL2": 1.2 + s / (s - 0.01) - 0.01 / (s - 81.0),
        "T-CONRADY": (1.5 + 0.005 / um + 0.0003 / um**3.5) ** 2,
        "T-SELL3": sell3,
        "T-SELL4": 1.2 + s / (s - 0.006) + 0.9 * s / (s - 100.0),
        "T-SELL5": sell3 + 0.01 * s / (s - 0.04),
    }
    for name, square in squares.items():
        reference_c = 25.0 if name == "T-SCHOTT" else 20.0
        got = refractive_index(name, 800.0, reference_c)
        assert got == pytest.approx(math.sqrt(square), abs=1e-12), name
    assert refractive_index("T-CONRADY", 800.0, 60.0) == refractive_index("T-CONRADY", 800.0, 20.0)
    assert refractive_index("T-SCHOTT", 800.0, 60.0) != refractive_index("T-SCHOTT", 800.0, 25.0)
    front = FRONT.replace("N-BK7", "t-sell3")
    lens = parse_zmx(zmx(FAR, front, BACK, IMAGE))
    check_written_again(lens)
    assert 'name = "T-SELL3"' in format_lens(lens)  # the file brings its glass with it
    assert parse_agf(AGF.replace(" ", "\t")) == parse_agf(AGF)


def test_entries_of_catalogues_that_go_on_in_further_lines() -> None:
    wrapped = re.sub(r"^((?:CD|TD)(?: \S+){3}) ", r"\1 \n", AGF, flags=re.MULTILINE)
    assert wrapped.count("\n") > AGF.count("\n") + 8
    assert parse_agf(wrapped) == parse_agf(AGF)


@pytest.mark.parametrize("dash", ["-", "_"])
def test_thermal_constants_that_are_dashes_are_unknown(dash: str) -> None:
    left = re.sub(r"^TD .*$", " ".join(["TD", *[dash] * 7]), AGF, flags=re.MULTILINE)
    plain = re.sub(r"^TD .*\n", "", AGF, flags=re.MULTILINE)
    assert parse_agf(left) == parse_agf(plain)
    assert len(parse_agf(left)) == AGF.count("NM ")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("CD ", "CX ", "line 2: expected a glass"),
        ("NM ", "MN ", "expected glasses"),
        ("LD 0.3 2.5", "LD 2.5 0.3", "range of wavelengths"),
    ],
)
def test_bad_catalogues(tmp_path: Path, old: str, new: str, message: str) -> None:
    (tmp_path / "bad.agf").write_text(AGF.replace(old, new), encoding="utf-8")
    with pytest.raises(DataError, match=rf"bad\.agf.*{message}"):
        load_glass_catalogue(tmp_path / "bad.agf")


def test_what_is_shipped_agrees_with_the_index_that_its_makers_give() -> None:
    from importlib import resources

    text = (resources.files("lensshift.optics") / "glasses.agf").read_text(encoding="utf-8")
    assert len(parse_agf(text)) > 1500
    checked = 0
    for line in text.splitlines():
        if line.startswith("NM "):
            name, _, _, index_d, _ = line.split()[1:]
            if float(index_d) > 1.0:
                reference_c = parse_agf_reference(name)
                got = refractive_index(name, 587.5618, reference_c)
                assert got == pytest.approx(float(index_d), abs=2e-4), name
                checked += 1
    assert checked > 1000


def test_a_glass_that_cannot_be_read_does_not_cost_the_others(tmp_path: Path) -> None:
    """A vendor's file of hundreds has one with a formula of its own, or without a range."""
    odd = "NM ODD1 99 0 1.5 60\nCD 1 2 3\nLD 0.4 0.7\nNM ODD2 1 0 1.5 60\nCD 2.25\n"
    (tmp_path / "mixed.agf").write_text(AGF.rstrip("\n") + "\n" + odd)
    with pytest.warns(QualityWarning, match=r"mixed.agf: 2 of its glasses.*line .*ODD1"):
        found = load_glass_catalogue(tmp_path / "mixed.agf")
    assert found == parse_agf(AGF)


def parse_agf_reference(name: str) -> float:
    """Return the temperature at which a glass was measured."""
    from lensshift.optics.glass import glass_data

    return glass_data(name).reference_c


@pytest.mark.parametrize(
    ("before", "aperture"),
    [("OBSC 0 7.5 0", ""), ("", "CLAP 7.5 30 0"), ("OBSC 0 7.5 0", "CLAP 5 30 0")],
)
def test_the_obstruction_of_a_cassegrain_is_traced(before: str, aperture: str) -> None:
    """At the mirror, or on a plane in front of it: rays nearer to the axis than 7.5 mm are lost."""
    hidden = f"TYPE STANDARD; DISZ 50; DIAM 30; {before}" if before else "TYPE STANDARD; DISZ 50"
    text = zmx(
        FAR, hidden,
        f"STOP; TYPE STANDARD; CURV -0.005; CONI -1; DISZ -65; GLAS MIRROR; DIAM 30; {aperture}",
        "TYPE STANDARD; CURV -0.02; CONI -4; DISZ 80; GLAS MIRROR; DIAM 14", IMAGE,
        aperture="ENPD 50",
    )  # fmt: skip
    if before:
        with pytest.warns(QualityWarning, match="surface 1: its obstruction is taken at surface 2"):
            lens = parse_zmx(text)
    else:
        lens = parse_zmx(text)
    assert lens.elements[0].surfaces[0].inner_mm == pytest.approx(7.5)
    radius = np.array([0.29, 0.31, 0.99])  # of 25 mm
    passed = trace(lens, [0.0, 0.0], radius[:, None] * [0.6, 0.8]).passed
    assert passed.tolist() == [False, True, True]
    for again in (parse_lens(format_lens(lens)), parse_zmx(format_zmx(lens))):
        assert again.elements[0].surfaces[0].inner_mm == pytest.approx(7.5)
