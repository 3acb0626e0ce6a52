"""Write trained weights in the form that the package reads, and their checksum beside them.

python training/export.py solver.pt src/lensshift/reconstruction/learned/brightness.npz
python training/export.py phasor.pt src/lensshift/reconstruction/learned/phasor.npz
python training/export.py response.pt src/lensshift/reconstruction/learned/response.npz
"""

from __future__ import annotations

import argparse
import hashlib
import io
import re
import sys
from pathlib import Path

import numpy as np
import torch
from network import Solver
from phasor_network import PhasorSolver

from lensshift.reconstruction.learned.network import OF_PICTURES, Network


def arrays_of(state: dict[str, torch.Tensor], of_pictures: bool) -> dict[str, np.ndarray]:
    """Return the arrays of the file: the level of brightness already left out.

    Half precision is enough, and all files are to stay below 1.5 MB.
    """
    found = {}
    for name, values in state.items():
        if match := re.fullmatch(r"priors\.(\d+)\.layers\.(\d+)\.weight", name):
            stage, layer = match.groups()
            weight = values.double().numpy().copy()
            if layer == "0" and of_pictures:
                weight[:, :4] -= weight[:, :4].mean((1, 2, 3), keepdims=True)
            out_channels = weight.shape[0]
            taps = weight.transpose(2, 3, 1, 0).reshape(-1, out_channels)
            found[f"layer_{stage}_{layer}"] = taps.astype(np.float16)
        elif match := re.fullmatch(r"priors\.(\d+)\.facts\.(weight|bias)", name):
            kind = "facts" if match[2] == "weight" else "gain"
            found[f"{kind}_{match[1]}"] = values.numpy().T.astype(np.float32)
        else:
            found[name] = values.numpy().astype(np.float32)
    return found


def load_exported(
    solver: Solver | PhasorSolver, stages: tuple[Network, ...], numbers: dict[str, np.ndarray]
) -> None:
    """Put weights of the package back into the chain that is trained, to go on or to compare."""
    state = {name: torch.tensor(values) for name, values in numbers.items()}
    for t, stage in enumerate(stages):
        for n, taps in enumerate(stage.layers):
            shape = (3, 3, len(taps) // 9, taps.shape[1])
            state[f"priors.{t}.layers.{n}.weight"] = torch.tensor(
                taps.reshape(shape).transpose(3, 2, 0, 1)
            )
        state[f"priors.{t}.facts.weight"] = torch.tensor(stage.facts.T)
        state[f"priors.{t}.facts.bias"] = torch.tensor(stage.gain_offset)
    solver.load_state_dict(state)


def main() -> None:
    """Export a checkpoint of `train.py`."""
    ask = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    ask.add_argument("checkpoint", type=Path)
    ask.add_argument("out", type=Path)
    ask.add_argument("--keep", type=float, default=0.0, help="share of the weights that are there")
    given = ask.parse_args()
    file = io.BytesIO()
    name = given.out.stem
    state = torch.load(given.checkpoint, map_location="cpu")["solver"]
    found = arrays_of(state, name in OF_PICTURES)
    # A mean of both ends of a run that went on from there loses less of what was learned.
    if given.keep:
        with np.load(given.out) as there:
            found = {
                key: ((1 - given.keep) * new + given.keep * there[key]).astype(new.dtype)
                for key, new in found.items()
            }
    np.savez(file, **found)
    given.out.write_bytes(file.getvalue())
    digest = hashlib.sha256(file.getvalue()).hexdigest()
    size = given.out.stat().st_size / 1e6
    sys.stdout.write(f"{given.out}: {size:.2f} MB, sha256 {digest}\n")
    reader = given.out.with_name("network.py")
    if reader.exists():
        text = re.sub(f'"{name}": "[0-9a-f]*"', f'"{name}": "{digest}"', reader.read_text())
        reader.write_text(text)


if __name__ == "__main__":
    main()
