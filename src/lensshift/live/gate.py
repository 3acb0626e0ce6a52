"""Who may look and who may move the lens: whoever has the address with the token, and no site."""

from __future__ import annotations

import hmac
import ipaddress
import socket
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

if TYPE_CHECKING:
    from starlette.types import ASGIApp, Message, Receive, Scope, Send

_HEADERS = {
    "Content-Security-Policy": (
        "default-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'; "
        "object-src 'none'"
    ),
    "Referrer-Policy": "no-referrer",  # the address holds the token
    "X-Content-Type-Options": "nosniff",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}


class Gate:
    """Refuses requests of another host or origin, or without the token, before anything else.

    Addresses are `/TOKEN/...`; the application sees the path without the token. The host must be an
    address in numbers or a name of this computer: a page of another site that makes its own name
    point here (DNS rebinding) is refused even if it had the token.
    """

    def __init__(self, inner: ASGIApp, token: str) -> None:
        self._inner, self._token = inner, token.encode()
        self._names = {"localhost", socket.gethostname().lower()}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request or one socket."""
        if scope["type"] == "lifespan":
            await self._inner(scope, receive, send)
            return
        headers = {name.lower(): value.decode("latin-1") for name, value in scope["headers"]}
        _, given, rest = (scope["path"] + "//").split("/", 2)
        same = hmac.compare_digest(given.encode(), self._token)
        if not (same and self._is_ours(headers.get(b"host", ""), headers.get(b"origin"))):
            await _refuse(scope, send)
            return
        path = "/" + rest[:-1].rstrip("/") if rest.rstrip("/") else "/"
        await self._inner({**scope, "path": path, "raw_path": path.encode()}, receive, _safe(send))

    def _is_ours(self, host: str, origin: str | None) -> bool:
        name = urlsplit(f"//{host}").hostname or ""
        try:
            ipaddress.ip_address(name)
        except ValueError:
            if name not in self._names:
                return False
        return origin is None or origin == f"http://{host}"


def _safe(send: Send) -> Send:
    """Return `send` that adds the headers of a page that needs nobody else."""

    async def sent(event: Message) -> None:
        if event["type"] == "http.response.start":
            added = [(name.lower().encode(), value.encode()) for name, value in _HEADERS.items()]
            event["headers"] = [*event.get("headers", []), *added]
        await send(event)

    return sent


async def _refuse(scope: Scope, send: Send) -> None:
    if scope["type"] == "websocket":
        await send({"type": "websocket.close", "code": 1008})
        return
    headers = [(b"content-type", b"text/plain; charset=utf-8")]
    await send({"type": "http.response.start", "status": 403, "headers": headers})
    text = "Not allowed: open the whole address that `lensshift live` printed.\n"
    await send({"type": "http.response.body", "body": text.encode()})
