"""An O3M at 50 Hz for a minute over loopback: frames lost, CPU time of the receiver.

pytest benchmarks/bench_camera.py            LENSSHIFT_SECONDS=10 for a shorter run

The emulator runs in a process of its own, so that only the receiver is counted. Its CPU time is
also given in runs of a reference loop, a million additions in Python, because seconds of a slow or
shared machine say little: a core that does 20 such runs a second needs 1/20 s for one. A frame
counts with the lower quartile of all frames and the loop with the least of five, for what others on
the machine add is not theirs.
"""

import os
import subprocess
import sys
import time

import numpy as np

from lensshift.capture.drivers.o3m import O3MCamera
from lensshift.capture.emulators.o3m import O3MSender
from lensshift.core.types import Frame

RATE_HZ = 50.0
SECONDS = float(os.environ.get("LENSSHIFT_SECONDS", "60"))
CPU_LIMIT = 0.15  # of one core
CORE_LOOPS_HZ = 20.0  # reference loops a second of an ordinary core


def send(port: int) -> None:
    """Send until standard input closes, then print what was sent."""
    rng = np.random.default_rng(0)
    shape = (16, 64)
    frame = Frame(rng.random(shape), rng.uniform(1, 9, shape), np.ones(shape, dtype=bool), 0.0)
    with O3MSender(lambda begin_s, end_s: frame, port=port, rate_hz=RATE_HZ) as sender:
        sys.stdin.read()
    print(sender.sent, sender.frames_dropped)


def loop_s() -> float:
    """Return the least CPU time of a million additions in five tries."""
    taken_s = []
    for _ in range(5):
        start_s = time.thread_time()
        total = 0
        for number in range(1_000_000):
            total += number
        taken_s.append(time.thread_time() - start_s)
    return min(taken_s)


def test_receiving(report: list[str]) -> None:
    camera = O3MCamera(0, host="127.0.0.1")
    camera.open()
    command = [sys.executable, __file__, str(camera.port)]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as emulator:
        camera.next_frame(60.0)
        per_frame_s = []
        cpu_s, start_s = time.process_time(), time.monotonic()
        while time.monotonic() < start_s + SECONDS:
            before_s = time.process_time()
            camera.next_frame(10.0)
            per_frame_s.append(time.process_time() - before_s)
        cpu_s, took_s = time.process_time() - cpu_s, time.monotonic() - start_s
        told, _ = emulator.communicate()
    sent, missed = (int(number) for number in told.split())
    time.sleep(0.5)  # for what is still under way
    counts = camera.counts()
    camera.close()
    reference_s = loop_s()
    frame_s = float(np.percentile(per_frame_s, 25))
    share = frame_s / reference_s * RATE_HZ / CORE_LOOPS_HZ
    report.append(f"{sent} frames sent in {took_s:.0f} s, {missed} not, the emulator was late")
    report.append(f"{sent - counts['frames']} lost; {dict(counts)}")
    report.append(f"{100 * cpu_s / took_s:.1f} % of a core here and now")
    report.append(f"{1e3 * frame_s:.2f} ms a frame, reference loop {1e3 * reference_s:.0f} ms")
    report.append(
        f"{100 * share:.1f} % of a core that does {CORE_LOOPS_HZ:.0f} loops a second, at 50 Hz"
    )
    assert counts["frames"] == sent
    assert share < CPU_LIMIT


if __name__ == "__main__":
    send(int(sys.argv[1]))
