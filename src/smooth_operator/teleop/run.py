"""``teleoperate``: from a live source to sinks, until the source, the time or the user ends it."""

from __future__ import annotations

import contextlib
import dataclasses
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from smooth_operator.calibration.operator_file import (
    OperatorProfile,
    read_operator,
    write_operator,
)
from smooth_operator.errors import ConfigError, require
from smooth_operator.hand_files.spec_writer import temporary_spec
from smooth_operator.hand_files.vendor_model import drawn_on
from smooth_operator.hands.hand import Hand
from smooth_operator.hands.registry import default_side, hand_names
from smooth_operator.hands.spec import HandSpec
from smooth_operator.planning import (
    RetargetRequest,
    live_configuration,
    make_request,
    resolve,
    resolve_config,
)
from smooth_operator.reporter import Reporter
from smooth_operator.retargeting.method import MethodConfig
from smooth_operator.retargeting.presets import default_preset, method_config, method_names
from smooth_operator.retargeting.retargeter import Retargeter
from smooth_operator.signals import Ending, ended_by_signals
from smooth_operator.teleop.arm.settings import ArmSettings, read_arm
from smooth_operator.teleop.components import build_sink, build_source
from smooth_operator.teleop.control.method_switcher import MethodSwitcher
from smooth_operator.teleop.control.reporter import LoggingReporter, summarise
from smooth_operator.teleop.control.rpc import RpcHandlers
from smooth_operator.teleop.control.switches import StopInput, keyboard, stopped_by
from smooth_operator.teleop.control.task_trials import TaskTrials, with_task
from smooth_operator.teleop.hardware.hardware_sink import real_hand
from smooth_operator.teleop.request import TeleopRequest
from smooth_operator.teleop.runtime.limiter import Limiter
from smooth_operator.teleop.runtime.loop import TeleopLoop
from smooth_operator.teleop.runtime.pipeline import HandPipeline
from smooth_operator.teleop.runtime.priority import going_first, low_jitter
from smooth_operator.teleop.runtime.settings import LoopConfig
from smooth_operator.teleop.sinks.sink import Sink, SinkRunner
from smooth_operator.teleop.sinks.tick import Driver
from smooth_operator.teleop.sources.live import LiveSource, source_gaps
from smooth_operator.teleop.sources.played import Replay
from smooth_operator.teleop.sources.webcam.webcam_source import Video
from smooth_operator.types import Side
from smooth_operator.web.browser import open_page

if TYPE_CHECKING:
    from smooth_operator.teleop.arm.controller import ArmOfHand
    from smooth_operator.teleop.pages.live.live_page import LivePage

COMPILES: Final = "compile"
"""Name of the thread that compiles while the loop runs; a command does not wait for its end."""

_ANNOUNCE_S: Final = 5.0
"""Time that a source may take to say how it is reached [s]."""


