"""The part of ifm's XML-RPC that a client asks before it opens an O3D or O3R."""

from __future__ import annotations

import json
import threading
from collections.abc import Mapping, Sequence
from typing import Any, Self
from xmlrpc.server import SimpleXMLRPCRequestHandler, SimpleXMLRPCServer

# The second number is the family: an O3D has 1 to 255, an O3R 768 to 1023.
_TYPES = {"O3D": "1:2", "O3R": "1:1000"}
_FIRMWARE = {"O3D": "1.30.4123", "O3R": "1.4.30"}
_MOST_BYTES = 1 << 16  # of a request
_LOOK_S = 0.05  # how soon it notices the end
_REQUEST_S = 2.0  # that a client may take over one


class _Handler(SimpleXMLRPCRequestHandler):
    timeout = _REQUEST_S

    def is_rpc_path_valid(self) -> bool:
        """Answer at every path below the one of ifm."""
        return self.path.startswith("/api/rpc/v1/com.ifm.")

    def do_POST(self) -> None:  # noqa: N802 - its name there
        """Answer, unless the request is longer than any that there is."""
        size = self.headers.get("Content-Length", "")
        if not (size.isdigit() and int(size) <= _MOST_BYTES):
            self.send_error(413)
            return
        super().do_POST()

    def log_message(self, *_: object) -> None:
        """Say nothing."""


class IfmDevice:
    """Answers what clients ask by XML-RPC; a context manager with a thread.

    `getParameter`, `getAllParameters`, `getSWVersion`, `getHWInfo`, and of an O3R `get` and
    `getSchema`. Nothing can be changed.
    """

    def __init__(
        self, model: str, pcic_port: int, *, port: int = 0, host: str = "127.0.0.1"
    ) -> None:
        self._model = model
        self._about = _about(model, pcic_port)
        try:
            self._server = SimpleXMLRPCServer((host, port), _Handler, logRequests=False)
        except OSError as error:
            raise OSError(
                f"cannot listen at {host}:{port} ({error.strerror}); choose another port, or 0 "
                "for any that is free"
            ) from error
        self._server.timeout = _LOOK_S
        self._server.register_instance(self)
        self._thread = threading.Thread(
            target=self._server.serve_forever, args=(_LOOK_S,), daemon=True
        )

    @property
    def port(self) -> int:
        """TCP port to ask at."""
        return int(self._server.server_address[1])

    def _dispatch(self, method: str, arguments: Sequence[Any]) -> Any:
        """Answer a call; what is raised becomes a fault for the client."""
        parameters = {
            "DeviceType": _TYPES[self._model],
            "Name": "lensshift emulator",
            "ArticleNumber": self._model,
        }
        if method == "getParameter" and arguments:
            return parameters[str(arguments[0])]
        answers = {
            "getAllParameters": parameters,
            "getSWVersion": {"IFM_Software": _FIRMWARE[self._model]},
            "getHWInfo": {"MACAddress": "00:00:00:00:00:00"},
        }
        if method in answers:
            return answers[method]
        if self._model == "O3R" and method == "get":
            return json.dumps(_parts(self._about, arguments[0] if arguments else []))
        if self._model == "O3R" and method == "getSchema":
            return json.dumps({"type": "object"})
        raise ValueError(f"no method {method}")

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._server.shutdown()
        self._thread.join()
        self._server.server_close()


def _about(model: str, pcic_port: int) -> dict[str, Any]:
    outputs = ["RADIAL_DISTANCE_COMPRESSED", "AMPLITUDE_COMPRESSED", "CONFIDENCE", "TOF_INFO"]
    port = {
        "state": "RUN",
        "info": {"features": {"type": "3D", "fov": {"horizontal": 13, "vertical": 3}}},
        "data": {"pcicTCPPort": pcic_port, "availablePCICOutput": outputs},
        "mode": "standard_range2m",
    }
    return {
        "device": {
            "status": "OPERATE",
            "swVersion": {"firmware": _FIRMWARE[model], "schema": "v1.0.0"},
            "info": {"name": "lensshift emulator", "partNumber": model},
            "diagnostic": {},
        },
        "ports": {"port0": port},
        "applications": {"instances": {}},
    }


def _parts(content: Mapping[str, Any], pointers: Sequence[str]) -> dict[str, Any]:
    """Return what JSON pointers lead to, within its objects; everything for none or ""."""
    found: dict[str, Any] = {}
    for pointer in pointers or [""]:
        keys, inside, here = [one for one in str(pointer).split("/") if one], content, found
        if not keys:
            return dict(content)
        for key in keys[:-1]:
            inside, here = inside[key], here.setdefault(key, {})
        here[keys[-1]] = inside[keys[-1]]
    return found
