"""Several modulation frequencies have one turn: against closed forms and a simulator."""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mosaic import mosaic_burst
from numpy.typing import NDArray

from lensshift import (
    Burst,
    Status,
    load_burst,
    load_reconstruction,
    reconstruct,
    save_burst,
    save_reconstruction,
)
from lensshift.camera import PlainOptics, TofTruth, camera_preset, simulate_tof_burst
from lensshift.core.errors import DataError, QualityWarning
from lensshift.core.grid import Grid
from lensshift.core.units import PhaseScale, distance_to_phase
from lensshift.evaluation import depth_error
from lensshift.forward.blur import GaussianBlur
from lensshift.forward.prediction import FramePredictor, phasor_predictors
from lensshift.io import export_burst, load_image_stack
from lensshift.reconstruction.phasor.frequencies import (
    Tones,
    common_distance,
    doubt_about_phases,
    repeats_m,
)
from lensshift.scene import Cuboid, Plane, Scene

OFFSETS = [(a, b) for a in (-0.25, 0.25) for b in (-0.25, 0.25)]
SHAPE = (9, 14)
PAIR_HZ = (100e6, 20e6)


def phasors_of(distance_m: NDArray[np.float64], hz: tuple[float, ...]) -> NDArray[np.complex128]:
    return np.stack([0.5 * np.exp(1j * distance_to_phase(distance_m, f)) for f in hz])


def wall(hz: tuple[float, ...] = PAIR_HZ, noise: float = 1e-4, **fields: Any) -> Burst:
    """Return frames of a wall 6.2 m away: four whole turns of 100 MHz."""
    z = phasors_of(np.full((4, *SHAPE), 6.2), hz)
    rng = np.random.default_rng(3)
    z = z + noise * (rng.standard_normal(z.shape) + 1j * rng.standard_normal(z.shape))
    return Burst.from_arrays(z, offset_px=OFFSETS, pitch_mm=0.1, modulation_hz=hz, **fields)


@given(
    st.floats(0.01, 7.3),
    st.sampled_from([(100e6, 20e6), (20e6, 100e6), (80e6, 60e6), (100e6, 80e6, 60e6)]),
    st.integers(0, 2**20),
)
def test_the_distance_of_exact_phases(distance_m: float, hz: tuple[float, ...], seed: int) -> None:
    rng = np.random.default_rng(seed)
    phase = distance_to_phase(np.full((3, 5), distance_m), 1.0) * np.array(hz)[:, None, None]
    turned = phase + 2 * np.pi * rng.integers(-3, 4, phase.shape)
    tones = Tones(hz, turned, np.full(phase.shape, 1e-3))
    found_m, _, sure = tones.alone()
    np.testing.assert_allclose(found_m, distance_m, atol=1e-9)
    per_m = distance_to_phase(1.0, 1.0) * np.array(hz)
    np.testing.assert_allclose(tones.sigma_m, 1e-3 / np.sqrt(np.sum(per_m**2)))
    assert np.all(sure)


@given(st.floats(0.0, 7.0), st.floats(0.01, 7.0))
def test_the_turns_asked_are_those_between_two_distances(low_m: float, more_m: float) -> None:
    tones, high_m = Tones(PAIR_HZ, *np.zeros((2, 2, 1))), min(low_m + more_m, 7.4)
    turns = tones.turns(low_m, high_m)
    for distance_m in np.linspace(low_m, high_m - 1e-4, 50):
        assert int(distance_m / tones.turn_m) in turns
    assert len(turns) <= (high_m - low_m) / tones.turn_m + 2
    assert Tones((200e6, 20e6), *np.zeros((2, 2, 1))).turns() == range(10)  # 20 MHz have one turn