def teleoperate(
    request: TeleopRequest | None = None,
    *,
    source: LiveSource | None = None,
    sinks: Sequence[Sink] = (),
    hand: Path | HandSpec | Hand | None = None,
    stop: Callable[[], bool] | None = None,
    page: PageSettings | None = None,
    keys: bool = False,
    reporter: Reporter | None = None,
    started: Callable[[TeleopLoop], None] | None = None,
) -> dict[str, Any]:
    """Drives a robot hand from a live source, and returns when the run has ended.

    All settings are checked and everything is opened before anything moves. A run ends when the
    source ends, after ``duration``, on an ending signal (Ctrl-C, SIGTERM, SIGHUP of a closed
    terminal, SIGQUIT; Windows' Ctrl-Break and closed window) if called on the main thread, or when
    another thread calls ``loop.controls.quit()``. Sources, sinks and recordings are then closed
    and whole. It needs no terminal and no browser.

    Example::

        from smooth_operator.teleop import TeleopRequest, teleoperate

        request = TeleopRequest(sink=("record:take.mcap",), hand="leap_hand", duration=10.0)
        summary = teleoperate(request)
        print(summary["rate_hz"], summary["added_latency_ms"]["p99"])

    Without any ``methods``, the loop starts while the method is compiled: it shows the operator's
    hand and holds the robot. A run with a ``task`` or a ``duration`` and one of a recording wait.

    Args:
        request: source, sinks, robot hand and limits; None for the defaults.
        source: an object that hand frames come from, in place of the request's.
        sinks: objects that commands go to, before the request's.
        hand: a spec file, a description or a loaded hand, in place of the request's. The other side
            is its mirror image.
        stop: function that says whether an emergency stop is pressed, in place of the request's.
        page: serve the live page; None for none.
        keys: listen to the keyboard where there is a terminal: stop, release, pause, quit.
        reporter: takes lines for a person; None for the logger ``smooth_operator.teleop``.
        started: called with the running loop once everything is open, on the loop's thread, so
            it must not wait; the loop's ``controls`` may be used from any thread.

    Returns:
        What the run came to, as plain JSON values: ``duration_s``, ``interrupted`` (by a signal),
        ``rate_hz``, ``frames_received``, ``frames_answered``, ``added_latency_ms`` (percentiles,
        None without a frame), ``source`` and ``sinks`` (state and failures), and more.

    Raises:
        SmoothOperatorError: a setting is wrong or something can't be opened; nothing has moved.
        KeyboardInterrupt: a signal came before the run began; nothing was opened.
    """
    reporter = LoggingReporter() if reporter is None else reporter
    request = TeleopRequest() if request is None else request
    described = hand.spec if isinstance(hand, Hand) else hand or request.hand
    side = request.side
    if side is None:
        side = default_side(described) if isinstance(described, str) else "right"
    requested: list[str | Sink] = [*sinks, *with_task(request.sink, request.task)]
    settings = request.settings() | {
        "hand": described,
        "operator": _known(request.operator, "right" if side == "both" else side),
    }
    asked = make_request(**settings)
    run = _Run(
        request,
        asked,
        others=[_with_method(asked, name) for text in request.methods for name in text.split(",")],
        config=LoopConfig(request.rate, request.safety, request.limits, request.wrist),
        sides=("right", "left") if side == "both" else (side,),
        source=build_source(request.source, side) if source is None else source,
        requested=requested,
        acting=[build_sink(sink) if isinstance(sink, str) else sink for sink in requested],
        carrier=None if request.arm is None else read_arm(request.arm),
        stop=StopInput(request.estop) if stop is None and request.estop is not None else stop,
        attended=keys and bool(sys.stdin) and sys.stdin.isatty(),
        reporter=reporter,
        started=started,
    )
    run.check(page)
    with ended_by_signals() as ending, _begun_page(page, run) as begun:
        summary = run.drive(ending, begun)
        while run.next_request is not None and not ending.came:
            run.take_next()
            summary = run.drive(ending, begun)
        return summary


