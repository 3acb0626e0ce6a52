"""The slanted edge: one frame, bicubic, sensor shift and lens shift against the limits."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from lensshift.camera import TofCamera, named_pattern_px, simulate_tof
from lensshift.core.arrays import Floats, Mask
from lensshift.evaluation.edge_gradient import profile_edge
from lensshift.evaluation.limits import pixel_aperture_mtf
from lensshift.evaluation.slanted_edge import EdgeResult
from lensshift.pipeline.paper import bench
from lensshift.pipeline.paper.claims import Claim, Number, exactly, mean_interval, span
from lensshift.pipeline.paper.gratings import (
    SOLVERS,
    GratingRun,
    frequencies,
    mean_gratings,
    pictures,
)
from lensshift.scene import slanted_edge_card
from lensshift.scene.targets import SLANT_RAD

FREQUENCY_LPMM = np.linspace(0.0, 8.0, 81)
KINDS = ("one frame", "bicubic", *SOLVERS)
BITS = (12, 8, 6, 5)  # the camera's first
NEAR = 0.05  # modulation: two curves agree
_TO_LPMM = 6.0  # just below the Nyquist frequency of the result
_AT_LPMM = 5.5  # where edge and grating are compared in words
_LEAVES_LPMM = 4.0  # where the paper's frame leaves the limit
# Whose shift, with the default and with the linear yardstick.
_BOTH = (("", "lens shift"), (", tikhonov", "lens shift, tikhonov"))


@dataclass(frozen=True, slots=True, eq=False)
class EdgeRun:
    """One draw of noise and shift errors."""

    edges: dict[str, EdgeResult]  # kind -> measurement
    images: dict[str, Floats]  # kind -> [row col]
    departures: dict[int, float]  # bits (0: all) -> rms of the frame from its limit, 4 LP/mm up


def take_edge(seed: int, response: bench.Response = bench.PUBLISHED) -> EdgeRun:
    """Simulate the edge card with both ways of shifting, and measure all images of it."""
    lens, sensor, unrounded = (
        simulate_tof(
            slanted_edge_card(), replace(camera, output="float") if alone else camera,
            named_pattern_px("square")[: 1 if alone else 4], shift_error_px=bench.SHIFT_ERROR_PX,
            seed=seed,
        ).burst
        for camera, alone in ((_camera(0), False), (_camera(None), False), (_camera(0), True))
    )  # fmt: skip
    images = pictures(lens, sensor, response)
    edges = {
        kind: bench.measured_edge(image, 1 if kind == "one frame" else 2, FREQUENCY_LPMM)
        for kind, image in images.items()
    }
    frame, departures = np.asarray(unrounded.amplitude[0]), {}
    for bits in (0, *BITS):
        step = np.max(frame) / 2**bits
        rounded = np.round(frame / step) * step if bits else frame
        departures[bits] = _departure(bench.measured_edge(rounded, 1, FREQUENCY_LPMM))
    return EdgeRun(edges, images, departures)


def _camera(element: int | None) -> TofCamera:
    return bench.paper_camera(
        bench.SNR, bench.CARD_LIGHT, bench.CARD_LIGHT, optics="petzval_a", element=element
    )


def _departure(edge: EdgeResult) -> float:
    beyond = FREQUENCY_LPMM > _LEAVES_LPMM
    return _rms(edge.mtf.modulation[beyond], limit(1.0)[beyond])


def edge_claims(runs: list[EdgeRun], gratings: list[GratingRun]) -> list[Claim]:
    """Return the claims of the paper's second experiment."""
    return [
        _frame_at_limit(runs),
        _quantisation(runs),
        _bicubic_below(runs),
        _both_shifts_equal(runs, gratings),
        _near_half_pixel(runs, gratings),
        _width(runs, gratings),
        _stair_steps(runs),
    ]


def mean_curve(runs: list[EdgeRun], kind: str) -> Floats:
    """Return the MTF of a kind at `FREQUENCY_LPMM`, averaged over the runs."""
    return np.asarray(np.mean([run.edges[kind].mtf.modulation for run in runs], axis=0))


def limit(share: float) -> Floats:
    """Return what a pixel of a share of the pitch lets through along the normal of the edge."""
    return pixel_aperture_mtf(FREQUENCY_LPMM, share * bench.PITCH_MM, angle_rad=SLANT_RAD)


def upto(frequency_lpmm: Floats, good: Mask) -> float:
    """Return the highest frequency up to which all is good, 0 if the first is not."""
    count = int(np.argmin(good)) if not np.all(good) else good.size
    return float(frequency_lpmm[count - 1]) if count else 0.0


def edge_and_grating(
    runs: list[EdgeRun], gratings: list[GratingRun], kind: str
) -> dict[str, float]:
    """Return up to where edge and grating agree, and up to where the grating is at half a pixel."""
    at, shown = frequencies(gratings), mean_gratings(gratings, kind)
    edge = np.interp(at, FREQUENCY_LPMM, mean_curve(runs, kind))
    half = np.interp(at, FREQUENCY_LPMM, limit(0.5))
    return {
        "agree": upto(at, np.abs(edge - shown) <= NEAR),
        "reaches": upto(at, shown >= half - NEAR),
    }