@pytest.mark.parametrize("seed", range(3))
def test_dark_pixels_ask_their_neighbours_for_the_turn(seed: int) -> None:
    rng = np.random.default_rng(seed)
    truth_m = np.full((31, 46), 4.4)
    truth_m[8:21, 11:29] = 2.4  # no turn apart, and of the wall's phase in neither frequency
    std_rad = np.where(truth_m < 3, 0.4, 0.02) * np.ones((2, 1, 1))
    phase_rad = distance_to_phase(1.0, 1.0) * np.array(PAIR_HZ)[:, None, None] * truth_m
    noisy = Tones(PAIR_HZ, phase_rad + std_rad * rng.standard_normal(std_rad.shape), std_rad)
    alone_m, _, sure = noisy.alone()
    dark, slip_m = truth_m < 3, 0.5 * noisy.turn_m
    assert np.mean(np.abs(alone_m - truth_m)[dark] > slip_m) > 0.1
    assert np.mean(sure[dark]) < 0.5
    found_m, std_m = common_distance(noisy)
    off_m = np.abs(found_m - truth_m)
    assert np.mean(off_m[dark] > slip_m) < 0.02
    assert off_m[~dark].max() < slip_m
    assert np.mean(off_m[dark] < 2 * std_m[dark]) > 0.93


@pytest.mark.parametrize("share", [0.1, 0.3, 0.45])
def test_a_doubtful_turn_is_in_mean_and_std(share: float) -> None:
    """Between two surfaces a turn apart, with that share of the likelihood for the other."""
    turn_m, per_m = Tones(PAIR_HZ, *np.zeros((2, 2, 1))).turn_m, distance_to_phase(1.0, 1.0)
    distance_m = 0.3 + turn_m * (np.arange(49) > 24).reshape(7, 7)
    phase_rad = per_m * np.array(PAIR_HZ)[:, None, None] * distance_m
    std_rad = np.full(phase_rad.shape, 1e-3)
    # C of the far turn less that of the near one is 2 log((1 - share) / share)
    step_rad, std_rad[1, 3, 3] = 2 * np.pi / 5, 0.6
    phase_rad[1, 3, 3] += 0.5 * step_rad - np.log((1 - share) / share) * 0.6**2 / step_rad
    found_m, std_m = common_distance(Tones(PAIR_HZ, phase_rad, std_rad))
    distance_m[3, 3] += share * turn_m
    np.testing.assert_allclose(found_m, distance_m, atol=0.01 * share * turn_m)
    assert std_m[3, 3] == pytest.approx(turn_m * np.sqrt(share * (1 - share)), rel=0.01)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("hz", [(60.24e6, 50.12e6), (100e6, 19.98e6)])
def test_only_turns_that_surfaces_have_are_asked(hz: tuple[float, ...], seed: int) -> None:
    """All phases are nearly back after 14.9 m, and 7.5 m, and again up to 200 m."""
    rng = np.random.default_rng(seed)
    distance_m = 2.2 + 0.02 * np.arange(40) * np.ones((24, 1))  # from one turn into the next
    distance_m[6:18, 10:18] = rng.uniform(0.5, 1.5)
    distance_m[:, 28:32] = rng.uniform(0.5, 2.0)
    light = np.where(distance_m < 2.2, rng.uniform(0.3, 2.0), 1.0)
    z = phasors_of(distance_m, hz) * light
    mixed = np.zeros(distance_m.shape, np.bool_)
    for col in (9, 17, 27, 31):  # half of either side, each frequency by itself
        z[:, :, col] = (z[:, :, col - 1] + z[:, :, col + 1]) / 2
        mixed[:, col] = True
    sigma = 0.04
    z += sigma * (rng.standard_normal(z.shape) + 1j * rng.standard_normal(z.shape))
    tones = Tones(hz, np.angle(z), np.minimum(sigma / np.abs(z), 1.8), repeat_m=200.0)
    slipped = np.abs(tones.alone()[0] - distance_m) > 0.5 * tones.turn_m
    assert np.mean(slipped[~mixed]) > 0.1
    found_m, std_m = common_distance(tones)
    off_m = np.abs(found_m - distance_m)[~mixed]
    assert off_m.max() < 0.5 * tones.turn_m
    assert np.mean(off_m < 2 * std_m[~mixed]) > 0.93
    assert found_m.max() < 5.0


TRIPLE_HZ = (100e6, 80e6, 60e6)


