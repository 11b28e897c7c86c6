"""Delay of feedback: from contact of a simulated hand to a glove's program, and to a controller.

``teleoperate`` runs with the synthetic operator, or with an emulated headset in Chromium
(``--gamepad``), a simulated hand and an output of feedback. A contact may begin at any time, so the
delay is that of each millisecond of the run, until the first message arrives whose measurement is
not older: waits for the physics, for the loop and for the message's turn are included.
"""

from __future__ import annotations

import argparse
import itertools
import json
import runpy
import shutil
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import zmq

from smooth_operator.teleop import TeleopRequest, teleoperate
from smooth_operator.teleop.runtime.statistics import percentiles
from smooth_operator.teleop.sinks.feedback import PULSE_S, Output, WebXrFeedback
from smooth_operator.teleop.sources.webxr import WebXr
from smooth_operator_research.run_report import Report

TESTS = Path(__file__).resolve().parents[2] / "tests"
ADDRESS = "tcp://127.0.0.1:5559"
CODE = "246810"
CODING_MS = 1e-6
"""Length that the number of a pulse adds to it [ms]."""


def event_delays(pairs: list[tuple[float, float]]) -> np.ndarray:
    """Delay of an event in each millisecond [ms].

    Args:
        pairs: measurement and arrival of each message by one clock [s]; in order.
    """
    delays = [
        1e3 * (arrival - np.arange(before, measured, 1e-3)[1:])
        for (before, _), (measured, arrival) in itertools.pairwise(pairs)
        if measured - before < 0.2  # else nothing may be felt in between
    ]
    return np.concatenate(delays)


def to_glove(seconds: float) -> np.ndarray:
    """Delays until a subscriber in a thread has parsed the message [ms]."""
    pairs: list[tuple[float, float]] = []
    done = threading.Event()

    def receive() -> None:
        with zmq.Context() as context, context.socket(zmq.SUB) as glove:
            glove.connect(ADDRESS)
            glove.subscribe(b"")
            while not done.is_set():
                if glove.poll(100):
                    message = json.loads(glove.recv())
                    if message["age_s"] is not None:
                        pairs.append((message["unix_time"] - message["age_s"], time.time()))

    thread = threading.Thread(target=receive)
    thread.start()
    try:
        teleoperate(
            TeleopRequest(
                sink=("mujoco",), feedback=(f"zmq:{ADDRESS}",), duration=seconds, priority="high"
            )
        )
    finally:
        done.set()
        thread.join()
    return event_delays(pairs)


@dataclass(frozen=True)
class NumberedPulses(WebXrFeedback):
    """Pulses for every message, with its number in their length."""

    def output(self) -> Output:
        def send(message: dict[str, Any]) -> None:
            number, strength = message["number"], max(message["levels"])
            if message["age_s"] is not None:
                STAMPS[number] = time.perf_counter() - message["age_s"]
                headset = self._headset
                assert headset is not None
                headset.pulse(message["side"], strength, PULSE_S + 1e-3 * CODING_MS * number)

        return send, lambda: None


STAMPS: dict[int, float] = {}
"""Number of a message -> time of its measurement [s]."""

LISTEN = """() => {
  window.pulses = [];
  for (const name of ['drawArrays', 'texImage2D']) {  // a headset draws on its own GPU
    WebGL2RenderingContext.prototype[name] = () => {};
  }
  const ask = navigator.xr.requestSession.bind(navigator.xr);
  navigator.xr.requestSession = async (mode, options) => {
    const session = await ask(mode, options);
    const beside = Object.values(headset.controllers).map((each) => each.inputSource);
    for (const { gamepad } of beside) {
      gamepad.hapticActuators[0].pulse = async (strength, length) => {
        window.pulses.push([length, performance.now() / 1000]);
      };
    }
    Object.defineProperty(session, 'trackedSources', { value: beside });
    return session;
  };
}"""


def to_gamepad(seconds: float) -> np.ndarray:
    """Delays until the page calls the actuator of the emulated controller [ms]."""
    from playwright.sync_api import sync_playwright

    headsets = runpy.run_path(str(TESTS / "emulated_headset.py"))
    cache = TESTS.parent / ".pytest_cache" / "d" / "iwer"
    cache.mkdir(parents=True, exist_ok=True)
    emulator = headsets["fetch_emulator"](cache)
    source, pulses, loops = WebXr(port=0, code=CODE), NumberedPulses(), []
    pulses.use_source(source)
    request = TeleopRequest(sink=("mujoco",), priority="high")
    settings = {"source": source, "sinks": [pulses], "started": loops.append}
    run = threading.Thread(target=teleoperate, args=(request,), kwargs=settings)
    run.start()
    names = ("chromium", "chromium-browser", "google-chrome")
    path = next(found for name in names if (found := shutil.which(name)))
    flags = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader"]
    with sync_playwright() as driver:
        browser = driver.chromium.launch(
            executable_path=path, args=[*flags, "--enable-unsafe-swiftshader"]
        )
        while not loops and run.is_alive():
            time.sleep(0.1)
        page = headsets["new_headset"](browser, emulator, 240, 320)
        page.goto(f"{source.addresses[0]}/#{CODE}")
        page.locator("#state", has_text="linked").wait_for()
        page.evaluate(LISTEN)
        page.click("#start")
        page.wait_for_timeout(1e3 * seconds)
        offset, felt = source.link.clock_offset_s, page.evaluate("pulses")
        loops[0].controls.quit()
        run.join()
        browser.close()
    return event_delays(
        [(STAMPS[round((length - 1e3 * PULSE_S) / CODING_MS)], at + offset) for length, at in felt]
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--gamepad", action="store_true", help="the controller, not the glove")
    parser.add_argument("--output", type=Path)
    parser.add_argument("--compare", type=Path)
    options = parser.parse_args()
    name = "emulated gamepad" if options.gamepad else "glove message"
    report = Report("feedback-gamepad" if options.gamepad else "feedback", vars(options))
    delays = percentiles((to_gamepad if options.gamepad else to_glove)(options.seconds))
    columns = ("p50", "p95", "p99", "max")
    report.table("Delay", ("[ms]", *columns), [[name, *(delays.get(k) for k in columns)]])
    report.add("delay_ms", delays)
    report.finish(options.output, options.compare)


if __name__ == "__main__":
    main()
