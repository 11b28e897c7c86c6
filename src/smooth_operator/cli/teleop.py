"""``smooth-operator teleop``: from a live source to sinks, until told to end."""

from __future__ import annotations

import atexit
import contextlib
import gc
import json
import signal
import sys
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from types import FrameType
from typing import TYPE_CHECKING, Any, Final

from smooth_operator.cli.console import Progressing
from smooth_operator.cli.session import say_notes
from smooth_operator.cli.teleop_checks import checked
from smooth_operator.cli.teleop_keys import keyboard
from smooth_operator.cli.teleop_options import Teleop
from smooth_operator.cli.teleop_page import begun_page, show_page
from smooth_operator.cli.teleop_task import TaskTrials, with_task
from smooth_operator.hands.hand import Hand
from smooth_operator.io import to_json
from smooth_operator.methods.building import build_retargeter
from smooth_operator.methods.method import MethodConfig
from smooth_operator.methods.retargeter import Retargeter
from smooth_operator.planning import RetargetRequest, live_configuration, make_request
from smooth_operator.teleop.control.orders import Orders
from smooth_operator.teleop.control.workshop import Workshop
from smooth_operator.teleop.runtime.controls import Controls
from smooth_operator.teleop.runtime.loop import TeleopLoop
from smooth_operator.teleop.runtime.pipeline import HandPipeline
from smooth_operator.teleop.runtime.priority import going_first
from smooth_operator.teleop.runtime.settings import LoopConfig
from smooth_operator.teleop.sinks.registry import build_sink
from smooth_operator.teleop.sinks.runner import SinkRunner
from smooth_operator.teleop.sinks.sink import Sink
from smooth_operator.teleop.sinks.tick import Driver
from smooth_operator.teleop.sources.live import LiveSource
from smooth_operator.teleop.sources.registry import build_source
from smooth_operator.types import Side

if TYPE_CHECKING:
    from smooth_operator.teleop.pages.live.page import LivePage

_ANNOUNCE_S: Final = 5.0
"""How long a source may take to say how it is reached [s]."""
_SWITCH_S: Final = 5e-4
"""How long another thread may keep the interpreter before the loop gets it [s]."""


def teleop(options: Teleop) -> None:
    """Builds source, hands and sinks, and runs the loop.

    Raises:
        SmoothOperatorError: something can't be opened; nothing has moved then.
        SystemExit: 1, a sink failed on the way.
        KeyboardInterrupt: Ctrl-C; everything is closed and what it came to is printed.
    """
    config = LoopConfig(options.rate, options.safety, options.limits)
    source = build_source(options.source, options.side)
    acting = [build_sink(text) for text in with_task(options.sink, options.task)]
    asked = make_request(
        hand=options.hand,
        method=options.method,
        preset=options.preset,
        seed=options.seed,
        scale=options.scale,
        fingers=options.fingers,
        operator=options.operator,
    )
    sides: tuple[Side, ...] = ("right", "left") if options.side == "both" else (options.side,)
    sinks = SinkRunner(acting)
    settled = checked(options, asked, config, sides, source, sinks)
    with begun_page(options, asked, sides, acting) as page:
        _drive(options, asked, config, settled, source, acting, sinks, page)


def _drive(
    options: Teleop,
    asked: RetargetRequest,
    config: LoopConfig,
    settled: Mapping[Side, tuple[Hand, MethodConfig]],
    source: LiveSource,
    acting: Sequence[Sink],
    sinks: SinkRunner,
    page: LivePage | None,
) -> None:
    """Compiles, and runs the loop until told to end."""
    progress = Progressing(options.quiet)
    retargeters: dict[Side, Retargeter] = {}
    for side, (hand, method) in settled.items():
        if not options.blind:
            say_notes(method, hand, progress)
        what = "the method" if options.blind else asked.method
        with progress.waiting(f"compiling {what} for {hand.name} {side}"):
            retargeters[side], _ = build_retargeter(hand, method, options.seed)
    pipelines = {
        side: HandPipeline(built, config, driver=Driver(asked.method, asked.preset, built.config))
        for side, built in retargeters.items()
    }
    loop = TeleopLoop(pipelines, source, sinks, config)
    workshop = Workshop(loop, asked)
    show_page(page, loop, asked, acting, workshop, options, progress)
    configuration = live_configuration(
        "teleop",
        asked,
        {side: built.config for side, built in retargeters.items()},
        source=source,
        sinks=with_task(options.sink, options.task),
        loop=config,
    )

    def note(side: Side, text: str) -> None:
        loop.controls.change(lambda hand: hand.note(text) if hand.side == side else None)

    trials = TaskTrials(options, acting, tuple(settled), progress, lambda: workshop.used, note)
    orders = Orders(loop, workshop, lambda: trials.desk, blind=options.blind)
    facts = {"priority": "normal"}
    started = time.perf_counter()
    where = ", ".join(sink.label for sink in sinks.health()) or "no sink"
    progress.note(f"from {source.label} to {where}")
    with (
        contextlib.closing(workshop),
        _attentive(),
        _interrupts(loop.controls) as interrupted,
        keyboard(loop, progress, trials.keys, trials.words),
        _remote(loop, options.control, orders, progress),
        contextlib.ExitStack() as first,
    ):

        def opened() -> None:
            if options.priority == "high":
                facts["priority"] = first.enter_context(going_first())
            _announce(source, progress)
            trials.begin()

        loop.run(options.duration, configuration, started=opened)
    seconds = time.perf_counter() - started
    trials.end()
    _report(options, loop, seconds, progress, facts | trials.summary())
    if interrupted.is_set():
        raise KeyboardInterrupt
    if any(sink.failed for sink in sinks.report()):
        raise SystemExit(1)