@pytest.mark.parametrize("hz", [(100e6,), PAIR_HZ, TRIPLE_HZ])
def test_phases_that_contradict_each_other_widen_the_std(hz: tuple[float, ...]) -> None:
    per_m = distance_to_phase(1.0, 1.0) * np.array(hz)
    no_shift = np.linalg.svd(per_m[None])[2][1:].sum(axis=0)  # errors that no distance explains
    for chi_square in (0.5, 20.0) if len(hz) > 1 else (0.0,):
        error_rad = 1e-3 * np.sqrt(chi_square) * no_shift / max(np.linalg.norm(no_shift), 1e-12)
        phase_rad = np.tile((per_m * 1.3 + error_rad)[:, None, None], (1, 5, 7))
        found_m, std_m = common_distance(Tones(hz, phase_rad, np.full(phase_rad.shape, 1e-3)))
        np.testing.assert_allclose(found_m, 1.3, rtol=1e-9)
        times = np.sqrt(max(chi_square / max(len(hz) - 1, 1), 1.0))
        np.testing.assert_allclose(std_m, times * 1e-3 / np.linalg.norm(per_m), rtol=1e-6)


@pytest.mark.parametrize("distance_m", [3.1, 4.3])  # early and late in a turn
@pytest.mark.parametrize(("towards", "apart"), [(0.0, 2.0), (0.7, 6.0)])
def test_a_pixel_that_takes_the_turn_of_its_neighbours_may_contradict_itself(
    distance_m: float, towards: float, apart: float
) -> None:
    """Of a wall, with phases on the way to a turn, so many sigma away, of no surface around."""
    per_m = distance_to_phase(1.0, 1.0) * np.array(TRIPLE_HZ)
    turn_m = 2 * np.pi / per_m[0]
    nearer_rad = per_m * turn_m - 2 * np.pi * np.rint(per_m * turn_m / (2 * np.pi))
    nearer_rad = nearer_rad - per_m * (nearer_rad @ per_m) / (per_m @ per_m)  # no distance explains
    phase_rad = np.tile((per_m * distance_m)[:, None, None], (1, 7, 8))
    std_rad = np.full(phase_rad.shape, 1e-3)
    phase_rad[:, 3, 4] += towards * nearer_rad
    std_rad[:, 3, 4] = np.linalg.norm(nearer_rad) / apart
    tones = Tones(TRIPLE_HZ, phase_rad, std_rad)
    alone_m, _, sure = tones.alone()
    assert (abs(alone_m[3, 4] - distance_m) > 0.5 * turn_m) == (towards > 0.5)
    assert sure.sum() == sure.size - (not towards)
    found_m, std_m = common_distance(tones)
    np.testing.assert_allclose(found_m, distance_m, rtol=1e-9)
    times = max(towards * apart / np.sqrt(2), 1.0)
    # A pixel like none around is beside an edge, where all phases share their error.
    independent, shared = 1 / np.linalg.norm(per_m), per_m.sum() / (per_m @ per_m)
    per_rad = shared if towards > 0.5 else independent
    assert std_m[3, 4] == pytest.approx(times * std_rad[0, 3, 4] * per_rad)


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("turns", [-1, 1, 3])
def test_a_lone_pixel_is_never_beyond_the_surfaces_around_it(turns: int, seed: int) -> None:
    """However sure it is of its turn, where no frequency tells so far by itself."""
    hz, rng = (300e6, 36e6), np.random.default_rng(seed)
    tones = Tones(hz, *np.zeros((2, 2, 1)))
    distance_m = np.where(np.arange(14) < 6, 4.5, 4.6) * np.ones((9, 1))
    at = (int(rng.integers(2, 7)), int(rng.integers(3, 11)))
    distance_m[at] += turns * tones.turn_m
    phase_rad = distance_to_phase(1.0, 1.0) * np.array(hz)[:, None, None] * distance_m
    lone = Tones(hz, phase_rad, np.full(phase_rad.shape, 1e-3))
    assert lone.alone()[2].all()
    np.testing.assert_allclose(lone.alone()[0], distance_m, atol=1e-9)
    found_m, std_m = common_distance(lone)
    distance_m[at] -= turns * tones.turn_m
    np.testing.assert_allclose(found_m, distance_m, atol=0.05 * tones.turn_m)
    assert std_m[at] == std_m.max() > abs(found_m[at] - distance_m[at])


