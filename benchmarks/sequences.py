"""How well pictures of real sequences predict frames that they were not made of.

python benchmarks/sequences.py ../shared/reference/real_sequences
python benchmarks/sequences.py ../shared/reference/real_sequences --only text disk
python benchmarks/sequences.py ../shared/reference/real_sequences --motion affine

Shifts by `register`, every other frame reconstructed at twice the resolution, root mean square
error of the prediction of the others, in grey levels. Frames of hand-held cameras shake, are
compressed and sharpened: nothing of that is in the forward model.
"""

from __future__ import annotations

import argparse
import sys
import warnings
from pathlib import Path
from typing import get_args

import numpy as np
from numpy.typing import NDArray

from lensshift import Burst, reconstruct, register
from lensshift.registration.register import Motion

FRAMES = {
    "text": 16, "disk": 16, "face_adyoron_1": 24, "face_adyoron_2": 24, "adyoron_rotation": 12,
    "eia": 16,
}  # fmt: skip
METHODS = ("auto", "tikhonov", "tv", "l1-btv", "irwsr")
BORDER_PX = 3


def errors(y: NDArray[np.uint8], first: int, motion: Motion) -> tuple[list[float], str]:
    """Return the errors of all methods from frames first, first + 2, ..., and what auto says."""
    burst = Burst.from_arrays(y, offset_px=np.zeros((len(y), 2)), pitch_mm=0.01)
    burst = register(burst, motion=motion)
    used = list(range(first, len(y), 2))
    cut = int(np.ceil(np.abs(burst.offset_px).max())) + BORDER_PX
    inner = (slice(cut, -cut), slice(cut, -cut))
    found, said = [], ""
    for method in METHODS:
        estimate = reconstruct(
            burst, 2, method=method, channel="amplitude", frames=used, std=False
        ).amplitude
        held = [k for k in range(len(y)) if k not in used]
        rest = np.stack([(estimate.predict(k) - y[k].astype(float))[inner] for k in held])
        found.append(float(np.sqrt(np.mean(rest**2))))
        said = said or str(estimate.notes.get("contradiction", "")).split(":")[0]
    return found, said


def main() -> None:
    """Print a line for each sequence and half of its frames."""
    ask = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    ask.add_argument("folder", type=Path, help="with mdsp_text.npz and the like")
    ask.add_argument("--only", nargs="+", choices=FRAMES, default=list(FRAMES))
    ask.add_argument("--motion", choices=get_args(Motion), default="auto", help="of the frames")
    given = ask.parse_args()
    warnings.simplefilter("ignore")
    sys.stdout.write(f"{'frames':24s}" + "".join(f"{m:>10s}" for m in METHODS) + "  auto says\n")
    for name in given.only:
        y = np.ascontiguousarray(np.load(given.folder / f"mdsp_{name}.npz")["frames"])
        for first, half in enumerate(("even", "odd")):
            found, said = errors(y[: FRAMES[name]], first, given.motion)
            line = f"{name + ', ' + half:24s}" + "".join(f"{e:10.2f}" for e in found)
            sys.stdout.write(f"{line}  {said}\n")
            sys.stdout.flush()


if __name__ == "__main__":
    main()
