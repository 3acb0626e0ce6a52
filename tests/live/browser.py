"""A headless Chromium, driven by its DevTools protocol."""

import base64
import itertools
import json
import re
import shutil
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

NAMES = ("chromium", "chromium-browser", "google-chrome")
FLAGS = (
    "--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--remote-debugging-port=0",
    "--no-first-run", "--disable-background-networking", "--disable-component-update",
    "--disable-gpu", "--enable-unsafe-swiftshader", "--mute-audio",
)  # fmt: skip


class Page:
    """One tab. `problems` are errors of the page, `requests` the addresses that it asked for."""

    def __init__(self, socket: Any) -> None:
        self._socket = socket
        self._numbers = itertools.count(1)
        self.problems: list[str] = []
        self.requests: list[str] = []

    def call(self, method: str, **params: Any) -> dict[str, Any]:
        number = self.send(method, **params)
        while True:
            said = json.loads(self._socket.recv(timeout=60))
            if said.get("id") == number:
                assert "error" not in said, said
                return dict(said["result"])
            self._note(said)

    def send(self, method: str, **params: Any) -> int:
        """Send a command without waiting for its result."""
        number = next(self._numbers)
        self._socket.send(json.dumps({"id": number, "method": method, "params": params}))
        return number

    def _note(self, said: dict[str, Any]) -> None:
        said = {"method": "", "params": {}} | said
        about = said["params"]
        if said["method"] == "Network.requestWillBeSent":
            self.requests.append(about["request"]["url"])
        elif said["method"] == "Network.webSocketCreated":
            self.requests.append(about["url"])
        elif said["method"] == "Runtime.exceptionThrown":
            self.problems.append(json.dumps(about["exceptionDetails"])[:500])
        elif said["method"] == "Log.entryAdded" and about["entry"]["level"] == "error":
            self.problems.append(json.dumps(about["entry"])[:500])
        elif said["method"] == "Runtime.consoleAPICalled" and about["type"] == "error":
            self.problems.append(json.dumps(about["args"])[:500])

    def value(self, expression: str) -> Any:
        found = self.call(
            "Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True
        )
        assert "exceptionDetails" not in found, found
        return found["result"].get("value")

    def until(self, expression: str, seconds: float = 60.0) -> Any:
        end_s = time.monotonic() + seconds
        while time.monotonic() < end_s:
            found = self.value(expression)
            if found:
                return found
            time.sleep(0.03)
        raise AssertionError(f"not within {seconds:g} s: {expression}; {self.problems}")

    def size(self, width: int, height: int, scale: float = 1.0) -> None:
        self.call(
            "Emulation.setDeviceMetricsOverride",
            width=width, height=height, deviceScaleFactor=scale, mobile=width < 500,
        )  # fmt: skip

    def dark(self, dark: bool) -> None:
        value = "dark" if dark else "light"
        feature = {"name": "prefers-color-scheme", "value": value}
        self.call("Emulation.setEmulatedMedia", features=[feature])

    def mouse(self, kind: str, x: float, y: float) -> None:
        buttons = 0 if kind == "mouseReleased" else 1
        self.call(
            "Input.dispatchMouseEvent",
            type=kind, x=x, y=y, button="left", buttons=buttons, clickCount=1,
        )  # fmt: skip

    def shot(self, path: Path, *, whole: bool = False) -> None:
        data = self.call("Page.captureScreenshot", format="png", captureBeyondViewport=whole)
        path.write_bytes(base64.b64decode(data["data"]))


@contextmanager
def browser(folder: Path) -> Iterator[Page]:
    """Start Chromium and yield its page; skip the test where there is none."""
    program = next((found for name in NAMES if (found := shutil.which(name))), None)
    if program is None:
        pytest.skip(f"no browser: none of {', '.join(NAMES)} is installed")
    client = pytest.importorskip("websockets.sync.client")
    command = [program, *FLAGS, f"--user-data-dir={folder}", "about:blank"]
    with (folder / "chromium.log").open("w+b") as log:
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=log)
        try:
            with client.connect(_tab(folder), max_size=None, ping_interval=None) as socket:
                page = Page(socket)
                for domain in ("Page", "Runtime", "Network", "Log"):
                    page.call(f"{domain}.enable")
                yield page
        finally:
            process.terminate()
            process.wait(20)


def _tab(folder: Path) -> str:
    """Return the address of the socket of the first tab."""
    import urllib.request

    end_s = time.monotonic() + 60
    while time.monotonic() < end_s:
        found = re.search(r"ws://([\d.:]+)/", (folder / "chromium.log").read_text(errors="replace"))
        if found:
            with urllib.request.urlopen(f"http://{found[1]}/json", timeout=10) as answer:
                tabs = [one for one in json.load(answer) if one["type"] == "page"]
            if tabs:
                return str(tabs[0]["webSocketDebuggerUrl"])
        time.sleep(0.03)
    raise AssertionError("Chromium did not start")
