"""Errors of distances from the phasor channel against those from the distance channel.

python benchmarks/phasor.py ../shared/reference --seeds 2

Five groups, none made by the forward model of the solver: four boxes taken by the simulated O3M
(with its own noise, and with SNR = median amplitude / noise added), four boxes on the simulated
bench of the paper through the moving lens (SNR of the cloth behind them), real O3D frames as fine
scenes whose phasors are averaged over 4 x 4 pixels, real distances of an ESPROS camera with light
and dark patches painted on, likewise, and the phasor case of the reference data.
"""

import argparse
import time
import warnings
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import h5py
import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy.ndimage import gaussian_filter

from lensshift import Burst, reconstruct
from lensshift.camera import camera_preset, simulate_tof_burst
from lensshift.core.units import SPEED_OF_LIGHT_MPS, distance_to_phase, phase_to_distance
from lensshift.evaluation import depth_error
from lensshift.pipeline.paper.bench import PUBLISHED, WALL_LIGHT, paper_camera
from lensshift.pipeline.paper.box_claims import BRIGHTEST_LIGHT
from lensshift.scene import four_boxes

MODULATION_HZ = 15e6
OFFSETS_PX = np.array([(-0.25, -0.25), (-0.25, 0.25), (0.25, -0.25), (0.25, 0.25)])
LIKE = (("distance", "auto"), ("distance", "tv"), ("phasor", "auto"))
BLUR_PX, SHIFT_ERROR_PX, FINE = 0.25, 0.05, 4
ASSUMED_O3M = {"psf_sigma_px": 0.23}  # as `calibrate` finds it: half of its pixel sees light
LEAST_SNR = 3.0  # of a pixel that counts as valid
NEAREST_M = 0.05  # less is no distance
UNAMBIGUOUS_M = 1.25  # of the reference case


@dataclass(frozen=True)
class Case:
    name: str
    burst: Burst
    truth_m: NDArray[np.float64]
    valid: NDArray[np.bool_]
    assumed: dict[str, float] = field(default_factory=dict)  # of the pixel response


def noisy(phasor: NDArray[np.complex128], snr: float, seed: int) -> NDArray[np.complex128]:
    rng = np.random.default_rng(seed)
    noise = rng.standard_normal(phasor.shape) + 1j * rng.standard_normal(phasor.shape)
    return phasor + np.median(np.abs(phasor)) / snr * noise


def boxes(seed: int) -> Iterator[Case]:
    camera = replace(camera_preset("o3m151"), output="float")
    burst, truth = simulate_tof_burst(four_boxes(), camera, OFFSETS_PX, seed=seed)
    yield Case(f"boxes, camera noise, {seed}", burst, truth.distance_m, truth.valid, ASSUMED_O3M)
    phasor = burst.amplitude * np.exp(1j * distance_to_phase(burst.distance_m, MODULATION_HZ))
    for snr in (50, 15):
        y = noisy(phasor, snr, seed)
        distance_m = phase_to_distance(np.angle(y), MODULATION_HZ)
        noisier = replace(burst, amplitude=np.abs(y), distance_m=distance_m)
        name = f"boxes, SNR {snr}, {seed}"
        yield Case(name, noisier, truth.distance_m, truth.valid, ASSUMED_O3M)


def bench(seed: int) -> Iterator[Case]:
    for snr in (50, 15):
        camera = paper_camera(snr, WALL_LIGHT, BRIGHTEST_LIGHT, optics="petzval_a")
        burst, truth = simulate_tof_burst(four_boxes(), camera, OFFSETS_PX, seed=seed)
        assumed = {"psf_sigma_px": PUBLISHED[1]}
        yield Case(f"bench, SNR {snr}, {seed}", burst, truth.distance_m, truth.valid, assumed)


def means(image: NDArray, offset: NDArray, size: int, shape: tuple[int, int]) -> NDArray:
    """Return the means over size x size fine pixels, begun at size i - offset."""

    def along(count: int, fine: int, shift: float) -> NDArray[np.float64]:
        edges = np.arange(fine + 1)
        start = size * np.arange(count)[:, None] - shift
        covered = np.clip(np.minimum(edges[1:], start + size) - np.maximum(edges[:-1], start), 0, 1)
        covered[:, 0] += np.clip(-start[:, 0], 0, size)
        covered[:, -1] += np.clip(start[:, 0] + size - fine, 0, size)
        return covered / size

    rows = along(shape[0], image.shape[0], offset[0])
    return rows @ image @ along(shape[1], image.shape[1], offset[1]).T


def o3d(folder: Path, seed: int) -> Iterator[Case]:
    with h5py.File(folder / "tof_data" / "ifm_o3d303" / "o3d3xx.h5") as file:
        camera = file["o3d3xx/camera"]
        for frame in sorted(camera["amplitude"]):
            amplitude = np.array(camera["amplitude"][frame], np.float64)
            seen = (np.array(camera["confidence"][frame]) & 1) == 0
            phase = distance_to_phase(np.array(camera["depth"][frame]) / 1000.0, MODULATION_HZ)
            fine = np.where(seen, amplitude * np.exp(1j * phase), 0)
            for snr in (50, 15):
                yield _semi_real(f"O3D {int(frame)}, SNR {snr}, {seed}", fine, seen, snr, seed)


