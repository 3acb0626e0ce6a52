"""How well pictures from simulated cameras in the hand predict frames they were not made of.

python benchmarks/handheld.py --seed 300

Photographs through cameras that do what no forward model knows: sharpen, compress, shake, turn, or
have pixels of half width. Twelve frames each, shifts by `register`, every other one reconstructed
at twice the resolution; root mean square error in grey levels of the prediction of the others, and
against the truth behind the lens of the camera where it sharpens nothing. Shaken frames are
predicted best by a picture that is not sharp: the two need not agree.
"""

from __future__ import annotations

import argparse
import io
import sys
import warnings
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy.ndimage import gaussian_filter, map_coordinates
from skimage import data
from skimage.color import rgb2gray
from skimage.transform import resize

from lensshift import Burst, reconstruct, register

SHAPE, FRAMES, FINE, ROOM_PX, BORDER_PX, SCALE = (44, 52), 12, 4, 6, 3, 2
PHOTOGRAPHS = ("astronaut", "coffee", "text", "coins")
METHODS = ("auto", "tikhonov", "tv", "l1-btv")


@dataclass(frozen=True)
class Camera:
    """What it does to a scene besides sampling it.

    Widths of the lens and of shaking in px, turns in degrees (standard deviation), noise in grey
    levels, share of unsharp masking, quality of JPEG (0: none), width of a pixel.
    """

    blur_px: float = 0.5
    sharpen: float = 0.0
    quality: int = 0
    turn_deg: float = 0.0
    shake_px: float = 0.0
    pixel: float = 1.0
    noise: float = 2.0


CAMERAS = {
    "plain": Camera(),
    "sharpens": Camera(sharpen=1.0),
    "compresses": Camera(quality=80),
    "all of these, turns": Camera(sharpen=0.7, quality=85, turn_deg=0.15),
    "shakes": Camera(shake_px=1.0),
    "turns": Camera(turn_deg=0.3),
    "half pixels": Camera(pixel=0.5, blur_px=0.15),
    "blurs, compresses": Camera(blur_px=0.8, quality=70),
}


def frames(
    camera: Camera, photograph: str, seed: int
) -> tuple[NDArray[np.uint8], NDArray[np.float64]]:
    """Return frames [frame row col] of a walk over a part of a photograph, and the HR truth."""
    rng = np.random.default_rng(seed)
    rows, cols = SHAPE
    image = getattr(data, photograph)()
    image = rgb2gray(image[..., :3]) if image.ndim == 3 else image / 255.0
    size = [(side + 2 * ROOM_PX) * FINE for side in SHAPE]
    top, left = (rng.integers(0, n - s // 2) for n, s in zip(image.shape, size, strict=True))
    part = image[top : top + size[0] // 2, left : left + size[1] // 2]
    scene = gaussian_filter(255 * resize(part, size, order=3), camera.blur_px * FINE)
    walk_px = np.cumsum(rng.normal(0, 0.27, (FRAMES, 2)), axis=0)
    row, col = (
        (at + 0.5) / FINE - 0.5 - (side - 1) / 2
        for at, side in zip(np.mgrid[: rows * FINE, : cols * FINE], SHAPE, strict=True)
    )
    seen, truth = [], np.empty(0)
    for down, right in walk_px - walk_px[0]:
        turn = np.deg2rad(camera.turn_deg * rng.standard_normal())
        at_row = row * np.cos(turn) - col * np.sin(turn) - down
        at_col = row * np.sin(turn) + col * np.cos(turn) - right
        shaken = camera.shake_px * FINE * rng.random(2) * (rng.random() < 0.4)
        places = [
            (at + (side - 1) / 2 + ROOM_PX + 0.5) * FINE - 0.5
            for at, side in zip((at_row, at_col), SHAPE, strict=True)
        ]
        fine = map_coordinates(gaussian_filter(scene, shaken), places, order=1, mode="nearest")
        if not seen:
            sharp = map_coordinates(scene, places, order=1, mode="nearest")
            half = FINE // SCALE
            truth = sharp.reshape(rows * SCALE, half, cols * SCALE, half).mean(axis=(1, 3))
        cut = round((1 - camera.pixel) * FINE / 2)
        inner = slice(cut, FINE - cut)
        frame = fine.reshape(rows, FINE, cols, FINE)[:, inner, :, inner].mean(axis=(1, 3))
        frame += rng.normal(0, camera.noise, frame.shape)
        frame += camera.sharpen * (frame - gaussian_filter(frame, 1))
        seen.append(_stored(np.clip(np.round(frame), 0, 255).astype(np.uint8), camera.quality))
    return np.stack(seen), truth


def _stored(frame: NDArray[np.uint8], quality: int) -> NDArray[np.uint8]:
    if not quality:
        return frame
    file = io.BytesIO()
    Image.fromarray(frame).save(file, "jpeg", quality=quality)
    return np.asarray(Image.open(file))


def errors(
    y: NDArray[np.uint8], truth: NDArray[np.float64]
) -> tuple[list[float], list[float], str]:
    """Return the errors of each method, of prediction and of the picture, and what auto says."""
    burst = register(Burst.from_arrays(y, offset_px=np.zeros((len(y), 2)), pitch_mm=0.01))
    used = list(range(0, len(y), 2))
    cut = int(np.ceil(np.abs(burst.offset_px).max())) + BORDER_PX
    found, wrong, said = [], [], ""
    for method in METHODS:
        estimate = reconstruct(
            burst, SCALE, method=method, channel="amplitude", frames=used, std=False
        ).amplitude
        rest = [estimate.predict(k) - y[k].astype(float) for k in range(1, len(y), 2)]
        found.append(float(np.sqrt(np.mean(np.square(rest)[:, cut:-cut, cut:-cut]))))
        inner = slice(SCALE * cut, -SCALE * cut)
        wrong.append(float(np.sqrt(np.mean((estimate.image - truth)[inner, inner] ** 2))))
        said = said or str(estimate.notes.get("contradiction", "")).split(" (")[0]
    return found, wrong, said


def main() -> None:
    """Print a line for each camera and photograph, and how often auto is not behind."""
    ask = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    ask.add_argument("--seed", type=int, default=0)
    given = ask.parse_args()
    warnings.simplefilter("ignore")
    sys.stdout.write(
        f"{'':31s}" + "".join(f"{m:>10s}" for m in METHODS) + "  over best  of truth  auto says\n"
    )
    behind, astray = [], []
    for n, (name, camera) in enumerate(CAMERAS.items()):
        for k, photograph in enumerate(PHOTOGRAPHS):
            found, wrong, said = errors(*frames(camera, photograph, given.seed + 10 * n + k))
            behind.append(found[0] / min(found[1:]))
            line = f"{name:20s} {photograph:10s}" + "".join(f"{e:10.2f}" for e in found)
            line += f"{behind[-1]:11.3f}"
            if camera.sharpen:
                line += f"{'':10s}"
            else:
                astray.append(wrong[0] / min(wrong[1:]))
                line += f"{astray[-1]:10.3f}"
            sys.stdout.write(f"{line}  {said}\n")
            sys.stdout.flush()
    for what, ratios in (("predicted", behind), ("against the truth", astray)):
        near = np.count_nonzero(np.array(ratios) <= 1.02)
        sys.stdout.write(
            f"auto within 2 % of the best of the others, {what}: {near} of {len(ratios)}\n"
        )


if __name__ == "__main__":
    main()