def _over(runs: list[EdgeRun], number: Callable[[EdgeRun], float], **signed: bool) -> Number:
    return mean_interval([number(run) for run in runs], **signed)


def _rms(one: Floats, other: Floats) -> float:
    return float(np.sqrt(np.mean((one - other) ** 2)))


def _frame_at_limit(runs: list[EdgeRun]) -> Claim:
    before = FREQUENCY_LPMM <= _LEAVES_LPMM
    full = limit(1.0)[before]
    away = _over(runs, lambda r: _rms(r.edges["one frame"].mtf.modulation[before], full))
    leaves = _over(runs, lambda run: _departure(run.edges["one frame"]))
    return Claim(
        id="frame-at-full-pixel-limit",
        statement="The MTF of one frame is close to the limit of a full pixel and leaves it near "
        "4 LP/mm.",
        paper="close up to 4 LP/mm (figure 5)",
        numbers={"away": away, "leaves": leaves},
        why=f"Up to 4 LP/mm it is {away[0]:.3f} rms from |sinc| along the normal of the edge (lens "
        f"included, sinc^2 would be lower), from there to 8 LP/mm {leaves[0]:.3f}.",
    )


def _quantisation(runs: list[EdgeRun]) -> Claim:
    share = _over(runs, lambda run: 1.0 - run.departures[0] / run.departures[BITS[0]], signed=True)
    by_bits = ", ".join(
        f"{bits or 'no'} bit {np.mean([run.departures[bits] for run in runs]):.4f}"
        for bits in (0, *BITS)
    )
    return Claim(
        id="quantisation-leaves-limit",
        statement="The frame leaves the limit near 4 LP/mm because of its low quantisation.",
        paper="as a result of quantisation",
        numbers={"share": share},
        why=f"Rms from the limit between 4 and 8 LP/mm, one frame rounded afterwards: {by_bits}. "
        f"Twelve bits are the camera's; its rounding accounts for {share[0]:.1%} of the departure.",
    )


def _bicubic_below(runs: list[EdgeRun]) -> Claim:
    half = [[r.edges[one].mtf50_lpmm.value for r in runs] for one in ("bicubic", "one frame")]
    ratio = mean_interval([one / other for one, other in zip(*half, strict=True)])
    return Claim(
        id="bicubic-below-frame",
        statement="Bicubic interpolation is worse than the frame that it interpolates.",
        paper="curve below (figure 5)",
        numbers={"mtf50": ratio},
        why=f"Its MTF50 is {ratio[0]:.3f} times that of the frame: interpolation adds a blur and "
        "no sample.",
    )


def _both_shifts_equal(runs: list[EdgeRun], gratings: list[GratingRun]) -> Claim:
    within = FREQUENCY_LPMM <= _TO_LPMM
    numbers: dict[str, Number] = {}
    for whose, kind in _BOTH:
        other = kind.replace("lens", "sensor")
        # Noise and shift errors are drawn alike, but act on other pictures: means are compared.
        edge = _rms(mean_curve(runs, kind)[within], mean_curve(runs, other)[within])
        wave = _rms(mean_gratings(gratings, kind), mean_gratings(gratings, other))
        singles = [
            _rms(*(run.edges[one].mtf.modulation[within] for one in (kind, other))) for run in runs
        ]
        numbers |= {f"edge{whose}": (edge, span([edge, *singles]))}
        numbers |= {f"grating{whose}": exactly(wave)}
    return Claim(
        id="lens-shift-equals-sensor-shift",
        statement="Shifting the lens gives nearly the same MTF as shifting the sensor.",
        paper="curves nearly coincide (figure 5)",
        numbers=numbers,
        why=f"The mean edge curves are {numbers['edge'][0]:.4f} rms apart, with tikhonov "
        f"{numbers['edge, tikhonov'][0]:.4f}; the gratings {numbers['grating'][0]:.4f} and "
        f"{numbers['grating, tikhonov'][0]:.4f}, with the lens traced surface by surface.",
    )