@pytest.mark.parametrize("seed", range(3))
def test_a_thin_thing_that_the_lowest_frequency_sees_stays_where_it_is(seed: int) -> None:
    """A strip of one pixel along the border, a turn of 80 MHz nearer than the wall."""
    hz, rng = (80e6, 20e6), np.random.default_rng(seed)
    truth_m = np.where(np.arange(15) == 14, 2.4, 4.4) * np.ones((9, 1))
    std = np.array([0.03, 0.1])[:, None, None] * np.ones(truth_m.shape)
    phase_rad = distance_to_phase(1.0, 1.0) * np.array(hz)[:, None, None] * truth_m
    phase_rad += std * rng.standard_normal(std.shape)
    np.testing.assert_allclose(common_distance(Tones(hz, phase_rad, std))[0], truth_m, atol=0.1)


def test_beside_an_edge_all_frequencies_have_the_same_error() -> None:
    """Of three that know as much: noise falls with the root of their number, what is hidden not."""
    hz, truth_m = (30e6, 29e6, 28e6), np.where(np.arange(12) < 5, 1.0, 2.0) * np.ones((7, 1))
    per_m = distance_to_phase(1.0, 1.0) * np.array(hz)[:, None, None]
    std_rad = 0.02 * per_m / per_m.max() * np.ones(truth_m.shape)
    std_m = common_distance(Tones(hz, per_m * truth_m, std_rad))[1]
    alone_m = 0.02 / per_m.max()
    np.testing.assert_allclose(std_m[:, [4, 5]], alone_m)
    np.testing.assert_allclose(std_m[:, [0, 1, 2, 3, 6, 7, 8, 9, 10, 11]], alone_m / 3**0.5)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("share", [0.3, 0.6])
def test_a_pole_that_no_mixture_of_the_wall_explains_stays_where_it_is(
    share: float, seed: int
) -> None:
    """One pixel wide between pixels that mix it with the wall; no frequency tells so far alone."""
    hz, rng = (80e6, 60e6), np.random.default_rng(seed)
    per_m = distance_to_phase(1.0, 1.0) * np.array(hz)[:, None, None]
    of_pole = np.select([np.arange(15) == 7, abs(np.arange(15) - 7) == 1], [1.0, share], 0.0)
    of_pole = of_pole * np.ones((9, 1))
    both = of_pole * np.exp(1j * per_m * 2.12) + (1 - of_pole) * np.exp(1j * per_m * 5.0)
    std = np.array([0.05, 0.15])[:, None, None] * np.ones(both.shape)
    phase_rad = np.angle(both) + std * rng.standard_normal(std.shape)
    found_m, _ = common_distance(Tones(hz, phase_rad, std))
    np.testing.assert_allclose(found_m[:, 7], 2.12, atol=0.2)
    np.testing.assert_allclose(found_m[of_pole == 0], 5.0, atol=0.2)


@pytest.mark.parametrize("seed", range(8))
def test_all_phases_are_back_where_the_likeliest_distance_fits_them(seed: int) -> None:
    """Turn by turn, with the distance by least squares, for frequencies of unequal noise."""
    rng, found, expected = np.random.default_rng(seed), [], []
    for _ in range(40):
        hz = np.sort(rng.choice([3, 4, 5, 6, 8, 9], 2, replace=False))[::-1] * 9e6
        hz = hz + np.array([0.0, rng.choice([-1, 1]) * 10 ** rng.uniform(4.0, 5.6)])
        std_rad, turn_m = (
            10 ** rng.uniform(-3.0, -0.3, 2),
            2 * np.pi / distance_to_phase(1.0, hz[0]),
        )
        nearest, repeat_m = np.inf, 200.0
        for n in range(1, int(200.0 / turn_m) + 1):
            left = n * hz / hz[0] - np.rint(n * hz / hz[0])
            A, b = (2 * np.pi * hz / hz[0] / std_rad)[:, None], 2 * np.pi * left / std_rad
            rest = b - A[:, 0] * np.linalg.lstsq(A, b, rcond=None)[0]
            if (
                n > 1
                and abs(left).max() < nearest
                and n * abs(left).max() < 1 / 20
                and rest @ rest < 9
            ):
                repeat_m = min(n * turn_m, 200.0)
                break
            nearest = min(nearest, abs(left).max())
        found.append(repeats_m(tuple(hz), std_rad))
        expected.append(repeat_m)
    np.testing.assert_allclose(found, expected)
    assert len(set(expected)) > 5