@dataclass
class _Run:
    """A teleoperation: what it was asked for, read and checked. It can go on with another hand."""

    asked: TeleopRequest
    request: RetargetRequest
    others: Sequence[RetargetRequest]
    config: LoopConfig
    sides: tuple[Side, ...]
    source: LiveSource
    requested: Sequence[str | Sink]
    acting: Sequence[Sink]
    carrier: ArmSettings | None
    stop: Callable[[], bool] | None
    attended: bool
    reporter: Reporter
    started: Callable[[TeleopLoop], None] | None
    settled: dict[Side, tuple[Hand, MethodConfig]] = field(default_factory=dict)
    arms: dict[Side, ArmOfHand] = field(default_factory=dict)
    next_request: RetargetRequest | None = None

    def check(self, page: PageSettings | None) -> None:
        """Find out whether all that the run needs is there.

        Whatever is missing, taken or wrong is found here, in a second, and not after a compilation:
        extras, files, models, addresses, ports. The source is open afterwards.
        """
        self._settle(self.request)
        hands = {side: hand for side, (hand, _) in self.settled.items()}
        SinkRunner(self.acting).check(hands)
        if self.asked.control is not None:
            from smooth_operator.teleop.control.rpc import check_address

            check_address(self.asked.control)
        if page is not None:
            from smooth_operator.teleop.pages.viser_server import free_port

            free_port(page.host, page.port)
            if page.model is not None:
                for hand in hands.values():
                    drawn_on(hand, page.model)  # the page's own process does it again
        self.source.prepare()

    def _settle(self, request: RetargetRequest) -> None:
        """Reads the hands of a request, their methods' settings and their arms, or changes
        nothing."""
        settled = {side: resolve(request, side) for side in self.sides}
        hands = {side: hand for side, (hand, _) in settled.items()}
        for hand in hands.values():
            Limiter(hand, self.config.limits)
        arms: dict[Side, ArmOfHand] = {}
        if self.carrier is not None:
            require("an arm", "arm", "mink", "daqp")
            from smooth_operator.teleop.arm.controller import build_arms

            arms = build_arms(self.carrier, hands)
            for sink in self.acting:
                sink.use_arms({side: one.carried for side, one in arms.items()})
        self.settled, self.arms = settled, arms

    @property
    def other_hands(self) -> list[str]:
        """Names of the hands that the run could go on with; none where it can't."""
        fixed = self.asked.task is not None or self.asked.blind or any(map(real_hand, self.acting))
        if fixed or not isinstance(self.request.hand, str):
            return []
        return list(hand_names())

    def change_hand(self, name: str, loop: TeleopLoop, switcher: MethodSwitcher) -> None:
        """End this loop, and have the next one drive another hand by the same method.

        Raises:
            ConfigError: it is not among ``other_hands``.
            SmoothOperatorError: the hand does not fit the settings of the run; nothing changes.
        """
        if name not in self.other_hands:
            raise ConfigError(f"this run can't go on with the hand {name!r}")
        used = switcher.used
        following = replace(
            self.request, hand=name, method=used.method, preset=used.preset, config=used.base
        )
        for side in self.sides:
            hand, _ = resolve(following, side)
            Limiter(hand, self.config.limits)
        self.next_request = following
        loop.controls.quit()

    def _keep_operator(
        self, pipelines: Mapping[Side, HandPipeline], switcher: MethodSwitcher
    ) -> None:
        """Writes what was learnt about the operator into his file, if the run has one."""
        known = self.request.operator
        for side, pipeline in pipelines.items():
            gaps = {name: round(gap, 4) for name, gap in pipeline.pinch_gaps.items()}
            file = self.asked.operator
            if file is None or known is None or known is not switcher.operators[side]:
                return
            if gaps and gaps != known.pinch_gaps:
                source = known.source or self.source.label
                kept = replace(known, pinch_gaps={**known.pinch_gaps, **gaps}, source=source)
                write_operator(file, kept)
                self.reporter.note(f"wrote {file}: the pinch gaps of this session")

    def take_next(self) -> None:
        """Go over to the hand of ``change_hand``."""
        assert self.next_request is not None
        self.request, self.next_request = self.next_request, None
        self.reporter.note(f"the next hand: {self.request.hand}", matters=True)
        self._settle(self.request)

    def drive(self, ending: Ending, begun: LivePage | None) -> dict[str, Any]:
        """Drives the hands until the run ends, or the next hand is chosen; the summary."""
        request, reporter, source, sides = self.request, self.reporter, self.source, self.sides
        settled, blind, config, acting = self.settled, self.asked.blind, self.config, self.acting
        runner = SinkRunner(acting)
        retargeters = _built(settled, request, source, blind, reporter)
        pipelines = {
            side: HandPipeline(
                retargeter,
                config,
                driver=Driver(request.method, request.preset, retargeter.config),
                arm=self.arms[side].controller if self.arms else None,
                compiling=not retargeter.compiled,
            )
            for side, retargeter in retargeters.items()
        }
        loop = TeleopLoop(pipelines, source, runner, config)
        switcher = MethodSwitcher(loop, request)
        recorded = live_configuration(
            "teleop",
            request,
            {side: retargeter.config for side, retargeter in retargeters.items()},
            pinch_gaps={side: retargeter.known_gaps for side, retargeter in retargeters.items()},
            source=source if dataclasses.is_dataclass(source) else source.label,
            sinks=[sink if isinstance(sink, str) else sink.label for sink in self.requested],
            loop=config,
            arm=self.carrier,
        )

        def record(side: Side, text: str) -> None:
            loop.controls.change(lambda hand: hand.note(text) if hand.side == side else None)

        def about() -> dict[str, Any]:
            used = switcher.used
            return {"method": used.method, "preset": used.preset, "source": source.label}

        tried = TaskTrials(
            acting,
            sides,
            reporter,
            task=self.asked.task,
            folder=self.asked.trials,
            controlled=self.asked.control is not None,
            attended=self.attended,
            about=about,
            record=record,
        )
        if begun is not None:
            from smooth_operator.teleop.pages.live.live_session import LiveSession

            session = LiveSession(
                loop,
                request,
                acting,
                switcher=switcher,
                blind=blind,
                trial=tried.shown,
                other_hands=self.other_hands,
                change_hand=lambda name: self.change_hand(name, loop, switcher),
            )
            loop.watch = session.watch
            begun.serve(session)
        # What is played, and ends, begins with its first frame.
        played = isinstance(source, Replay) or (isinstance(source, Video) and not source.loop)
        waits = self.asked.task is not None or self.asked.duration is not None or played
        if self.others or waits:
            switcher.building = "compiling"
            _compile(settled, request, self.others, blind, reporter)
            switcher.building = ""
            for pipeline in pipelines.values():
                pipeline.go_on()
        handlers = RpcHandlers(loop, switcher, lambda: tried.runner, blind=blind)
        granted = "normal"
        begin = time.perf_counter()
        ending.quit = loop.controls.quit
        where = ", ".join(sink.label for sink in runner.health()) or "no sink"
        reporter.note(f"from {source.label} to {where}")
        with (
            contextlib.closing(switcher),
            low_jitter(),
            keyboard(loop, reporter, tried.keys, tried.key_help)
            if self.attended
            else contextlib.nullcontext(),
            _remote(loop, self.asked.control, handlers, reporter),
            stopped_by(loop, self.stop),
            _compiling(retargeters, loop, reporter),
            contextlib.ExitStack() as first,
        ):

            def opened() -> None:
                nonlocal granted
                if self.asked.priority == "high":
                    granted = first.enter_context(going_first())
                first.enter_context(_announced(source, reporter))
                tried.begin()
                if self.started is not None:
                    self.started(loop)

            loop.run(self.asked.duration, recorded, started=opened)
        if begun is not None and self.next_request is not None:
            begun.change(replace(begun.setup, hand=str(self.next_request.hand)))
        seconds = time.perf_counter() - begin
        tried.end()
        self._keep_operator(pipelines, switcher)
        more = {"priority": granted, "interrupted": ending.came, **tried.summary()}
        return summarise(loop, seconds, reporter, more)


