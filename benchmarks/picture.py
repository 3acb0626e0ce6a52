"""Whether the closed form of `lens optimise --goal picture` says what a solver leaves.

    python benchmarks/picture.py --scenes 6
    python benchmarks/picture.py --scores       # the closed form alone: the table of docs/lens.md
    python benchmarks/picture.py --targets      # PSNR of drawn targets, method auto

Random scenes with the power of natural ones, periodic, with detail up to two cycles per pixel, seen
by 32 x 32 pixels through the traced spots of a lens at the centre, the end of the rows and a corner
of the sensor, at the traced shifts of each frame and with normal errors of every position of the
element. The frames go to `reconstruct` with method tikhonov, which knows neither the scene's power
nor the lens, at four times the pixels; squares of four of them are the pixels of the picture. RMSE
against the scene in pixels half the size, 4 pixels from the border left out, beside the closed form
of the same fields, and how well one ranks as the other does. Takes about two minutes.
"""

import argparse
from collections.abc import Callable

import numpy as np

from lensshift import Burst, fidelity, reconstruct
from lensshift.camera import Sensor, simulate_burst
from lensshift.core.grid import Grid
from lensshift.core.pattern import named_pattern_px
from lensshift.optics.lens_file import load_lens
from lensshift.optics.picture import PICTURES, linear_picture, picture_score, traced_frames
from lensshift.scene import demo_target, siemens_star

SIDE, FINE = 32, 4  # pixels of a frame, and points of the scene for each
NOISE = 0.005
PATTERNS = (*PICTURES, ("4x4", 0.25))
ACTUATOR_UM = (0.0, 2.0, 4.0)
FIELDS = (0, 1, 4)  # of `edge_fields`: centre, end of the rows, corner
Otf = Callable[[np.ndarray], np.ndarray]


