"""What the live page costs the loop, and what is left of it after many visits.

    python research/benchmarks/live_page.py --seconds 60 --visits 50

Needs playwright and a Chromium on the path. The loop answers the built-in operator at 100 Hz with
one method (`--method`, sbr if left out), three times: without a page, with one that nobody looks
at, and with a browser that draws in software, on the same cores. Then the page is opened and closed
many times.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import threading
import time
from pathlib import Path

from smooth_operator.compilation.start import build_retargeter
from smooth_operator.planning import make_request, resolve
from smooth_operator.teleop.components import build_source
from smooth_operator.teleop.pages.live.live_page import LivePage, PageSetup
from smooth_operator.teleop.pages.live.live_session import LiveSession
from smooth_operator.teleop.runtime.loop import TeleopLoop
from smooth_operator.teleop.runtime.pipeline import HandPipeline
from smooth_operator.teleop.runtime.priority import low_jitter
from smooth_operator.teleop.runtime.settings import LoopConfig
from smooth_operator.teleop.sinks.runner import SinkRunner

_VISIT = """
import shutil, sys, time
from playwright.sync_api import sync_playwright
url, visits, seconds = sys.argv[1], int(sys.argv[2]), float(sys.argv[3])
path = next(p for n in ("chromium", "chromium-browser", "google-chrome") if (p := shutil.which(n)))
flags = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
with sync_playwright() as driver:
    browser = driver.chromium.launch(executable_path=path, args=flags)
    for _ in range(visits):
        page = browser.new_page(viewport={"width": 800, "height": 600})
        page.goto(url, timeout=120_000)
        page.get_by_text("EMERGENCY STOP").wait_for(timeout=120_000)
        print("in", flush=True)
        time.sleep(seconds)
        page.close()
        print("out", flush=True)
    browser.close()
"""


def figures(pid: int) -> dict[str, float]:
    """Threads and resident memory of a process."""
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    words = dict(line.split(":\t", 1) for line in lines if ":\t" in line)
    return {"threads": int(words["Threads"]), "rss_mb": int(words["VmRSS"].split()[0]) / 1024}


def visitor(url: str, visits: int, seconds: float) -> subprocess.Popen[str]:
    """A browser in a process of its own."""
    command = [sys.executable, "-c", _VISIT, url, str(visits), str(seconds)]
    nice = ["nice", "-n", "10"] if shutil.which("nice") else []
    return subprocess.Popen([*nice, *command], stdout=subprocess.PIPE, text=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--visits", type=int, default=50)
    parser.add_argument("--method", default="sbr")
    options = parser.parse_args()
    request = make_request(method=options.method)
    hand, method = resolve(request, "right")
    retargeter, _ = build_retargeter(hand, method, 0)
    config = LoopConfig(rate=100.0)

    def run(page: LivePage | None, browse: bool) -> None:
        loop = TeleopLoop(
            {"right": HandPipeline(retargeter, config)},
            build_source("synthetic:rate=100"),
            SinkRunner(),
            config,
        )
        session = LiveSession(loop, request)
        loop.watch = session.watch
        guest = None
        if page is not None:
            url = page.serve(session)
            if browse:
                guest = visitor(url, 1, options.seconds + 20)
                assert guest.stdout is not None
                guest.stdout.readline()
        with low_jitter():
            loop.run(options.seconds)
        if guest is not None:
            guest.terminate()
            guest.wait()
        summary = loop.statistics.summary()
        figures = {key: summary[key] for key in ("rate_hz", "deadlines_missed_share")}
        words = "a browser" if browse else "nobody looking" if page else "no page"
        figures["method"] = f"{request.method} {request.preset}"
        print(json.dumps({"page": words, **figures, **summary["added_latency_ms"]}), flush=True)
        session.close()

    run(None, False)
    for browse in (False, True):
        with LivePage(PageSetup("mimic_p050", port=0, details=False)) as page:
            run(page, browse)

    loop = TeleopLoop({"right": HandPipeline(retargeter, config)},
                      build_source("synthetic:rate=100"), SinkRunner(), config)  # fmt: skip
    session = LiveSession(loop, request)
    loop.watch = session.watch
    thread = threading.Thread(target=loop.run)
    thread.start()
    with LivePage(PageSetup("mimic_p050", port=0, details=False)) as page:
        guest = visitor(page.serve(session), options.visits, 1.0)
        assert guest.stdout is not None
        pids = {"page": page._process.pid, "loop": "self"}
        for number, line in enumerate(guest.stdout):
            visit = number // 2 + 1
            if line.strip() == "out" and visit in (1, 2, 5, 10, 20, 30, 40, options.visits):
                time.sleep(0.5)
                print(json.dumps({"visit": visit, **{k: figures(p) for k, p in pids.items()}}))
        guest.wait()
    loop.controls.quit()
    thread.join()


if __name__ == "__main__":
    main()