def _known(path: Path | None, side: Side) -> OperatorProfile | None:
    """What an operator's file says; nothing yet where there is none.

    Raises:
        ConfigError: the file can't be read, or its folder isn't there.
    """
    if path is None:
        return None
    if not path.parent.is_dir():
        raise ConfigError(f"{path}: there is no folder {path.parent}; make it, or name another")
    return read_operator(path) if path.exists() else OperatorProfile(side)


def _built(
    settled: Mapping[Side, tuple[Hand, MethodConfig]],
    request: RetargetRequest,
    source: LiveSource,
    blind: bool,
    reporter: Reporter,
) -> dict[Side, Retargeter]:
    """The hands' retargeters, not compiled yet."""
    retargeters: dict[Side, Retargeter] = {}
    for side, (hand, config) in settled.items():
        if not blind:
            for note in config.notes(hand):
                reporter.note(note, matters=True)
        gaps = request.known_gaps(source_gaps(source))
        retargeters[side] = Retargeter(hand, config=config, seed=request.seed, pinch_gaps=gaps)
    return retargeters


def _compile(
    settled: Mapping[Side, tuple[Hand, MethodConfig]],
    request: RetargetRequest,
    others: Sequence[RetargetRequest],
    blind: bool,
    reporter: Reporter,
) -> None:
    """Compiles the run's method and those of other requests, which the process then has."""
    for side, (hand, own) in settled.items():
        configs = [(request.method, own)]
        configs += [(each.method, resolve_config(each, hand)) for each in others]
        for name, config in configs:
            what = "the method" if blind else name
            with reporter.waiting(f"compiling {what} for {hand.name} {side}"):
                Retargeter(hand, config=config, seed=request.seed).warm_up()