def _announce(source: LiveSource, progress: Progressing) -> None:
    """What the operator has to do before frames come: where to connect, with which code."""

    def tell() -> None:
        end = time.monotonic() + _ANNOUNCE_S
        while not (health := source.health()).detail and time.monotonic() < end:
            time.sleep(0.1)
        if health.detail:
            progress.note(f"{source.label}: {health.detail}", matters=health.state != "running")

    threading.Thread(target=tell, daemon=True).start()


def _report(
    options: Teleop,
    loop: TeleopLoop,
    seconds: float,
    progress: Progressing,
    more: dict[str, Any],
) -> None:
    """What the run came to."""
    summary: dict[str, Any] = {
        "duration_s": seconds,
        **loop.statistics.summary(),
        "frames_received": loop.mailbox.received,
        "frames_overwritten": loop.mailbox.overwritten,
        "frames_refused": {
            side: pipeline.supervisor.refused for side, pipeline in loop.pipelines.items()
        },
        "source": loop.source.health(),
        "sinks": loop.sinks.report(),
        **more,
    }
    if options.json:
        print(json.dumps(json.loads(to_json(summary))))
    for sink in loop.sinks.report():
        if sink.failed:
            progress.note(f"{sink.label}: failed {sink.failed} times: {sink.detail}", matters=True)
    health = loop.source.health()
    if health.state == "failed":
        progress.note(f"{loop.source.label}: {health.detail}", matters=True)
    for side, reasons in summary["frames_refused"].items():
        if reasons:
            progress.note(f"{side}: frames refused: {_counted(reasons)}", matters=True)
    if summary["frames_unusable"]:
        why = _counted(summary["frames_unusable_by_reason"])
        progress.note(f"frames of no use: {why}", matters=True)
    added = summary["added_latency_ms"]
    if added:
        progress.note(
            f"{summary['frames_answered']} frames in {seconds:.1f} s, commands at "
            f"{summary['rate_hz']:.0f} Hz; received to sent p50 {added['p50']:.2f} ms, "
            f"p99 {added['p99']:.2f} ms; {100 * summary['deadlines_missed_share']:.2f} % late"
        )
    else:
        progress.note(
            f"no frame came from {loop.source.label} in {seconds:.1f} s; {health.detail}",
            matters=True,
        )


def _counted(reasons: Mapping[str, int]) -> str:
    """Reasons with their counts, the most frequent first."""
    ranked = sorted(reasons.items(), key=lambda item: -item[1])
    return "; ".join(f"{count} x {reason}" for reason, count in ranked)


@contextlib.contextmanager
def _attentive() -> Iterator[None]:
    """The loop before all else: short turns for other threads, no collection of old garbage."""
    # nor at the end of the process, when it would delay the end by seconds after Ctrl-C
    atexit.register(gc.freeze)
    turn = sys.getswitchinterval()
    sys.setswitchinterval(_SWITCH_S)
    gc.collect()
    gc.freeze()  # a compiled model is a great many objects, which a collection would walk through
    try:
        yield
    finally:
        gc.unfreeze()
        sys.setswitchinterval(turn)


@contextlib.contextmanager
def _interrupts(controls: Controls) -> Iterator[threading.Event]:
    """Ctrl-C and SIGTERM end the loop in good order."""
    came = threading.Event()

    def end(number: int, frame: FrameType | None) -> None:
        came.set()
        controls.quit()

    # Only the main thread may; elsewhere, as in a test, the caller has its own way to end.
    main = threading.current_thread() is threading.main_thread()
    before = {n: signal.signal(n, end) for n in (signal.SIGINT, signal.SIGTERM)} if main else {}
    try:
        yield came
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextlib.contextmanager
def _remote(
    loop: TeleopLoop, address: str | None, orders: Orders, progress: Progressing
) -> Iterator[None]:
    """Words of other programs, where they are to be listened to."""
    if address is None:
        yield
        return
    from smooth_operator.teleop.runtime.remote import remote

    with remote(loop, address, orders.words, orders.status) as bound:
        progress.note(f"switches at {bound}")
        yield