def espros(folder: Path, seed: int) -> Iterator[Case]:
    for name in ("grid", "dodecahedron", "vanishing_lines"):
        stored = np.asarray(
            Image.open(folder / "tof_data" / "espros_dme635" / f"zhaw_{name}_depth.png")
        )
        depth_m = np.kron(stored / 1000.0, np.ones((2, 2)))
        patches = gaussian_filter(np.random.default_rng(1).standard_normal(depth_m.shape), 12) > 0
        seen = depth_m > NEAREST_M
        light = np.where(patches, 0.85, 0.15) / np.maximum(depth_m, NEAREST_M) ** 2
        fine = np.where(seen, light * np.exp(1j * distance_to_phase(depth_m, MODULATION_HZ)), 0)
        for snr in (50, 15):
            yield _semi_real(f"{name[:12]}, SNR {snr}, {seed}", fine, seen, snr, seed)


def _semi_real(name: str, fine: NDArray, seen: NDArray, snr: float, seed: int) -> Case:
    rng = np.random.default_rng(seed)
    actual_px = OFFSETS_PX + SHIFT_ERROR_PX * rng.standard_normal((4, 2))
    sigma = FINE * BLUR_PX
    blurred = gaussian_filter(fine.real, sigma) + 1j * gaussian_filter(fine.imag, sigma)
    shape = (seen.shape[0] // FINE, seen.shape[1] // FINE)
    twice = (2 * shape[0], 2 * shape[1])
    mask = seen.astype(np.float64)
    y = np.stack([means(blurred, FINE * o, FINE, shape) for o in actual_px])
    whole = np.stack([means(mask, FINE * o, FINE, shape) > 0.99 for o in actual_px])
    least = LEAST_SNR * np.median(np.abs(y)) / snr
    y = noisy(y, snr, seed)
    valid = whole & (np.abs(y) >= least)
    burst = Burst.from_arrays(
        np.abs(y), phase_to_distance(np.angle(y), MODULATION_HZ), offset_px=OFFSETS_PX,
        pitch_mm=0.1, modulation_hz=MODULATION_HZ, valid=valid,
    )  # fmt: skip
    truth = means(fine, np.zeros(2), FINE // 2, twice)
    judged = means(mask, np.zeros(2), FINE // 2, twice) > 0.99
    judged &= np.kron(valid.any(axis=0), np.ones((2, 2))) > 0
    return Case(name, burst, phase_to_distance(np.angle(truth), MODULATION_HZ), judged)


def reference(folder: Path) -> Case:
    stored = np.load(folder / "irwsr" / "tofphasor_x2_4f_input.npz")
    y, truth = np.moveaxis(stored["LR"], -1, 0), stored["gt"]
    hz = SPEED_OF_LIGHT_MPS / (2 * UNAMBIGUOUS_M)
    burst = Burst.from_arrays(
        np.abs(y), phase_to_distance(np.angle(y), hz), offset_px=-stored["shifts"][:, ::-1],
        pitch_mm=0.1, modulation_hz=hz,
    )  # fmt: skip
    inside = np.zeros(truth.shape, np.bool_)
    inside[4:-4, 4:-4] = True
    return Case("tofphasor_x2_4f", burst, phase_to_distance(np.angle(truth), hz), inside)


def measure(case: Case) -> list[float]:
    """Print and return the errors at edges, elsewhere and everywhere, and the time, of each."""
    row = []
    for channel, method in LIKE:
        start_s = time.perf_counter()
        found = reconstruct(
            case.burst, 2, method, channel=channel, std=False, **case.assumed
        ).distance_m
        spent_s = time.perf_counter() - start_s
        error = depth_error(found.image, case.truth_m, truth_valid=case.valid, scale=2)
        row += [1e3 * error.edge_rmse_m, 1e3 * error.flat_rmse_m, 1e3 * error.rmse_m, spent_s]
    show(case.name, row)
    return row


def show(name: str, row: list[float]) -> None:
    cells = (" {:6.1f} {:6.1f} {:6.1f} {:5.2f}".format(*row[i : i + 4]) for i in range(0, 12, 4))
    print(
        f"{name:24s} |{' |'.join(cells)} | {row[8] / row[0]:5.2f} {row[8] / row[4]:5.2f}",
        flush=True,
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("reference", type=Path, help="folder of reference data")
    parser.add_argument("--seeds", type=int, default=1)
    arguments = parser.parse_args()
    warnings.simplefilter("ignore")
    titles = " | ".join(f"{channel + ' ' + method:>26s}" for channel, method in LIKE)
    print(f"{'':24s} | {titles} | ratio of edges to")
    columns = " | ".join([f"{'edge':>6s} {'flat':>6s} {'all':>6s} {'s':>5s}"] * len(LIKE))
    print(f"{'RMSE in mm':24s} | {columns} |  auto    tv")
    rows = defaultdict(list)
    rows["tofphasor_x2_4f"].append(measure(reference(arguments.reference)))
    for seed in range(arguments.seeds):
        for case in (
            *boxes(seed),
            *bench(seed),
            *o3d(arguments.reference, seed),
            *espros(arguments.reference, seed),
        ):
            rows[case.name.rpartition(",")[0]].append(measure(case))
    print("means over seeds")
    for name, each in rows.items():
        show(name, np.mean(each, axis=0).tolist())


if __name__ == "__main__":
    main()
