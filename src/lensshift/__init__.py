"""Super-resolution for cameras whose lens moves a fraction of a pixel between frames.

>>> import lensshift
>>> from lensshift.pipeline import demo_burst
>>> burst, truth = demo_burst()  # yours: lensshift.Burst.from_arrays(frames, offset_px=shifts)
>>> result = lensshift.reconstruct(burst, scale=2)
>>> result["amplitude"].image.shape  # beside .image: .std, .status, .misfit, .predict
(32, 128)
>>> lensshift.fidelity(result["amplitude"].image, truth.image).psnr_db > 25
True

Files: `load_burst`, `load_image_stack`, `save_reconstruction`. Unknown shifts: `register`.
Resolution: `measure_edges`. A rig: `examine_rig`, `open_rig`. Values show themselves:
`print(result)`, `result.plot()`, `result.to_xarray()`. On the command line: ``lensshift --help``.

The folders, and who may import whom (from above to below):

::

                     cli                        you type
                      |
                    live                        the page that you look at
                      |
                   pipeline                     the whole chain in one file
                      |
                    report                      figures of results
                      |
    capture  registration  reconstruction  evaluation    stages, strangers to each other
       |                        |
    camera . . no entry . . forward             what the world does | what we assume
       |
    scene  optics         io                    files and foreign formats <-> core types
         \\_________ core _________/             nouns, grid, units, errors

Only `io` also looks up, at forward: an image from a file predicts frames like a fresh one.

Data, in order: ``Lens, Scene -> Burst -> Shifts -> Reconstruction -> EdgeResult -> page``.

Names are loaded when they are first used, so that ``import lensshift`` stays quick.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from lensshift.camera import simulate_burst as simulate_burst
    from lensshift.capture.opening import open_rig as open_rig
    from lensshift.core.calibration import Calibration as Calibration
    from lensshift.core.errors import DataError as DataError
    from lensshift.core.errors import DeviceError as DeviceError
    from lensshift.core.errors import DeviceTimeout as DeviceTimeout
    from lensshift.core.errors import QualityWarning as QualityWarning
    from lensshift.core.grid import Grid as Grid
    from lensshift.core.intrinsics import Pinhole as Pinhole
    from lensshift.core.intrinsics import PixelDirections as PixelDirections
    from lensshift.core.lens_field import LensField as LensField
    from lensshift.core.point_cloud import PointCloud as PointCloud
    from lensshift.core.stray_light import StrayLight as StrayLight
    from lensshift.core.types import Burst as Burst
    from lensshift.core.types import Estimate as Estimate
    from lensshift.core.types import Frame as Frame
    from lensshift.core.types import Reconstruction as Reconstruction
    from lensshift.core.types import ShiftField as ShiftField
    from lensshift.core.types import Status as Status
    from lensshift.evaluation import depth_error as depth_error
    from lensshift.evaluation import edge_gradient as edge_gradient
    from lensshift.evaluation import fidelity as fidelity
    from lensshift.evaluation import siemens_star_mtf as siemens_star_mtf
    from lensshift.evaluation.gain import resolution_gain as resolution_gain
    from lensshift.evaluation.slanted_edge import EdgeResult as EdgeResult
    from lensshift.evaluation.slanted_edge import measure_edge as measure_edge
    from lensshift.evaluation.slanted_edge import measure_edges as measure_edges
    from lensshift.evaluation.slanted_edge import slanted_edge_mtf as slanted_edge_mtf
    from lensshift.evaluation.stray_light import measure_stray_light as measure_stray_light
    from lensshift.io import load_burst as load_burst
    from lensshift.io import load_image_stack as load_image_stack
    from lensshift.io import load_lens_field as load_lens_field
    from lensshift.io import load_reconstruction as load_reconstruction
    from lensshift.io import load_window as load_window
    from lensshift.io import open_recording as open_recording
    from lensshift.io import save_burst as save_burst
    from lensshift.io import save_lens_field as save_lens_field
    from lensshift.io import save_reconstruction as save_reconstruction
    from lensshift.io import write_recording as write_recording
    from lensshift.optics.field import lens_field as lens_field
    from lensshift.optics.lens_file import load_lens as load_lens
    from lensshift.pipeline import run as run
    from lensshift.pipeline.doctor import examine_rig as examine_rig
    from lensshift.pipeline.recording import reconstruct_recording as reconstruct_recording
    from lensshift.reconstruction.batch import reconstruct_batch as reconstruct_batch
    from lensshift.reconstruction.methods import method_names as method_names
    from lensshift.reconstruction.reconstruct import reconstruct as reconstruct
    from lensshift.reconstruction.stream import Stream as Stream
    from lensshift.reconstruction.stream import stream as stream
    from lensshift.registration import calibrate as calibrate
    from lensshift.registration import register as register

__version__ = "0.2.0"

_NAMES = {
    "camera": "simulate_burst",
    "capture.opening": "open_rig",
    "core.calibration": "Calibration",
    "core.errors": "DataError DeviceError DeviceTimeout QualityWarning",
    "core.grid": "Grid",
    "core.intrinsics": "Pinhole PixelDirections",
    "core.lens_field": "LensField",
    "core.point_cloud": "PointCloud",
    "core.stray_light": "StrayLight",
    "core.types": "Burst Estimate Frame Reconstruction ShiftField Status",
    "evaluation": "depth_error edge_gradient fidelity siemens_star_mtf",
    "evaluation.gain": "resolution_gain",
    "evaluation.slanted_edge": "EdgeResult measure_edge measure_edges slanted_edge_mtf",
    "evaluation.stray_light": "measure_stray_light",
    "io": "load_burst load_image_stack load_lens_field load_reconstruction load_window "
    "open_recording save_burst save_lens_field save_reconstruction write_recording",
    "optics.field": "lens_field",
    "optics.lens_file": "load_lens",
    "pipeline": "run",
    "pipeline.doctor": "examine_rig",
    "pipeline.recording": "reconstruct_recording",
    "reconstruction.batch": "reconstruct_batch",
    "reconstruction.methods": "method_names",
    "reconstruction.reconstruct": "reconstruct",
    "reconstruction.stream": "Stream stream",
    "registration": "calibrate register",
}
_PARTS = {  # `lensshift.io.export_burst` without another import
    "camera", "capture", "core", "evaluation", "forward", "io", "optics", "pipeline",
    "reconstruction", "registration", "report", "scene",
}  # fmt: skip
_HOME = {name: module for module, names in _NAMES.items() for name in names.split()}

__all__ = sorted([*_HOME, "__version__"])


def __getattr__(name: str) -> Any:
    if name in _PARTS:
        return import_module(f"lensshift.{name}")
    if name not in _HOME:
        raise AttributeError(f"module 'lensshift' has no attribute {name!r}")
    value = getattr(import_module(f"lensshift.{_HOME[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return __all__
