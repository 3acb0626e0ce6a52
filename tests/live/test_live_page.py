"""The page in a browser: pictures are shown, nobody else is asked, a stopped tab slows nothing."""

import json
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
import pytest
from browser import Page, browser
from serving import SQUARE_PX, served, source_of, until

from lensshift import Burst
from lensshift.live.picture import Settings

pytestmark = pytest.mark.filterwarnings("ignore::lensshift.QualityWarning")
SIZES = ((390, 844), (1440, 900), (3840, 2160))


@contextmanager
def emulated(folder: Path) -> Iterator[str]:
    """Run `lensshift live --rig emulated` in a process of its own, and yield the address."""
    code = "from lensshift.cli import main; main()"
    words = ["live", "--rig", "emulated", "--no-open", "--port", "0", "--json", "--out"]
    process = subprocess.Popen(
        [sys.executable, "-c", code, *words, str(folder)], stdout=subprocess.PIPE
    )
    assert process.stdout is not None
    try:
        yield json.loads(process.stdout.readline())["address"]
    finally:
        process.terminate()
        process.communicate(timeout=60)


@pytest.fixture(scope="module")
def chromium(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    with browser(tmp_path_factory.mktemp("chromium")) as page:
        yield page


@pytest.fixture
def page(chromium: Page) -> Iterator[Page]:
    """One browser serves all tests; each finds its tab empty and hears of its own page alone."""
    chromium.call("Network.enable")  # which `rates` ends
    chromium.problems.clear()
    chromium.requests.clear()
    yield chromium
    chromium.call("Page.navigate", url="about:blank")  # asks the ending server for nothing more
    chromium.dark(False)


def opened(page: Page, address: str, pictures: int = 10) -> None:
    page.size(1000, 700)
    page.call("Page.navigate", url=address)
    page.until(f"globalThis.lensshift && lensshift.shown > {pictures}", 120)


def rates(page: Page, seconds: float) -> tuple[float, float]:
    """Return pictures shown per second, and the median of their ages in seconds."""
    page.call("Network.disable")  # it tells of every picture that a socket brings
    shown, begin_s = page.value("lensshift.shown"), time.monotonic()
    time.sleep(seconds)
    count = page.value("lensshift.shown") - shown
    ages = page.value("lensshift.ages")[-count:] if count else [float("inf")]
    return count / (time.monotonic() - begin_s), median(ages)


def is_clean(page: Page, address: str) -> None:
    """Check that the page had no error and asked nobody else for anything."""
    assert page.problems == []
    assert page.value("lensshift.failures") == []
    host = address.split("/")[2]
    assert {url.split("/")[2] for url in page.requests if "://" in url} == {host}


def test_an_emulated_rig_is_shown(page: Page, tmp_path: Path) -> None:
    with emulated(tmp_path) as address:
        opened(page, address, 10)
        per_s, age_s = rates(page, 1.0)
        print(f"{per_s:.1f} pictures shown per second, {1e3 * age_s:.0f} ms old (median)")  # noqa: T201
        assert per_s > 1
        assert page.value("lensshift.points") == 128 * 32
        assert "pixels" in page.value("document.getElementById('cloud-note').textContent")
        is_clean(page, address)


@pytest.mark.slow
def test_an_emulated_rig_is_shown_fast_and_does_not_grow(page: Page, tmp_path: Path) -> None:
    with emulated(tmp_path) as address:
        opened(page, address, 60)
        page.call("HeapProfiler.collectGarbage")
        before = page.value("performance.memory.usedJSHeapSize")
        per_s, age_s = rates(page, 60.0)
        page.call("HeapProfiler.collectGarbage")
        grown = page.value("performance.memory.usedJSHeapSize") - before
        print(f"{per_s:.1f} shown per second, {1e3 * age_s:.0f} ms, heap grew by {grown} bytes")  # noqa: T201
        assert per_s >= 20
        assert age_s <= 0.15
        assert grown < 5e6


def test_a_stopped_tab_slows_no_frame(page: Page, burst: Burst, tmp_path: Path) -> None:
    with served(source_of(burst, 50.0), tmp_path) as (address, live):
        opened(page, address)
        page.call("Debugger.enable")
        page.call("Debugger.pause")
        page.send("Runtime.evaluate", expression="1")  # where it stops
        time.sleep(0.2)
        frames, begin_s = live.frame_count, time.monotonic()
        until(lambda: live.frame_count >= frames + 50)
        per_s = 50 / (time.monotonic() - begin_s)
        assert per_s > 25  # of 50
        page.call("Debugger.disable")
        shown = page.value("lensshift.shown")
        page.until(f"lensshift.shown > {shown + 3}")


def test_controls_and_an_edge(page: Page, burst: Burst, tmp_path: Path) -> None:
    with served(source_of(burst), tmp_path) as (address, live):
        opened(page, address)
        page.value("document.getElementById('stage').focus()")
        for kind in ("rawKeyDown", "keyUp"):
            page.call("Input.dispatchKeyEvent", type=kind, key="b")
            page.call("Input.dispatchKeyEvent", type=kind, key="ArrowRight")
        assert page.value("document.getElementById('stage').getAttribute('aria-valuenow')") == "52"
        assert not page.value("document.getElementById('box').hidden")
        page.until(
            "document.getElementById('mtf-note').textContent.includes('super-resolved:')", 90
        )
        choose(page, "scale", "3")
        until(lambda: live.settings == Settings(3, "bicubic"))
        page.until("document.getElementById('fine').width === 48")
        assert page.value("document.getElementById('box').hidden")
        page.value("document.querySelector('[data-layer=distance]').click()")
        page.until("document.getElementById('low').textContent.endsWith(' m')")
        choose(page, "pattern", "3x3")
        page.until("document.getElementById('said').textContent.includes('has its own plan')")
        refused = [one for one in page.problems if "400" not in one]  # as Chromium logs a 400
        assert refused == []


def choose(page: Page, name: str, value: str) -> None:
    field = f"document.getElementById('{name}')"
    page.value(f"{field}.value = '{value}'; {field}.dispatchEvent(new Event('change')); 0")


def test_it_fits_on_a_phone_and_on_a_wall(page: Page, burst: Burst, tmp_path: Path) -> None:
    with served(source_of(burst), tmp_path) as (address, _):
        opened(page, address)
        for dark in (False, True):
            page.dark(dark)
            colour: Any = "getComputedStyle(document.body).backgroundColor.match(/\\d+/)[0]"
            page.until(f"{colour} < 60" if dark else f"{colour} > 200")
        for width, height in SIZES:
            page.size(width, height)
            page.until(f"innerWidth === {width}")
            assert page.value("document.documentElement.scrollWidth") <= width
            boxes = "[...document.querySelectorAll('section')].map(one => one.clientHeight)"
            assert min(page.value(boxes)) > 150


def test_a_picture_twice_as_wide_as_high_fills_its_panel(page: Page, tmp_path: Path) -> None:
    """A third of the height was empty on a wall, a quarter on a desk."""
    rows, cols = np.indices((12, 24))
    light = np.stack([0.5 + 0.3 * np.tanh(cols - 11.3 - 0.2 * rows - col) for _, col in SQUARE_PX])
    burst = Burst.from_arrays(light, offset_px=SQUARE_PX, pitch_mm=0.1)
    with served(source_of(burst), tmp_path) as (address, _):
        opened(page, address)
        for width, height in ((1400, 900), (3840, 2160)):
            page.size(width, height)
            page.until(f"innerWidth === {width} && lensshift.shown > 3")
            shown = page.value("lensshift.shown")
            page.until(f"lensshift.shown > {shown + 3}")
            empty = page.value(
                "(p => 1 - [...p.children].reduce((sum, one) => sum + one.offsetHeight, 0)"
                " / p.offsetHeight)(document.getElementById('picture'))"
            )
            assert empty < 0.2
            wide = page.value("document.getElementById('stage').offsetWidth")
            assert wide > 0.5 * width
