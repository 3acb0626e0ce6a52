"""The page, the pictures that it asks for one by one, and its controls."""

from __future__ import annotations

import asyncio
import json
import math
import os
import signal
import time
from collections.abc import AsyncIterator
from concurrent.futures import BrokenExecutor, ProcessPoolExecutor
from contextlib import asynccontextmanager, suppress
from dataclasses import asdict
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from lensshift.core.intrinsics import Intrinsics, Pinhole
from lensshift.live.controls import box_of, choices, control
from lensshift.live.gate import Gate
from lensshift.live.measure import beside, edge_curve, shift_error
from lensshift.live.picture import (
    Picture,
    frame_images,
    message,
    packed_layers,
    residual_over_noise,
)
from lensshift.live.recording import save_snapshot
from lensshift.live.worker import FAILURES, Live

if TYPE_CHECKING:
    from starlette.requests import Request
    from starlette.responses import Response
    from starlette.types import ASGIApp
    from starlette.websockets import WebSocket

_LOOK_S = 0.003  # between two looks for a new picture
_ALIVE_S = 0.5  # without a picture, the page hears at least so often that there is none
_SHIFTS_EVERY_S = 2.0  # at most so often
_SHIFTS_SHARE = 0.1  # of one core, at most
_ASSUMED_FIELD_RAD = math.radians(40.0)  # across, where nobody says where pixels look