def _near_half_pixel(runs: list[EdgeRun], gratings: list[GratingRun]) -> Claim:
    numbers: dict[str, Number] = {}
    between = (FREQUENCY_LPMM >= 2.0) & (FREQUENCY_LPMM <= 5.0)
    half = limit(0.5)
    for whose, kind in _BOTH:
        found = edge_and_grating(runs, gratings, kind)
        above = [
            one.modulation[kind] - float(np.interp(one.frequency_lpmm, FREQUENCY_LPMM, half))
            for one in gratings
            if 2.0 <= one.frequency_lpmm <= 5.0
        ]
        over = [float(np.mean((r.edges[kind].mtf.modulation - half)[between])) for r in runs]
        numbers |= {
            f"edge{whose}": mean_interval(over, signed=True),
            f"grating{whose}": (float(np.mean(above)), span(above)),  # of the frequencies
            f"agree{whose}": exactly(found["agree"]),
        }
    return Claim(
        id="near-half-pixel-limit",
        statement="The super-resolved MTF is close to the limit of a half pixel, above it from "
        "about 2 to 7 LP/mm, below it beyond.",
        paper="above from 2 to 7 LP/mm (figure 5)",
        numbers=numbers,
        why=f"Between 2 and 5 LP/mm edges are {numbers['edge'][0]:+.3f} from |sinc| of half a "
        f"pixel, gratings {numbers['grating'][0]:+.3f} (tikhonov "
        f"{numbers['edge, tikhonov'][0]:+.3f} and {numbers['grating, tikhonov'][0]:+.3f}). "
        f"{_agreement(runs, gratings)} The published solver leaves "
        f"{_at(gratings, 'lens shift, as published', 4.0):.2f} of a grating of 4 LP/mm.",
    )


def _agreement(runs: list[EdgeRun], gratings: list[GratingRun]) -> str:
    """Say up to where edge and grating agree, and how they differ at the end."""
    said = []
    for name, kind in (("", "lens shift"), ("tikhonov: ", "lens shift, tikhonov")):
        edge = np.interp(_AT_LPMM, FREQUENCY_LPMM, mean_curve(runs, kind))
        agree = edge_and_grating(runs, gratings, kind)["agree"]
        said.append(
            f"{name}up to {agree:g} LP/mm, and at {_AT_LPMM:g} LP/mm the edge says {edge:.2f} "
            f"where {_at(gratings, kind, _AT_LPMM):.2f} of a grating is left"
        )
    return f"Edge and grating agree within {NEAR:g} {'; '.join(said)}."


def _at(gratings: list[GratingRun], kind: str, frequency_lpmm: float) -> float:
    return float(np.interp(frequency_lpmm, frequencies(gratings), mean_gratings(gratings, kind)))


def _width(runs: list[EdgeRun], gratings: list[GratingRun]) -> Claim:
    numbers: dict[str, Number] = {}
    for whose, kind in _BOTH:
        numbers[f"width{whose}"] = mean_interval([_narrower(run, kind) for run in runs])
        for name, value in edge_and_grating(runs, gratings, kind).items():
            numbers[f"{name}{whose}"] = exactly(value)
    return Claim(
        id="resolution-nearly-doubles",
        statement="Four shifted frames resolve nearly what a sensor of half the pixel pitch would.",
        paper="about 2",
        numbers=numbers,
        why=f"The 10-90 width of the edge is {numbers['width'][0]:.2f} times narrower than in one "
        f"frame (tikhonov {numbers['width, tikhonov'][0]:.2f}), but a grating is at the half "
        f"pixel's limit only up to {numbers['reaches'][0]:g} LP/mm (tikhonov "
        f"{numbers['reaches, tikhonov'][0]:g}). {_agreement(runs, gratings)}",
    )


def _narrower(run: EdgeRun, kind: str) -> float:
    return run.edges["one frame"].rise_mm.value / run.edges[kind].rise_mm.value


def _stair_steps(runs: list[EdgeRun]) -> Claim:
    numbers: dict[str, Number] = {}
    for whose, kind in _BOTH:
        steps = [
            jaggedness_px(run.images[kind], 2) / jaggedness_px(run.images["one frame"], 1)
            for run in runs
        ]
        numbers[f"steps{whose}"] = mean_interval(steps)
        numbers[f"width{whose}"] = mean_interval([1.0 / _narrower(run, kind) for run in runs])
    bicubic = np.mean([jaggedness_px(run.images["bicubic"], 2) for run in runs])
    frame = np.mean([jaggedness_px(run.images["one frame"], 1) for run in runs])
    return Claim(
        id="stair-steps-fall",
        statement="The stair steps along the edge fall while its sharpness stays.",
        paper="to be seen (figure 4)",
        numbers=numbers,
        why=f"The place where each line crosses the middle level leaves the straight line by "
        f"{numbers['steps'][0]:.2f} times what it does in one frame ({frame:.3f} px; bicubic "
        f"{bicubic:.3f} px; tikhonov {numbers['steps, tikhonov'][0]:.2f} times), and the edge is "
        f"{numbers['width'][0]:.2f} times as wide.",
    )


def jaggedness_px(image: Floats, scale: int) -> float:
    """Return the rms of an edge about its straight line, line by line, in LR pixels."""
    rows, cols = image.shape
    part = image[:, cols // 2 - 6 * scale : cols // 2 + 6 * scale]
    place = np.arange(part.shape[1], dtype=np.float64)
    crossing = np.array([
        profile_edge(place, line, "range", 0.1, "median").position_mm for line in part
    ])  # fmt: skip
    line = np.polynomial.Polynomial.fit(np.arange(rows), crossing, 1)
    return float(np.sqrt(np.mean((crossing - line(np.arange(rows))) ** 2))) / scale