def random_scene(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return the transform [row col] of a scene of standard deviation 0.2, and its frequencies."""
    along = np.fft.fftfreq(SIDE * FINE) * FINE
    frequency = np.stack(np.meshgrid(along, along, indexing="ij"), axis=-1)
    power = 1.0 / (64.0**-2 + np.sum(frequency**2, axis=-1))
    power[0, 0] = 0.0
    scene = np.fft.fft2(rng.standard_normal(power.shape)) * np.sqrt(power)
    return 0.2 * scene / np.fft.ifft2(scene).real.std(), frequency


def sampled(
    scene: np.ndarray, frequency: np.ndarray, place_px: np.ndarray, step: int
) -> np.ndarray:
    """Return every step-th value of a picture that lies at `place_px` of the first pixel."""
    moved = scene * np.exp(2j * np.pi * (frequency @ place_px))
    return np.fft.ifft2(moved).real[::step, ::step]


def left(offset_px: np.ndarray, otf: Otf, error_px: float, place_px: float, seed: int) -> float:
    """Return the mean square that the solver leaves of one scene."""
    rng = np.random.default_rng(seed)
    scene, frequency = random_scene(rng)
    aperture = np.prod(np.sinc(frequency), axis=-1)
    noise = NOISE * np.sqrt(len(offset_px) / 4.0)
    true_px = offset_px + error_px * rng.standard_normal(offset_px.shape)
    frames = [
        sampled(scene * aperture * part, frequency, -shift_px, FINE)
        for shift_px, part in zip(true_px, otf(frequency), strict=True)
    ]
    noisy = 0.5 + np.array(frames) + noise * rng.standard_normal((len(frames), SIDE, SIDE))
    # The picture lies a quarter of a pixel aside if all offsets say so.
    told_px = offset_px + 0.25 - place_px
    burst = Burst.from_arrays(noisy, offset_px=told_px, pitch_mm=0.155)
    fine = reconstruct(
        burst, FINE, "tikhonov", fill_factor=1.0, psf_sigma_px=0.0, noise_sigma=noise, std=False
    ).amplitude.image
    picture = fine.reshape(2 * SIDE, FINE // 2, 2 * SIDE, FINE // 2).mean(axis=(1, 3))
    wanted = scene * np.prod(np.sinc(0.5 * frequency), axis=-1)
    truth = 0.5 + sampled(wanted, frequency, np.full(2, -place_px), FINE // 2)
    return float(np.mean((picture - truth)[8:-8, 8:-8] ** 2))


def print_scores() -> None:
    """Print what the closed form says of all movers, patterns and places."""
    grid = Grid((16, 64), (0.155, 0.155))
    print("RMSE in % of full scale for 0 / 2 / 4 um, SR MTF for 0 / 4 um")
    for name in ("petzval_a", "petzval_b", "petzval_search"):
        lens = load_lens(name)
        for element in range(3):
            for pattern, place_px in PICTURES:
                scores = [
                    picture_score(
                        lens, element, grid, pattern=pattern, place_px=place_px, actuator_um=um
                    )
                    for um in ACTUATOR_UM
                ]
                rmse = " / ".join(f"{100.0 * one.rmse:.2f}" for one in scores)
                mtf = f"{scores[0].mtf:.3f} / {scores[-1].mtf:.3f}"
                print(f"{name:<15} {element + 1} {scores[0].label:<14} {rmse}   {mtf}", flush=True)


def print_targets(seeds: int = 4) -> None:
    """Print the PSNR of targets whose pixels of the picture lie on and between those of frames.

    Four frames; 3x3 with the same light in all. The scene is moved instead of the picture.
    """
    wide, square = (Grid(shape, (0.155, 0.155)) for shape in ((16, 64), (40, 40)))
    targets = {
        "boxes and bars": (demo_target((16 * 0.155, 64 * 0.155)), wide),
        "Siemens star": (siemens_star(18 * 0.155, 12), square),
    }
    for name, (target, grid) in targets.items():
        for pattern, place_px in PICTURES:
            planned_px = named_pattern_px(pattern) + 0.25 - place_px
            sensor = Sensor(grid, 20_000.0 * 4 / len(planned_px), 20.0)
            for words, options in (("", {}), (", fill_factor=1", {"fill_factor": 1.0})):
                found = []
                for seed in range(seeds):
                    burst, truth = simulate_burst(
                        target, sensor, [tuple(one) for one in planned_px], seed=seed
                    )
                    image = reconstruct(burst, 2, std=False, **options).amplitude.image
                    found.append(fidelity(image, truth.image).psnr_db)
                where = pattern if place_px == 0.25 else f"{pattern}, aside"
                print(f"{name:<16}{where:<15} auto{words:<16} {np.mean(found):6.2f} dB", flush=True)


def main() -> None:
    """Print what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenes", type=int, default=6)
    parser.add_argument("--scores", action="store_true", help="the closed form alone")
    parser.add_argument("--targets", action="store_true", help="drawn targets, method auto")
    options = parser.parse_args()
    if options.scores:
        return print_scores()
    if options.targets:
        return print_targets()
    return compare(options.scenes)


def compare(scenes: int) -> None:
    """Print closed form and solver, side by side."""
    grid = Grid((16, 64), (0.155, 0.155))
    told, got = [], []
    print(
        "lens       element pattern      actuator   closed form   tikhonov, RMSE in % of full scale"
    )
    for name in ("petzval_a", "petzval_b"):
        lens = load_lens(name)
        for element in range(3):
            for pattern, place_px in PATTERNS:
                frames = traced_frames(lens, element, grid, named_pattern_px(pattern))
                noise = NOISE * np.sqrt(len(frames.offset_px) / 4.0)
                fields = [(frames.offset_px[:, n], frames.otf(n), frames.otf(n)) for n in FIELDS]
                for actuator_um in ACTUATOR_UM:
                    error_px = frames.px_per_um * actuator_um
                    squares = [
                        (
                            linear_picture(
                                here_px, ours, noise, error_px, place_px=place_px
                            ).rmse ** 2,
                            np.mean([
                                left(here_px, drawn, error_px, place_px, seed)
                                for seed in range(scenes)
                            ]),
                        )
                        for here_px, ours, drawn in fields
                    ]  # fmt: skip
                    pair = 100.0 * np.sqrt(np.mean(squares, axis=0))
                    told.append(pair[0])
                    got.append(pair[1])
                    where = pattern if place_px == 0.25 else f"{pattern}, aside"
                    print(
                        f"{name:<10} {element + 1:>7} {where:<14} {actuator_um:4g} um "
                        f"{pair[0]:12.2f} {pair[1]:10.2f}",
                        flush=True,
                    )
    ratio = np.array(got) / told
    ranks = np.corrcoef(np.argsort(np.argsort(told)), np.argsort(np.argsort(got)))[0, 1]
    print(
        f"tikhonov over closed form: {ratio.min():.2f} to {ratio.max():.2f}, median "
        f"{np.median(ratio):.2f}; rank correlation {ranks:.3f}"
    )


if __name__ == "__main__":
    main()
