"""The nouns that travel along the chain: frozen data that know no algorithm."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from enum import Enum
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lensshift.core import burst_checks as checks
from lensshift.core.arrays import frozen
from lensshift.core.errors import DataError, about, warn_quality
from lensshift.core.frame import Frame as Frame
from lensshift.core.grid import Grid as Grid
from lensshift.core.intrinsics import Intrinsics
from lensshift.core.motion import ShiftField as ShiftField
from lensshift.core.motion import ShiftPlan as ShiftPlan
from lensshift.core.motion import StageMap as StageMap
from lensshift.core.optical import MtfCurve as MtfCurve
from lensshift.core.point_cloud import PointCloud, make_cloud
from lensshift.core.showing import AsDataset, AsTable, Shown
from lensshift.core.units import doubt_about_pitch

OffsetSource = Literal["planned", "calibrated", "registered", "unknown"]
OFFSET_SOURCES: tuple[OffsetSource, ...] = get_args(OffsetSource)


class Status(Enum):
    """How a reconstruction ended."""

    CONVERGED = "converged"
    COMPLETE = "all stages done"
    MAX_ITERATIONS = "stopped at the iteration limit"
    DIRECT = "computed directly, without iterations"
    CONTRADICTED = "the frames contradict the picture"
    NOT_FINITE = "the estimate is not finite"


# Fields of a burst that have one entry a frame, if they are known.
FRAME_FIELDS = (
    "distance_m", "valid", "offset_sigma_px", "affine", "stage_mm", "stage_commanded_mm", "time_s",
)  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Burst(Shown, AsDataset, AsTable):
    """K frames of one static scene, each with the lens at another position.

    Arrays are copied and read-only: what was checked here cannot change any more.

    Parameters
    ----------
    amplitude : [frame row col] normalised amplitude, or complex phasors
    offset_px : [frame 2] (row, col); positive: the content moved down / right in that frame
    grid : the LR sampling grid
    distance_m : [frame row col] radial distance, or None
    valid : [frame row col] False where a pixel must not be used; by default all are good
    offset_sigma_px : [frame 2] standard deviation of `offset_px`, or None
    offset_source : where the offsets come from; "unknown": all are 0 until `register` finds them
    affine : [frame 2 2] how frames turn, grow and shear, or None: pixel u is moved by
        offset_px + affine (u - middle of the sensor)
    stage_mm, stage_commanded_mm : [frame 2] lens position read back and asked for, or None
    time_s : [frame] or None
    modulation_hz : modulation frequency; all of them if the distances are of several; or None
    intrinsics : where the pixels look, of the image at offset (0, 0), or None
    phasors : [frequency frame row col] a exp(4 pi i f d / c) of each frequency, or None
    raw : name -> [frame ...] what the camera sent, as it sent it
    meta : anything else worth keeping, text and numbers. `psf_sigma_px`, the Gaussian width of the
        pixel response in LR pixels, is what `reconstruct` assumes unless it is told another

    Raises
    ------
    DataError
        If a field has the wrong shape or type, or is not finite where it is valid.
    """

    amplitude: NDArray[Any]
    offset_px: NDArray[np.float64]
    grid: Grid
    distance_m: NDArray[Any] | None = None
    valid: NDArray[np.bool_] = field(default_factory=checks.all_valid)
    offset_sigma_px: NDArray[np.float64] | None = None
    offset_source: OffsetSource = "planned"
    affine: NDArray[np.float64] | None = None
    stage_mm: NDArray[np.float64] | None = None
    stage_commanded_mm: NDArray[np.float64] | None = None
    time_s: NDArray[np.float64] | None = None
    modulation_hz: float | tuple[float, ...] | None = None
    intrinsics: Intrinsics | None = None
    phasors: NDArray[np.complex128] | None = None
    raw: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    meta: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        frames = checks.as_frames(self.amplitude, "amplitude")
        count = frames.shape[0]
        if frames.shape[1:] != self.grid.shape:
            problem = f"expected frames of the grid's shape {self.grid.shape}"
            raise DataError(f"{problem}, got {frames.shape[1:]}", field="amplitude")
        valid = checks.as_valid(self.valid, frames)
        checks.check_finite_where_valid(frames, valid, "amplitude")
        settle: dict[str, Any] = {"amplitude": frames, "valid": valid}
        if self.distance_m is not None:
            distance_m = checks.as_frames(self.distance_m, "distance_m", shape=frames.shape)
            checks.check_finite_where_valid(distance_m, valid, "distance_m")
            settle["distance_m"] = distance_m
        for name in ("offset_px", "offset_sigma_px", "stage_mm", "stage_commanded_mm"):
            if name == "offset_px" or getattr(self, name) is not None:
                settle[name] = checks.as_pairs(getattr(self, name), count, name)
        if self.affine is not None:
            settle["affine"] = checks.as_numbers(self.affine, (count, 2, 2), "affine")
        if self.time_s is not None:
            settle["time_s"] = checks.as_numbers(self.time_s, (count,), "time_s")
        if self.offset_source not in OFFSET_SOURCES:
            problem = f"expected one of {', '.join(OFFSET_SOURCES)}, got {self.offset_source!r}"
            raise DataError(problem, field="offset_source")
        settle["modulation_hz"] = checks.as_frequencies(self.modulation_hz)
        if self.phasors is not None:
            settle["phasors"] = checks.as_phasors(self.phasors, settle["modulation_hz"], valid)
        if self.intrinsics is not None:
            checks.check_intrinsics(self.intrinsics, self.grid.shape)
        for name, values in self.raw.items():
            if np.ndim(values) < 1 or len(values) != count:
                problem = f"expected one entry a frame, got shape {np.shape(values)}"
                raise DataError(problem, field=f"raw_{name}")
        frequencies = settle.pop("modulation_hz")
        settle = {name: frozen(value) for name, value in settle.items()}
        settle["raw"] = {name: frozen(values) for name, values in self.raw.items()}
        settle |= {"modulation_hz": frequencies, "meta": dict(self.meta)}
        for name, value in settle.items():
            object.__setattr__(self, name, value)

    @classmethod
    def from_arrays(
        cls,
        amplitude: ArrayLike,
        distance_m: ArrayLike | None = None,
        *,
        offset_px: ArrayLike | None = None,
        pitch_mm: float | tuple[float, float] = 1.0,
        modulation_hz: float | Sequence[float] | None = None,
        valid: ArrayLike | None = None,
        **fields: Any,
    ) -> Burst:
        """Make a burst from plain arrays.

        Parameters
        ----------
        amplitude, distance_m, valid : [frame row col], valid also [row col]; what `numpy.ma` masks
            is not valid; complex amplitudes [frequency frame row col] are the phasors of several
            frequencies, and the amplitude then that of the highest
        offset_px : [frame 2] as (row, col); None: unknown, for `register` to find
        pitch_mm : LR pixel pitch, one number or (row, col); 1 if it does not matter
        fields : any other field of `Burst`

        Raises
        ------
        DataError
            If the arrays do not fit together.

        Warns
        -----
        QualityWarning
            If pitch, frequency or distances can hardly be in mm, Hz and m, or frames seem to lie
            along another axis than the first; of distances that stand for none, whose pixels are
            not valid then.
        """
        valid = checks.unmasked(valid, amplitude, distance_m)
        given = checks.as_array(amplitude, "amplitude")
        frequencies = checks.as_frequencies(modulation_hz)
        if given.ndim == 4 and given.dtype.kind == "c":
            fields["phasors"] = checks.as_phasors(given, frequencies)
            given = np.abs(given[int(np.argmax(np.asarray(frequencies, np.float64)))])
        frames = checks.as_frames(given, "amplitude")
        of_axes = checks.doubt_about_axes(frames, offset_px)
        pitch = np.ravel(np.asarray(pitch_mm, dtype=np.float64))
        if pitch.size not in (1, 2):
            raise DataError(f"expected one or two numbers, got {pitch_mm}", field="pitch_mm")
        if offset_px is None:
            fields.setdefault("offset_source", "unknown" if len(frames) > 1 else "planned")
        rows, cols = (int(n) for n in frames.shape[1:])
        with about("pitch_mm"):
            grid = Grid((rows, cols), (float(pitch[0]), float(pitch[-1])))
        burst = cls(
            amplitude=frames,
            offset_px=np.zeros((len(frames), 2)) if offset_px is None else np.asarray(offset_px),
            grid=grid,
            distance_m=None if distance_m is None else np.asarray(distance_m),
            valid=checks.all_valid() if valid is None else np.asarray(valid),
            modulation_hz=frequencies,
            **fields,
        )
        of_phases = checks.doubt_about_phases(frames) if distance_m is None else ""
        doubts = [of_axes, of_phases, doubt_about_pitch(max(grid.pitch_mm))]
        known = burst.valid, burst.frequencies_hz
        if burst.distance_m is not None:
            left, of_codes = checks.unmeasured(burst.amplitude, burst.distance_m, *known)
            if left.any():
                burst = replace(burst, valid=burst.valid & ~left)
            doubts += [of_codes]
        doubts += [checks.doubt_about_distances(burst.distance_m, *known)]
        for doubt in filter(None, doubts):
            warn_quality(doubt)
        return burst

    @property
    def frame_count(self) -> int:
        """Number of frames."""
        return int(self.amplitude.shape[0])

    @property
    def frequencies_hz(self) -> tuple[float, ...]:
        """All modulation frequencies that are known."""
        return tuple(np.ravel([] if self.modulation_hz is None else self.modulation_hz).tolist())

    @property
    def shift_field(self) -> ShiftField | None:
        """Offset of every pixel of frames that turn, grow or shear; None if they only shift."""
        if self.affine is None:
            return None
        away = [np.arange(size) - (size - 1) / 2 for size in self.grid.shape]
        at = np.stack(np.meshgrid(*away, indexing="ij"), axis=-1)
        moved_px = np.einsum("kij,rcj->krci", self.affine, at)
        return ShiftField(self.offset_px[:, None, None] + moved_px, self.grid.pitch_mm)

    def select(self, frames: Sequence[int]) -> Burst:
        """Return the burst that holds only the given frames, in the given order."""
        index, count = np.asarray(list(frames), dtype=np.intp), self.frame_count
        if index.size == 0 or index.min() < -count or index.max() >= count:
            raise ValueError(f"expected frame numbers from 0 to {count - 1}, got {list(frames)}")
        each = {name: getattr(self, name) for name in ("amplitude", "offset_px", *FRAME_FIELDS)}
        kept: dict[str, Any] = {n: None if one is None else one[index] for n, one in each.items()}
        phasors = None if self.phasors is None else self.phasors[:, index]
        raw = {name: values[index] for name, values in self.raw.items()}
        return replace(self, phasors=phasors, raw=raw, **kept)


def expect_burst(value: object) -> None:
    """Raise a `TypeError` that says what makes a burst, unless this is one."""
    if not isinstance(value, Burst):
        raise TypeError(
            f"expected a Burst, got {type(value).__name__}; Burst.from_arrays makes one of arrays, "
            "load_burst and load_image_stack of files"
        )


def _no_prediction(frame: int | ArrayLike) -> NDArray[Any]:
    raise ValueError("this estimate carries no forward model and cannot predict a frame")


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Estimate(Shown):
    """One HR channel and the story of how it was found.

    Parameters
    ----------
    image : [row col] on the HR grid
    uncertainty : [row col] standard deviation of `image` from the frames' noise, or a function
        that computes it when `std` is first asked for, the estimate pickled or copied; or None
    objective : its value after each outer iteration
    status : how the iterations ended
    confidence : [frame row col] weight of each LR pixel in 0 .. 1, or None
    prior_weight : weight of the prior that was used, or None
    noise_sigma : standard deviation of the noise of one LR pixel, given or estimated, or None
    predict : called with a frame number of the burst or an offset (row, col) in LR pixels,
        returns that LR frame as the forward model sees `image`
    notes : what else the method found out, text and numbers
    misfit : [row col] chi-square of the frames that touch a pixel, 1 where all is well; or None
    fine : [row col] smaller pixels of which `image` is the mean, if it was found so; or None
    """

    image: NDArray[Any]
    uncertainty: NDArray[np.float64] | Callable[[], NDArray[np.float64]] | None = None
    objective: tuple[float, ...] = ()
    status: Status = Status.DIRECT
    confidence: NDArray[np.float64] | None = None
    prior_weight: float | None = None
    noise_sigma: float | None = None
    predict: Callable[[int | ArrayLike], NDArray[Any]] = _no_prediction
    notes: Mapping[str, Any] = field(default_factory=dict)
    misfit: NDArray[np.float64] | None = None
    fine: NDArray[Any] | None = None

    def __reduce__(self) -> tuple[Any, ...]:
        # The function behind `std` holds the whole solver, so its result travels instead.
        values = {one.name: getattr(self, one.name) for one in fields(self)}
        return Estimate, tuple((values | {"uncertainty": self.std}).values())

    @property
    def std(self) -> NDArray[np.float64] | None:
        """Standard deviation [row col] of `image`, computed once when it is first asked for."""
        if callable(self.uncertainty):
            object.__setattr__(self, "uncertainty", self.uncertainty())
        return self.uncertainty  # type: ignore[return-value]

    @property
    def noise_gain(self) -> float | None:
        """Noise of an HR pixel over noise of an LR pixel (rms over the image), or None."""
        if self.notes.get("std_of") == "error":  # not the noise alone: `auto`
            return None
        if self.noise_sigma is None or self.noise_sigma <= 0 or self.std is None:
            return None
        return float(np.sqrt(np.mean(self.std**2)) / self.noise_sigma)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Reconstruction(Shown, AsDataset):
    """What `reconstruct` returns: the channels on the HR grid and how they were made.

    Parameters
    ----------
    amplitude, distance_m : the channels, or None where a channel was not asked for
    grid : the HR grid
    scale : upscaling factor
    method : registered name of the method
    settings : everything else the caller or `auto` chose
    flying : [row col] pixels between two surfaces, or that frames hardly show, by the phasor
        channel; else None
    intrinsics : where the pixels of the HR grid look, or None if the burst did not say
    """

    amplitude: Estimate | None
    distance_m: Estimate | None
    grid: Grid
    scale: int
    method: str
    settings: Mapping[str, Any] = field(default_factory=dict)
    flying: NDArray[np.bool_] | None = None
    intrinsics: Intrinsics | None = None

    def __post_init__(self) -> None:
        if self.intrinsics is not None:
            checks.check_intrinsics(self.intrinsics, self.grid.shape)

    @property
    def channels(self) -> Mapping[str, Estimate]:
        """The channels that there are, by name: "amplitude", "distance"."""
        named = {"amplitude": self.amplitude, "distance": self.distance_m}
        return {name: estimate for name, estimate in named.items() if estimate is not None}

    def __getitem__(self, channel: Literal["amplitude", "distance"]) -> Estimate:
        if channel not in self.channels:
            known = " and ".join(self.channels) or "nothing"
            raise KeyError(f"expected a channel of this result, which has {known}; got {channel!r}")
        return self.channels[channel]

    def point_cloud(
        self,
        intrinsics: Intrinsics | None = None,
        *,
        keep_flying: bool = False,
        normals: bool = False,
    ) -> PointCloud:
        """Return the points of the distance channel, with amplitude, std and flying.

            point = distance * unit direction

        Parameters
        ----------
        intrinsics : of the HR grid (those of the LR grid: `.refine(scale)`); None: those that
            the burst came with
        keep_flying : whether pixels that mix two surfaces, or that no frame shows, are kept
        normals : whether normals are computed

        Raises
        ------
        ValueError
            If there is no distance channel, or nobody knows where the pixels look.

        Warns
        -----
        QualityWarning
            If the intrinsics can hardly be those of this image.
        """
        if self.distance_m is None:
            raise ValueError("expected a distance channel for points, this result has none")
        known = self.intrinsics if intrinsics is None else intrinsics
        if known is None:
            raise ValueError(
                "expected intrinsics for points, the burst had none; give "
                "Pinhole.of_field(result.grid, width_rad) or Pinhole.of_focal_length"
            )
        checks.check_intrinsics(known, self.grid.shape)
        if doubt := checks.doubt_about_intrinsics(known, self.grid.shape):
            warn_quality(doubt)
        return make_cloud(
            self.distance_m.image,
            known,
            amplitude=None if self.amplitude is None else np.abs(self.amplitude.image),
            std_m=self.distance_m.std,
            flying=self.flying,
            keep_flying=keep_flying,
            normals=normals,
        )
