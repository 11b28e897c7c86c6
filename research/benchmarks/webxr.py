"""From a headset's browser to both robot hands: rate, and where each millisecond goes.

    python research/benchmarks/webxr.py --seconds 30

The source ``webxr`` serves its page to a headless Chromium on the same machine, in which Meta's
Immersive Web Emulation Runtime (from the npm registry) plays a headset with two moving hands. Each
frame is retargeted to a left and a right robot hand. Browser, software rendering and retargeting
share the machine's cores here; with a real headset the first two are on the headset.
"""

from __future__ import annotations

import contextlib
import shutil
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from timing import percentiles

from smooth_operator import Retargeter, Status
from smooth_operator.teleop.sources.live import Mailbox
from smooth_operator.teleop.sources.webxr import WebXr
from smooth_operator.types import Side
from smooth_operator_research.run_report import (
    RESULTS,
    BenchmarkError,
    Report,
    ReportSettings,
    run_program,
)

sys.path.append(str(Path(__file__).resolve().parents[2] / "tests"))
from emulated_headset import NoEmulator, fetch_emulator, new_headset

SIDES: tuple[Side, ...] = ("left", "right")
BROWSERS = ("chromium", "chromium-browser", "google-chrome")
FLAGS = (
    "--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
)  # fmt: skip


@dataclass(frozen=True)
class Settings(ReportSettings):
    """What to run.

    Attributes:
        seconds: how long to measure [s].
        hand: robot hand.
        method: retargeting method.
        preset: its preset.
        width: of the emulated headset's view [px]; more pixels are more software rendering.
        height: of the same [px].
    """

    seconds: float = 20.0
    hand: str = "mimic_p050"
    method: str = "sbr"
    preset: str = "realtime"
    width: int = 480
    height: int = 640


def main(settings: Settings) -> None:
    report = Report("webxr", vars(settings))
    retargeters = {
        side: Retargeter(settings.hand, method=settings.method, side=side, preset=settings.preset)
        for side in SIDES
    }
    for retargeter in retargeters.values():
        retargeter.warm_up()
    mailbox = Mailbox()
    source = WebXr(port=0)
    source.start(mailbox)
    try:
        with _headset(settings) as page:
            page.goto(f"{source.addresses[0]}/#{source.pairing_code}")
            page.get_by_text("linked", exact=True).wait_for()
            page.click("#start")
            _measure(settings, report, mailbox, source, retargeters)
    finally:
        source.stop()
    report.finish(settings.output, settings.compare)


def _measure(
    settings: Settings,
    report: Report,
    mailbox: Mailbox,
    source: WebXr,
    retargeters: dict[Side, Retargeter],
) -> None:
    time.sleep(12.0)  # the page's estimate of the clocks looks back ten seconds
    times: dict[Side, list[tuple[float, float, float]]] = {side: [] for side in SIDES}
    good = 0
    for side in SIDES:
        mailbox.take(side)
    skipped, received, overwritten = source.link.skipped, mailbox.received, mailbox.overwritten
    begin = time.perf_counter()
    while (now := time.perf_counter()) < begin + settings.seconds:
        mailbox.wait(SIDES, 0.1)
        for side in SIDES:
            if (arrival := mailbox.take(side)) is not None:
                result = retargeters[side](arrival.frame)
                stamp = arrival.frame.stamp + source.link.clock_offset_s
                times[side].append((stamp, arrival.received, time.perf_counter()))
                good += result.status is Status.OK
    span = now - begin
    received, overwritten = mailbox.received - received, mailbox.overwritten - overwritten
    skipped = source.link.skipped - skipped
    commands = sum(map(len, times.values()))
    if not commands:
        raise BenchmarkError("no hand came from the emulated headset")
    rates = {side: len(times[side]) / span for side in SIDES}
    worst = {side: _slowest_second(np.array(times[side])[:, 2]) for side in SIDES}
    for side in SIDES:
        report.add(side, {"commands_hz": rates[side], "slowest_second_hz": worst[side]})
    report.add(
        "counts",
        {
            "received_hz": received / span,
            "overwritten_share": overwritten / max(received, 1),
            "skipped": skipped,
            "good_share": good / commands,
            "round_trip_ms": 1e3 * source.link.round_trip_s,
        },
    )
    report.table(
        f"Commands over {span:.0f} s",
        ("hand", "commands [Hz]", "in the slowest second [Hz]"),
        [[side, rates[side], worst[side]] for side in SIDES],
    )
    all_times = np.concatenate([np.array(times[side]) for side in SIDES])
    rows = []
    for name, (start, end) in {
        "headset to host": (0, 1),
        "host: received to command": (1, 2),
        "headset to command": (0, 2),
    }.items():
        figures = percentiles(1e3 * (all_times[:, end] - all_times[:, start]))
        report.add(name, figures)
        rows.append([name, *figures.values()])
    report.table("Latency [ms]", ("stage", "p50", "p95", "p99", "max"), rows)
    report.notes.append(
        f"{100 * good / commands:.1f} % of the commands answer their frame; the mailbox replaced "
        f"{overwritten} of {received} frames by newer ones; the page skipped {skipped} moments."
    )
    report.notes.append(
        "Headset to host is by the page's estimate of the offset between the clocks, exact to half "
        f"the fastest round trip; the last one took {1e3 * source.link.round_trip_s:.1f} ms."
    )


def _slowest_second(times: np.ndarray) -> float:
    """Fewest commands in any whole second of the run [Hz]."""
    seconds = np.floor(times - times[0]).astype(int)
    whole = np.bincount(seconds)[:-1]
    return float(whole.min()) if len(whole) else float("nan")


@contextlib.contextmanager
def _headset(settings: Settings) -> Iterator[Any]:
    """The emulated headset's page, in a browser of its own."""
    try:
        from playwright.sync_api import sync_playwright
    except ImportError as error:
        raise BenchmarkError("this needs playwright: python -m pip install playwright") from error
    path = next((program for name in BROWSERS if (program := shutil.which(name))), None)
    if path is None:
        raise BenchmarkError(f"no browser: none of {', '.join(BROWSERS)} is on the path")
    RESULTS.mkdir(parents=True, exist_ok=True)
    try:
        emulator = fetch_emulator(RESULTS)
    except NoEmulator as error:
        raise BenchmarkError(str(error)) from error
    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=path, headless=True, args=FLAGS)
        yield new_headset(browser, emulator, settings.width, settings.height)
        browser.close()


if __name__ == "__main__":
    run_program(main, Settings, __doc__)