@pytest.mark.parametrize(
    ("told_mhz", "repeat_m"),
    [
        ((100, 20), 7.4948), ((20, 100), 7.4948), ((80, 60), 7.4948), ((120, 80, 16), 18.737),
        ((80.3, 60.2), 7.4669), ((80.32, 60.24), 7.4649), ((60.24, 50.12), 14.930),
        ((30.1, 29.3), 200.0), ((100, 99), 149.9), ((15,), 9.9931), ((100, 61.8), 200.0),
    ],
)  # fmt: skip
def test_all_phases_are_back_where_no_phase_can_tell(
    told_mhz: tuple[float, ...], repeat_m: float
) -> None:
    """c / (2 gcd f), though frequencies are told rounded; none is for unrelated ones."""
    hz = tuple(1e6 * mhz for mhz in told_mhz)
    found_m = repeats_m(hz, np.full(len(hz), 0.05))
    assert found_m == pytest.approx(repeat_m, rel=1e-4)


@pytest.mark.parametrize("seed", range(3))
def test_rounded_frequencies_put_nothing_many_turns_away(seed: int) -> None:
    rng, true_hz = np.random.default_rng(seed), np.array([80.32e6, 60.24e6])
    truth_m = np.where(np.arange(21) < 9, 2.0, 3.1) * np.ones((11, 1))
    std_rad = np.full((2, *truth_m.shape), 0.05)
    phase_rad = distance_to_phase(1.0, 1.0) * true_hz[:, None, None] * truth_m
    phase_rad = np.mod(phase_rad + std_rad * rng.standard_normal(std_rad.shape), 2 * np.pi)
    found_m, std_m = common_distance(Tones((80.3e6, 60.2e6), phase_rad, std_rad))
    assert np.abs(found_m - truth_m).max() < 0.15
    assert np.mean(np.abs(found_m - truth_m) < 2 * std_m) > 0.9


@pytest.mark.parametrize("hz", [PAIR_HZ, (20e6, 100e6), (80e6, 60e6), (15e6,)])
def test_a_wall_is_where_it_is(hz: tuple[float, ...]) -> None:
    result = reconstruct(wall(hz))
    assert result.distance_m is not None
    assert result.settings["channel"] == "phasor"
    np.testing.assert_allclose(result.distance_m.image, 6.2, atol=2e-3)
    assert np.median(result.distance_m.std) < 2e-3
    assert reconstruct(wall(hz), std=False).distance_m.std is None


def test_frames_are_predicted_in_the_turn_where_the_wall_is(tmp_path: Path) -> None:
    """6.2 m are four turns of 100 MHz and 0.204 m."""
    result = reconstruct(wall())
    save_reconstruction(result, tmp_path / "wall.nc")
    again = load_reconstruction(tmp_path / "wall.nc")
    for where in (1, (0.1, -0.2)):
        seen_m = result["distance"].predict(where)
        np.testing.assert_allclose(seen_m[1:-1, 1:-1], 6.2, atol=1e-3)
        for key in ("amplitude", "distance"):
            np.testing.assert_allclose(again[key].predict(where), result[key].predict(where))


def test_smaller_pixels_lie_in_the_same_turn() -> None:
    seen = mosaic_burst(81, (20, 24))
    z = np.stack([seen.y * np.exp(1j * distance_to_phase(6.2, f)) for f in PAIR_HZ])
    burst = Burst.from_arrays(z, offset_px=seen.offset_px, modulation_hz=PAIR_HZ)
    found = reconstruct(burst, 1, channel="phasor")["distance"]
    assert found.fine is not None
    np.testing.assert_allclose(found.fine, 6.2, atol=0.05)