def _with_method(request: RetargetRequest, text: str) -> RetargetRequest:
    """The request with another method, ``METHOD`` or ``METHOD:PRESET``."""
    name, _, preset = text.partition(":")
    if name not in method_names():  # package.module:attribute
        name, preset = text, ""
    preset = preset or default_preset(name)
    return replace(request, method=name, preset=preset, config=method_config(name, preset))


@contextlib.contextmanager
def _compiling(
    retargeters: Mapping[Side, Retargeter], loop: TeleopLoop, reporter: Reporter
) -> Iterator[None]:
    """While the block runs: methods that are not compiled yet are, and their hands go on then."""
    waiting = {side: each for side, each in retargeters.items() if not each.compiled}
    errors: list[Exception] = []

    def let_go(side: Side) -> None:
        loop.controls.change(lambda hand: hand.go_on() if hand.side == side else None)

    def compile_all() -> None:
        for side, retargeter in waiting.items():
            reporter.note(f"{side}: compiling the method; the robot holds", matters=True)
            try:
                seconds = retargeter.warm_up()
            except Exception as error:  # raised on the loop's thread
                errors.append(error)
                loop.controls.quit()
                return
            let_go(side)
            reporter.note(f"{side}: compiled after {seconds:.1f} s")

    if waiting:
        # Not a daemon: one that is inside XLA when the interpreter ends can abort the process.
        threading.Thread(target=compile_all, name=COMPILES).start()
    yield
    if errors:
        raise errors[0]


@contextlib.contextmanager
def _announced(source: LiveSource, reporter: Reporter) -> Iterator[None]:
    """Reports how the operator connects: address and code."""
    over = threading.Event()

    def tell() -> None:
        end = time.monotonic() + _ANNOUNCE_S
        while not (health := source.health()).detail and time.monotonic() < end:
            if over.wait(0.1):
                return
        if health.detail:
            reporter.note(f"{source.label}: {health.detail}", matters=health.state != "running")

    thread = threading.Thread(target=tell, name="announce", daemon=True)
    thread.start()
    try:
        yield
    finally:  # a thread that outlives the command can abort the interpreter as it ends
        over.set()
        thread.join()


@contextlib.contextmanager
def _remote(
    loop: TeleopLoop, address: str | None, handlers: RpcHandlers, reporter: Reporter
) -> Iterator[None]:
    """Commands of other programs, where they are to be listened to."""
    if address is None:
        yield
        return
    from smooth_operator.teleop.control.rpc import remote

    with remote(loop, address, handlers.by_command, handlers.status) as bound:
        reporter.note(f"switches at {bound}")
        yield


@dataclass(frozen=True)
class PageSettings:
    """Address and look of the live page. Needs the extra ``teleop``.

    Attributes:
        host: address to listen at; other than this machine's, a token in the page's address is
            needed to open it.
        port: first port to try; 0 for any free one.
        open_browser: open it in the browser.
        model: the vendor's MJCF or URDF to draw in place of simple shapes, or ``menagerie``.
        meshes: draw meshes, where there are some; otherwise simple shapes.
    """

    host: str = "127.0.0.1"
    port: int = 8080
    open_browser: bool = True
    model: Path | None = None
    meshes: bool = True


@contextlib.contextmanager
def _begun_page(page: PageSettings | None, run: _Run) -> Iterator[LivePage | None]:
    """The page's process, whose address is reported first of all; None if it is left out."""
    if page is None:
        yield None
        return
    from smooth_operator.teleop.pages.live.live_page import LivePage, PageSetup

    with temporary_spec(run.request.hand) as hand:
        setup = PageSetup(
            hand,
            run.sides,
            run.request.fingers,
            page.host,
            page.port,
            any(sink.measures for sink in run.acting),
            run.asked.blind,
            None if page.model is None else str(page.model),
            page.meshes,
            arm=run.carrier,
            attended=run.attended,
        )
        with LivePage(setup) as begun:
            run.reporter.note(f"page: {begun.url}", matters=True)
            if page.open_browser:
                open_page(begun.url)
            yield begun