class Pages:
    """Everything that the page asks for; recordings and snapshots go to the folder."""

    def __init__(self, live: Live, folder: Path) -> None:
        self._live, self._folder = live, folder
        self._pool: ProcessPoolExecutor | None = None
        self._shift: dict[str, float] | None = None
        self._packed: tuple[int, list[dict[str, Any]], bytes] = (0, [], b"")

    @asynccontextmanager
    async def lifespan(self, _: object) -> AsyncIterator[None]:
        """Measure shifts now and then while the server runs."""
        self._pool = beside()
        worker = self._pool.submit(os.getpid)
        measuring = asyncio.create_task(self._measure_shifts(self._pool))
        try:
            yield
        finally:
            measuring.cancel()
            with suppress(asyncio.CancelledError):
                await measuring
            self._pool.shutdown(wait=False, cancel_futures=True)
            if worker.done() and not (worker.cancelled() or worker.exception()):
                with suppress(OSError):  # else the end waits for what it measures
                    os.kill(worker.result(), signal.SIGTERM)

    async def _measure_shifts(self, pool: ProcessPoolExecutor) -> None:
        cost_s = 0.0
        while True:
            await asyncio.sleep(max(_SHIFTS_EVERY_S, cost_s / _SHIFTS_SHARE))
            picture = self._live.picture
            if picture is None or picture.window.frame_count < 2:
                self._shift = None
                continue
            try:
                found = await asyncio.get_running_loop().run_in_executor(
                    pool, shift_error, picture.window
                )
            except (ValueError, np.linalg.LinAlgError):  # nothing to register by
                self._shift = None
            except BrokenExecutor:  # somebody ended that process; the pictures go on
                return
            else:
                known = all(math.isfinite(number) for number in found.values())
                self._shift = found | {"at_s": time.monotonic()} if known else None
                cost_s = found["cost_s"]

    def head(self, picture: Picture | None) -> dict[str, Any]:
        """Return what the page is told, with or without a picture."""
        live, now_s = self._live, time.monotonic()
        places = 0 if picture is None else picture.shot.plan.frame_count
        recording, shift = live.recording, self._shift
        head: dict[str, Any] = {
            "number": 0 if picture is None else picture.number,
            "source": live.source.name,
            "pattern": live.source.pattern,
            "settings": asdict(live.settings),
            "problem": live.problem,
            "warning": live.warning,
            "ended": live.ended,
            "recording": recording and {"name": recording.path.name, "frames": recording.count},
            "numbers": {
                "frames_hz": round(live.arrived.per_s(), 2),
                "bursts_hz": round(live.visited.per_s() / places, 2) if places else None,
                "pictures_hz": round(live.solved.per_s(), 2),
                "shift": shift
                and {
                    "rms_px": round(shift["rms_px"], 5),
                    "sigma_px": round(shift["sigma_px"], 5),
                    "ago_s": round(now_s - shift["at_s"], 1),
                },
            },
        }
        if picture is not None:
            head |= _about(picture, now_s)
        return head

    async def pictures(self, socket: WebSocket) -> None:
        """Answer each "next" with a picture newer than the last one, or what there is to say."""
        from starlette.websockets import WebSocketDisconnect

        await socket.accept()
        last = 0
        with suppress(WebSocketDisconnect):
            while True:
                await socket.receive_text()
                picture = await self._newer(last)
                if picture is None:
                    await socket.send_bytes(message(self.head(self._live.picture)))
                    continue
                last = picture.number
                if self._packed[0] != last:
                    self._packed = (last, *packed_layers(picture))
                _, layers, data = self._packed
                await socket.send_bytes(message(self.head(picture) | {"layers": layers}, data))

    async def _newer(self, number: int) -> Picture | None:
        end_s = time.monotonic() + _ALIVE_S
        while time.monotonic() < end_s:
            picture = self._live.picture
            if picture is not None and picture.number > number:
                return picture
            await asyncio.sleep(_LOOK_S)
        return None

    async def begin(self, _: Request) -> Response:
        """Return what the page can choose from."""
        return _json(choices(self._live))

    async def directions(self, _: Request) -> Response:
        """Return where the pixels of the latest picture look: float32 [row col 3]."""
        from starlette.responses import Response

        picture = self._live.picture
        if picture is None:
            return _json({"error": "no picture yet"}, 409)
        data = _looks(picture)[0].directions(picture.result.grid.shape).astype("<f4").tobytes()
        headers = {"X-Geometry": _geometry(picture)}
        return Response(data, media_type="application/octet-stream", headers=headers)

    async def change(self, request: Request) -> Response:
        """Change a setting, or begin or end a recording."""
        await asyncio.to_thread(control, self._live, await _asked(request), self._folder)
        return _json(self.head(None) | {"number": None})

    async def snapshot(self, _: Request) -> Response:
        """Save the latest picture."""
        picture = self._live.picture
        if picture is None:
            return _json({"error": "no picture yet"}, 409)
        self._folder.mkdir(parents=True, exist_ok=True)
        files = await asyncio.to_thread(save_snapshot, picture, self._folder)
        return _json({"files": [path.name for path in files]})

    async def edge(self, request: Request) -> Response:
        """Measure the edge in a box, in HR pixels, on the latest picture and on one frame."""
        picture, pool = self._live.picture, self._pool
        if picture is None or pool is None:
            return _json({"error": "no picture yet"}, 409)
        box = box_of((await _asked(request)).get("box"), picture.result.grid.shape)
        name = next(iter(picture.result.channels))  # the amplitude, or else the distance
        seen = frame_images(picture.shot.frame).get(name)
        if seen is None:
            raise ValueError(f"the frames have no {name}")
        fine = np.abs(picture.result.channels[name].image)
        scale, pitch_mm = picture.result.scale, float(np.mean(picture.window.grid.pitch_mm))
        coarse = (box[0] // scale, -(-box[1] // scale), box[2] // scale, -(-box[3] // scale))
        loop, found, most_lpmm = asyncio.get_running_loop(), {}, 0.6 * scale / pitch_mm
        for of, image, times, place in (("one", seen, 1, coarse), ("fine", fine, scale, box)):
            try:
                found[of] = await loop.run_in_executor(
                    pool, edge_curve, image, pitch_mm / times, times, place, most_lpmm
                )
            except BrokenExecutor as error:
                return _json({"error": f"the measuring process has gone: {error}"}, 500)
            except asyncio.CancelledError:  # the server ends, which is no error of this request
                return _json({"error": "lensshift live is ending"}, 503)
        nyquist = {"one_lpmm": 0.5 / pitch_mm, "fine_lpmm": 0.5 * scale / pitch_mm}
        return _json({"box": box, "number": picture.number, "nyquist": nyquist, **found})


def _about(picture: Picture, now_s: float) -> dict[str, Any]:
    result, residual = picture.result, residual_over_noise(picture.result)
    return {
        "made": {
            **{name: result.settings.get(name) for name in ("pace", "event")},
            "psf_px": result.settings.get("psf_sigma_px"),
            "scale": result.scale,
            "method": result.method,
            "frames": picture.window.frame_count,
            "places": picture.shot.plan.frame_count,
        },
        "one_offset_px": picture.shot.offset_px.tolist(),
        "pitch_mm": list(result.grid.pitch_mm),
        "geometry": _geometry(picture),
        "field_assumed": not _looks(picture)[1],
        "residual": residual if residual is not None and math.isfinite(residual) else None,
        "age_s": round(now_s - picture.shot.taken_s, 4),
    }


def _looks(picture: Picture) -> tuple[Intrinsics, bool]:
    """Return where the pixels look, and whether that is known."""
    known = picture.result.intrinsics
    if known is not None:
        return known, True
    return Pinhole.of_field(picture.result.grid, _ASSUMED_FIELD_RAD), False


def _geometry(picture: Picture) -> str:
    """Return what changes whenever the directions of the pixels may have."""
    rows, cols = picture.result.grid.shape
    return f"{rows}x{cols}-{id(picture.shot.plan):x}"


async def _asked(request: Request) -> dict[str, Any]:
    wanted = json.loads(await request.body() or b"{}")
    if not isinstance(wanted, dict):
        raise ValueError("expected a JSON object")
    return wanted


def _json(content: dict[str, Any], status: int = 200) -> Response:
    from starlette.responses import JSONResponse

    return JSONResponse(content, status)


def _refused(_: Request, error: Exception) -> Response:
    return _json({"error": str(error)}, 400)


def make_app(live: Live, token: str, folder: Path) -> ASGIApp:
    """Return the application behind its gate."""
    from starlette.applications import Starlette
    from starlette.routing import Mount, Route, WebSocketRoute
    from starlette.staticfiles import StaticFiles

    pages = Pages(live, folder)
    files = str(resources.files("lensshift.live") / "page")
    routes = [
        WebSocketRoute("/pictures", pages.pictures),
        Route("/begin", pages.begin),
        Route("/directions", pages.directions),
        Route("/control", pages.change, methods=["POST"]),
        Route("/snapshot", pages.snapshot, methods=["POST"]),
        Route("/edge", pages.edge, methods=["POST"]),
        Mount("/", StaticFiles(directory=files, html=True)),
    ]
    refusals = dict.fromkeys(FAILURES, _refused)
    app = Starlette(routes=routes, lifespan=pages.lifespan, exception_handlers=refusals)
    return Gate(app, token)