def test_distances_of_several_frequencies_are_left_to_the_distance_channel() -> None:
    rng = np.random.default_rng(1)
    d = 3.0 + rng.random((4, *SHAPE))
    burst = Burst.from_arrays(
        0.5 + 0.1 * rng.random(d.shape), d, offset_px=OFFSETS, pitch_mm=0.1, modulation_hz=PAIR_HZ
    )
    result = reconstruct(burst)
    assert "several frequencies" in result.settings["channel_reason"]
    alone = reconstruct(burst, channel="distance")
    np.testing.assert_array_equal(result.distance_m.image, alone.distance_m.image)
    with pytest.raises(ValueError, match=r"several modulation frequencies.*channel distance"):
        reconstruct(burst, channel="phasor")


SCENE = Scene(
    (
        Cuboid(centre_m=(-0.12, 0.02, 1.6), size_m=(0.16, 0.12, 0.1), reflectance=0.6),
        Cuboid(centre_m=(0.14, -0.03, 2.2), size_m=(0.18, 0.16, 0.1), reflectance=0.3),
    ),
    Plane(centre_m=(0, 0, 3.6), turn_rad=(0.1, 0.3, 0), reflectance=0.6),
)


def seen_by_a_camera(hz: tuple[float, ...], seed: int) -> tuple[Burst, TofTruth]:
    vga = camera_preset("vga")
    camera = replace(
        vga, grid=Grid((24, 33), (0.031, 0.031)), optics=PlainOptics(3.2, 1.2, blur_sigma_px=0.1),
        illumination=replace(vga.illumination, modulation_hz=hz, intensity_w_per_sr=0.3),
        scatter=None,
    )  # fmt: skip
    return simulate_tof_burst(SCENE, camera, seed=seed)


@pytest.mark.parametrize("without_phasors", [False, True])
@pytest.mark.parametrize("seed", [5, 6])
def test_shifts_of_the_wrong_sign_are_told(seed: int, without_phasors: bool) -> None:
    burst = seen_by_a_camera(PAIR_HZ, seed)[0]
    burst = replace(burst, phasors=None) if without_phasors else burst
    with pytest.warns(QualityWarning, match="likely their sign"):
        reconstruct(replace(burst, offset_px=-burst.offset_px))


@pytest.mark.parametrize("hz", [PAIR_HZ, (30e6, 29e6, 28e6)])
def test_edges_are_better_and_no_surface_is_a_turn_off(hz: tuple[float, ...]) -> None:
    burst, truth = seen_by_a_camera(hz, 5)
    result = reconstruct(burst)
    alone = reconstruct(burst, channel="distance").distance_m.image
    errors = [depth_error(d, truth.distance_m, scale=2) for d in (result.distance_m.image, alone)]
    assert errors[0].edge_rmse_m < 0.9 * errors[1].edge_rmse_m
    off_m = np.abs(result.distance_m.image - truth.distance_m)
    assert off_m[~truth.flying].max() < 0.5


def test_phasors_travel(tmp_path: Path) -> None:
    burst = wall((20e6, 100e6))
    np.testing.assert_array_equal(burst.amplitude, np.abs(burst.phasors[1]))
    save_burst(burst, tmp_path / "b.nc")
    again = load_burst(tmp_path / "b.nc")
    np.testing.assert_array_equal(again.phasors, burst.phasors)
    assert again.modulation_hz == burst.modulation_hz == (20e6, 100e6)
    np.testing.assert_array_equal(burst.select([2, 0]).phasors, burst.phasors[:, [2, 0]])
    np.savez(
        tmp_path / "b.npz", amplitude=burst.phasors, offset_px=OFFSETS, pitch_mm=0.1,
        modulation_hz=[20e6, 100e6],
    )  # fmt: skip
    np.testing.assert_array_equal(load_image_stack(tmp_path / "b.npz").phasors, burst.phasors)
    export_burst(burst, tmp_path / "own.npz")
    np.testing.assert_array_equal(load_image_stack(tmp_path / "own.npz").phasors, burst.phasors)


@pytest.mark.parametrize(
    ("fields", "field"),
    [
        ({"modulation_hz": (1e8, 1e8)}, "modulation_hz"),
        ({"modulation_hz": (1e8, np.nan)}, "modulation_hz"),
        ({"modulation_hz": "fast"}, "modulation_hz"),
        ({"modulation_hz": 1e8}, "phasors"),
        ({"modulation_hz": None}, "phasors"),
        ({"modulation_hz": (1e8, 8e7, 6e7)}, "phasors"),
        ({"amplitude": np.full((2, 4, *SHAPE), np.nan + 0j)}, "amplitude"),
    ],
)
def test_phasors_that_do_not_fit(fields: dict[str, Any], field: str) -> None:
    given = {"amplitude": np.ones((2, 4, *SHAPE), complex), "modulation_hz": PAIR_HZ} | fields
    with pytest.raises(DataError, match=field):
        Burst.from_arrays(given.pop("amplitude"), offset_px=OFFSETS, pitch_mm=0.1, **given)


@pytest.mark.parametrize("hz", [(20e6, 80e6), (100e6, 80e6, 60e6), (80e6, 60e6)])
def test_frequencies_in_the_wrong_order_are_told(hz: tuple[float, ...]) -> None:
    burst = wall(hz)
    reconstruct(burst)  # and no warning
    wrong = (*hz[1:], hz[0])
    right = ", ".join(f"{one:g}" for one in hz)
    with pytest.warns(QualityWarning, match="fit no distance") as said:
        reconstruct(replace(burst, modulation_hz=wrong))
    assert any(f"in that of {right} Hz" in str(one.message) for one in said)
    assert said[0].filename == __file__


@pytest.mark.parametrize("hz", [PAIR_HZ, (60e6, 80e6)])
@pytest.mark.parametrize("number", [0, 1])
@pytest.mark.parametrize("light", [0.0, 4.0])
def test_pixels_that_one_frequency_misses_take_no_turn(
    hz: tuple[float, ...], number: int, light: float
) -> None:
    """Whichever frequency it is, and whether it says nothing there or always the same."""
    burst = wall(hz, noise=2e-3)
    z = np.array(burst.phasors)
    for at in ((2, 3), (4, 9), (6, 5)):
        z[number, :, *at] = light * np.exp(2.0j * (at[0] + 1))
    spoiled = Burst.from_arrays(z, offset_px=OFFSETS, pitch_mm=0.1, modulation_hz=hz)
    with pytest.warns(QualityWarning, match="left out as") as said:
        found = reconstruct(spoiled)["distance"].image
    assert "(2, 3), (4, 9), (6, 5)" in str(said[0].message)
    np.testing.assert_allclose(found, 6.2, atol=0.05)


def test_light_that_changes_between_frames_changes_no_turn() -> None:
    """Gain and bias of the phasors say nothing of the distances that tell the turn."""
    scale, far_m = PhaseScale(20e6, 9.0, True, "frames"), np.full((6, 8), 9.1)
    gain, bias = np.array([1.0, 0.4]), np.array([0.0, 0.02])
    light = FramePredictor(np.full((6, 8), 0.5), 2, GaussianBlur(0.3), np.zeros((2, 2)), gain, bias)
    _, distance = phasor_predictors(light, far_m, scale)
    for k in range(2):
        np.testing.assert_allclose(distance(k), 9.1, atol=0.1)


@pytest.mark.parametrize("seed", range(6))
def test_phases_that_fit_in_no_order_name_none(seed: int) -> None:
    rng = np.random.default_rng(seed)
    hz = (100e6, 80e6, 60e6)
    phase = rng.uniform(-np.pi, np.pi, (3, 20, 30))
    said = doubt_about_phases(Tones(hz, phase, np.full(phase.shape, 0.02)))
    assert "no distance (chi-square" in said
    assert "order" not in said


@pytest.mark.parametrize("hz", [PAIR_HZ, (80e6, 60e6), (60e6, 80e6, 100e6)])
@pytest.mark.parametrize("seed", range(3))
def test_phases_that_contradict_each_other_are_told(hz: tuple[float, ...], seed: int) -> None:
    rng = np.random.default_rng(seed)
    distance_m = 3.0 + 0.05 * np.arange(30) + 0.02 * rng.standard_normal((20, 30))
    distance_m[5:12, 8:17] = rng.uniform(1.0, 2.5)
    phase = distance_to_phase(1.0, 1.0) * np.array(hz)[:, None, None] * distance_m
    phase += 0.02 * rng.standard_normal(phase.shape)
    std_rad = np.full(phase.shape, 0.02)
    assert doubt_about_phases(Tones(hz, phase, std_rad)) == ""
    sign = np.where(np.arange(len(hz)) == seed % len(hz), -1.0, 1.0)[:, None, None]
    said = doubt_about_phases(Tones(hz, sign * phase, std_rad))
    name = f"{hz[seed % 3]:g}" if len(hz) > 2 else "one of"
    assert f"those of {name}" in said
    assert "run backwards: give the conjugate" in said
    off = doubt_about_phases(Tones(hz, phase + 0.6 * (sign < 0), std_rad))
    assert "are its phases not calibrated" in off
    harmonic = phase + 0.03 * np.sin(3 * phase)  # beyond the noise, but no mistake
    assert doubt_about_phases(Tones(hz, harmonic, np.full(phase.shape, 0.003))) == ""
    told = (hz[0] * 1.1, *hz[1:])
    assert "is a frequency another one" in doubt_about_phases(Tones(told, phase, std_rad))


@pytest.mark.parametrize("moved", [0, 1])
def test_what_one_frequency_contradicts_is_told(moved: int) -> None:
    """Frequencies are taken one after another: something is there in two frames of one alone."""
    rng, hz = np.random.default_rng(moved), PAIR_HZ
    row, col = np.mgrid[:24, :36]
    z = phasors_of(np.full((4, 24, 36), 4.5), hz) * (1 + 0.2 * np.sin(0.9 * row + 0.6 * col))
    z[moved, 2:, 8:15, 12:20] = phasors_of(np.array(2.6), hz)[moved]
    z += 2e-3 * (rng.standard_normal(z.shape) + 1j * rng.standard_normal(z.shape))
    burst = Burst.from_arrays(z, offset_px=np.zeros((4, 2)), pitch_mm=0.1, modulation_hz=hz)
    with pytest.warns(QualityWarning, match="moved"):
        result = reconstruct(burst)
    distance = result["distance"]
    assert distance.status is Status.CONTRADICTED
    assert "contradiction" in distance.notes
    assert distance.misfit is not None
    assert np.median(distance.misfit[18:28, 26:38]) > 10


@pytest.mark.parametrize("several", [False, True])
@pytest.mark.parametrize("gain", [1.2, 2.0])
def test_exposures_of_phasors_are_allowed_for(gain: float, several: bool) -> None:
    """Photometric estimation is of real frames: it was the advice, and an error."""
    rng, (row, col) = np.random.default_rng(0), np.mgrid[:16, :24]
    distance_m = np.where(abs(col - 12) < 5, 2.0, 4.0) * np.ones((4, 1, 1))
    z = phasors_of(distance_m, PAIR_HZ) * (1 + 0.2 * np.sin(0.9 * row + 0.6 * col))
    z += 1e-3 * (rng.standard_normal(z.shape) + 1j * rng.standard_normal(z.shape))
    exposure = np.array([1.0, gain, 1.0, 1.0])[:, None, None]

    def said(phasors: NDArray[np.complex128]) -> str:
        frames, hz = (phasors, PAIR_HZ) if several else (phasors[1], PAIR_HZ[1])
        burst = Burst.from_arrays(frames, offset_px=np.zeros((4, 2)), modulation_hz=hz)
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            reconstruct(burst)
        return "; ".join(str(one.message) for one in caught)

    assert said(z) == ""
    told = said(z * exposure)
    assert "allows for it" in told
    assert "; " not in told
