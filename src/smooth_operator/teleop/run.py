"""Runs a teleoperation from a live source to sinks: ``teleoperate``."""

from __future__ import annotations

import contextlib
import dataclasses
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
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
from smooth_operator.hand_files.vendor_model import hand_with_meshes
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
from smooth_operator.retargeting.preset_files import method_config
from smooth_operator.retargeting.presets import default_preset, method_names
from smooth_operator.retargeting.program_store import ProgramStore
from smooth_operator.retargeting.retargeter import Retargeter
from smooth_operator.signals import Ending, ended_by_signals
from smooth_operator.teleop.arm.settings import ArmSettings, read_arm
from smooth_operator.teleop.components import build_feedback, build_sink, build_source
from smooth_operator.teleop.control.bindings import (
    ACTIONS,
    EPISODE_ACTIONS,
    TRIAL_ACTIONS,
    keys_of,
    read_bindings,
)
from smooth_operator.teleop.control.method_switcher import MethodSwitcher
from smooth_operator.teleop.control.pedal import pedal
from smooth_operator.teleop.control.pinches import sides_of, watched
from smooth_operator.teleop.control.reporter import LoggingReporter, summarise
from smooth_operator.teleop.control.rpc import RpcHandlers, check_address, remote
from smooth_operator.teleop.control.switches import (
    StopInput,
    actions,
    background,
    help_line,
    pressing,
    stopped_by,
    terminal_keys,
)
from smooth_operator.teleop.control.task_trials import TaskTrials, with_task
from smooth_operator.teleop.recording.takes import Takes
from smooth_operator.teleop.request import TeleopRequest
from smooth_operator.teleop.runtime.limiter import Limiter
from smooth_operator.teleop.runtime.loop import TeleopLoop
from smooth_operator.teleop.runtime.pipeline import HandPipeline
from smooth_operator.teleop.runtime.priority import going_first, low_jitter
from smooth_operator.teleop.runtime.settings import LoopConfig
from smooth_operator.teleop.sinks.sink import Sink, SinkRunner, sink_actions
from smooth_operator.teleop.sinks.tick import Driver
from smooth_operator.teleop.sources.combined import CombinedSource, part_of
from smooth_operator.teleop.sources.live import LiveSource, source_gaps
from smooth_operator.teleop.sources.played import Replay
from smooth_operator.teleop.sources.webcam.webcam_source import Video
from smooth_operator.teleop.sources.webxr import WebXr
from smooth_operator.types import Side
from smooth_operator.web.browser import open_page

if TYPE_CHECKING:
    from smooth_operator.teleop.arm.controller import ArmOfHand
    from smooth_operator.teleop.cameras import Cameras
    from smooth_operator.teleop.pages.live.live_page import LivePage

COMPILES: Final = "compile"
"""Name of the thread that compiles while the loop runs; the program does not wait for its end."""

_ANNOUNCE_S: Final = 5.0
"""Time within which a source must know its address [s]."""


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
    source ends, after ``duration``, when another thread calls ``loop.controls.quit()``, or, if
    called on the main thread, on an ending signal (Ctrl-C, SIGTERM, SIGHUP of a closed terminal,
    SIGQUIT; Windows' Ctrl-Break and closed window). Sources, sinks and recordings are then closed
    and complete. It needs no terminal and no browser.

    Example::

        from smooth_operator.teleop import TeleopRequest, teleoperate

        request = TeleopRequest(sink=("record:take.mcap",), hand="leap_hand", duration=10.0)
        summary = teleoperate(request)
        print(summary["rate_hz"], summary["added_latency_ms"]["p99"])

    The loop starts while the method is compiled: it shows the operator's hand and holds the robot.
    A run with ``methods``, a ``task`` or a ``duration``, or of a recording, compiles first.

    Args:
        request: source, sinks, robot hand and limits; None for the defaults.
        source: source of the hand frames, in place of the request's.
        sinks: sinks of the commands, in addition to the request's.
        hand: a spec file, a description or a loaded hand, in place of the request's. The other side
            is its mirror image.
        stop: function that returns True while an emergency stop is pressed, in place of the
            request's.
        page: address and appearance of the live page; None for no page.
        keys: True to listen to the keyboard of a terminal: stop, release, pause, quit.
        reporter: shows lines to a person; None for the logger ``smooth_operator.teleop``.
        started: called with the running loop once everything is open, on the loop's thread, so
            it must not wait; the loop's ``controls`` may be used from any thread.

    Returns:
        Summary of the run, as plain JSON values: ``duration_s``, ``interrupted`` (by a signal),
        ``rate_hz``, ``frames_received``, ``frames_answered``, ``added_latency_ms`` (percentiles,
        None without a frame), ``source`` and ``sinks`` (state and failures), and more.

    Raises:
        SmoothOperatorError: a setting is wrong or something can't be opened; nothing has moved.
        KeyboardInterrupt: a signal came before the run began; nothing was opened.
    """
    reporter = LoggingReporter() if reporter is None else reporter
    request = TeleopRequest() if request is None else request
    spec = hand.spec if isinstance(hand, Hand) else hand or request.hand
    side = request.side
    if side is None:
        side = default_side(spec) if isinstance(spec, str) else "right"
    texts: list[str | Sink] = [*sinks, *with_task(request.sink, request.task)]
    operator = _operator(request.operator, "right" if side == "both" else side)
    fixed = request.arm is not None or request.task is not None
    if request.wrist_joints == "on" and fixed:
        raise ConfigError(
            "--wrist-joints on can't be used with --arm or --task: an arm moves the whole hand as "
            "the operator's wrist moves, and in a study task the palm does not move; remove one "
            "of these options"
        )
    wrist_joints = request.wrist_joints != "off" and not fixed
    settings = request.settings() | {"hand": spec, "operator": operator}
    retarget = make_request(**settings, wrist_joints=wrist_joints)
    names = [name for text in request.methods for name in text.split(",")]
    sides: tuple[Side, ...] = ("right", "left") if side == "both" else (side,)
    commanded = [build_sink(sink) if isinstance(sink, str) else sink for sink in texts]
    bindings = read_bindings(request.bind, {name for each in commanded for name in each.actions})
    pinches = sides_of(bindings, sides)
    if source is None:
        source = build_source(request.source, "both" if pinches else side)
    if request.wrist_source is not None:
        source = _with_wrist(source, request.wrist_source, sides, operator, reporter)
    for kind, there, remedy in (
        ("pedal", request.pedal is not None, "name its device with --pedal"),
        ("button", part_of(source, WebXr) is not None, "controllers need --source webxr"),
    ):
        if not there and (unused := [one for one in bindings if one.startswith(f"{kind}:")]):
            reporter.note(f"{', '.join(unused)}: no effect in this run; {remedy}", matters=True)
    feedback = [build_feedback(text) for text in request.feedback]
    for output in feedback:
        output.use_source(source)
    if feedback and not any(sink.measures for sink in commanded):
        raise ConfigError(
            "--feedback needs a sink that measures contact, such as --sink mujoco or a real hand"
        )
    run = _Run(
        request,
        retarget,
        others=[_with_method(retarget, name) for name in names],
        config=LoopConfig(request.rate, request.safety, request.limits, request.wrist),
        sides=sides,
        source=source,
        sink_texts=texts,
        sinks=[*commanded, *feedback],
        arm=None if request.arm is None else read_arm(request.arm),
        stop=StopInput(request.estop) if stop is None and request.estop is not None else stop,
        bindings=bindings,
        pinches=pinches,
        attended=keys and bool(sys.stdin) and sys.stdin.isatty(),
        reporter=reporter,
        started=started,
    )
    if request.camera and page is None and part_of(source, WebXr) is None:
        raise ConfigError(
            "--camera shows pictures on the live page or in a headset: remove --no-view, or use "
            "--source webxr"
        )
    run.check(page)
    with contextlib.ExitStack() as opened:
        if request.camera:
            from smooth_operator.teleop.cameras import Cameras

            run.cameras = opened.enter_context(Cameras(request.camera, run.sinks))
        ending = opened.enter_context(ended_by_signals())
        live_page = None if page is None else opened.enter_context(_open_page(page, run))
        summary = run.drive(ending, live_page)
        while run.next_request is not None and not ending.came:
            run.take_next()
            summary = run.drive(ending, live_page)
        return summary


@dataclass
class _Run:
    """A teleoperation run with its parts; it can continue with another hand."""

    teleop: TeleopRequest
    request: RetargetRequest
    others: Sequence[RetargetRequest]
    config: LoopConfig
    sides: tuple[Side, ...]
    source: LiveSource
    sink_texts: Sequence[str | Sink]
    sinks: Sequence[Sink]
    arm: ArmSettings | None
    stop: Callable[[], bool] | None
    bindings: Mapping[str, str]
    pinches: Mapping[Side, Mapping[str, str]]
    attended: bool
    reporter: Reporter
    started: Callable[[TeleopLoop], None] | None
    hands: dict[Side, tuple[Hand, MethodConfig]] = field(default_factory=dict)
    arms: dict[Side, ArmOfHand] = field(default_factory=dict)
    cameras: Cameras | None = None
    next_request: RetargetRequest | None = None

    def check(self, page: PageSettings | None) -> None:
        """Check extras, files, models, addresses and ports, and open the source."""
        self._load(self.request)
        hands = {side: self.request.commanded(hand) for side, (hand, _) in self.hands.items()}
        SinkRunner(self.sinks).check(hands)
        if self.teleop.control is not None:
            check_address(self.teleop.control)
        if page is not None:
            from smooth_operator.teleop.pages.viser_server import free_port

            free_port(page.host, page.port)
            if page.model is not None:
                for hand, _ in self.hands.values():
                    hand_with_meshes(hand, page.model)  # as later in the page's process
        self.source.prepare()

    def _resolve(self, request: RetargetRequest) -> dict[Side, tuple[Hand, MethodConfig]]:
        """Hands of a request and the settings of their methods, checked against the limits."""
        both = len(self.sides) > 1
        hands = {side: resolve(request.of(side) if both else request, side) for side in self.sides}
        for hand, _ in hands.values():
            Limiter(request.commanded(hand), self.config.limits)
        return hands

    def _load(self, request: RetargetRequest) -> None:
        """Load hands, settings and arms of a request; changes nothing if one fails."""
        hands = self._resolve(request)
        arms: dict[Side, ArmOfHand] = {}
        if self.arm is not None:
            require("an arm", "arm", "mink", "daqp")
            from smooth_operator.teleop.arm.controller import build_arms

            arms = build_arms(self.arm, {side: hand for side, (hand, _) in hands.items()})
            for sink in self.sinks:
                sink.use_arms({side: one.carried for side, one in arms.items()})
        self.hands, self.arms = hands, arms

    @property
    def other_hands(self) -> list[str]:
        """Names of the hands with which the run can continue; empty if its hand is fixed."""
        real = any(sink.moves_real_hand for sink in self.sinks)
        fixed = real or self.teleop.task is not None or self.teleop.blind
        if fixed or not isinstance(self.request.hand, str):
            return []
        return list(hand_names())

    @property
    def offered(self) -> list[str]:
        """Names of the operator's actions that this run has."""
        own = {name for sink in self.sinks for name in sink.actions}
        without = {*(() if self.teleop.task else TRIAL_ACTIONS), *EPISODE_ACTIONS} - own
        return [name for name in dict.fromkeys((*ACTIONS, *own)) if name not in without]

    def change_hand(self, name: str, loop: TeleopLoop, switcher: MethodSwitcher) -> None:
        """End this loop, and let the next one drive another hand by the same method."""
        if name not in self.other_hands:
            raise ConfigError(
                f"this run can't continue with the hand {name!r}; choose one that its page offers"
            )
        used = switcher.used
        request = replace(
            self.request, hand=name, method=used.method, preset=used.preset, config=used.base
        )
        self._resolve(request)
        self.next_request = request
        loop.controls.quit()

    def _keep_operator(
        self, pipelines: Mapping[Side, HandPipeline], switcher: MethodSwitcher
    ) -> None:
        """Write the pinch gaps of this session into the operator's file, if there is one."""
        operator, file = self.request.operator, self.teleop.operator
        for side, pipeline in pipelines.items():
            gaps = {name: round(gap, 4) for name, gap in pipeline.pinch_gaps.items()}
            if file is None or operator is None or operator is not switcher.operators[side]:
                continue
            if gaps and gaps != operator.pinch_gaps:
                source = operator.source or self.source.label
                gaps = {**operator.pinch_gaps, **gaps}
                write_operator(file, replace(operator, pinch_gaps=gaps, source=source))
                self.reporter.note(f"wrote {file}: the pinch gaps of this session")

    def take_next(self) -> None:
        """Change to the hand of ``change_hand``."""
        assert self.next_request is not None
        self.request, self.next_request = self.next_request, None
        self.reporter.note(f"switching to hand {self.request.hand}", matters=True)
        self._load(self.request)

    def drive(self, ending: Ending, page: LivePage | None) -> dict[str, Any]:
        """Drive the hands until the run ends or the next hand is chosen; returns the summary."""
        request, reporter, source, teleop = self.request, self.reporter, self.source, self.teleop
        blind, config, sinks = teleop.blind, self.config, self.sinks
        runner = SinkRunner(sinks)
        retargeters = self._retargeters()
        pipelines = {
            side: HandPipeline(
                retargeter,
                config,
                driver=Driver(request.method, request.preset, retargeter.config),
                arm=self.arms[side].controller if self.arms else None,
                compiling=not retargeter.compiled,
                wrist_joints=request.wrist_joints,
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
            sinks=[sink if isinstance(sink, str) else sink.label for sink in self.sink_texts],
            feedback=list(teleop.feedback),
            loop=config,
            arm=self.arm,
        )

        def record(side: Side, text: str) -> None:
            loop.controls.change(lambda hand: hand.note(text) if hand.side == side else None)

        def about() -> dict[str, Any]:
            used = switcher.used
            return {"method": used.method, "preset": used.preset, "source": source.label}

        trials = TaskTrials(
            sinks,
            self.sides,
            reporter,
            task=teleop.task,
            folder=teleop.trials,
            controlled=teleop.control is not None,
            attended=self.attended,
            about=about,
            record=record,
        )

        def say(text: str) -> None:
            reporter.note(text, matters=True)

        takes = Takes(runner, Path("takes"), switcher.configuration, say)
        acts = {
            **sink_actions(sinks, say),
            **trials.actions,
            **takes.actions,
            **actions(loop, self.bindings, say),
        }
        headset = part_of(source, WebXr)
        if page is not None or headset is not None:
            from smooth_operator.teleop.pages.live.live_session import LiveSession

            session = LiveSession(
                loop,
                sinks,
                switcher,
                takes,
                acts,
                trial=trials.shown,
                blind=blind,
                other_hands=self.other_hands,
                change_hand=lambda name: self.change_hand(name, loop, switcher),
                cameras=self.cameras,
            )
            loop.watch = session.watch
            if page is not None:
                page.serve(session)
            if headset is not None:
                from smooth_operator.teleop.pages.headset_view import HeadsetView

                driven = {side: hand for side, (hand, _) in self.hands.items()}
                measured = any(sink.measures for sink in sinks)
                headset.show(HeadsetView(session, driven, measured, self.arm))
        # A recording, which ends, must not play before the robot can move.
        hands = source.hands if isinstance(source, CombinedSource) else source
        played = isinstance(hands, Replay) or (isinstance(hands, Video) and not hands.loop)
        waits = teleop.task is not None or teleop.duration is not None or played
        if self.others or waits:
            switcher.building = "compiling"
            self._compile()
            switcher.building = ""
            for pipeline in pipelines.values():
                pipeline.go_on()
        handlers = RpcHandlers(loop, switcher, lambda: trials.runner, blind=blind)
        granted = "normal"
        begin = time.perf_counter()
        ending.quit = loop.controls.quit
        where = ", ".join(sink.label for sink in runner.health()) or "no sink"
        reporter.note(f"commands from {source.label} go to {where}")
        with (
            contextlib.closing(switcher),
            low_jitter(),
            pressing(self.bindings, acts) as press,
            contextlib.nullcontext()
            if teleop.pedal is None
            else pedal(teleop.pedal, press, self.bindings, say),
            terminal_keys(press) if self.attended else contextlib.nullcontext(),
            contextlib.nullcontext()
            if teleop.control is None
            else remote(loop, teleop.control, handlers.by_command, handlers.status) as address,
            stopped_by(loop, self.stop),
            _compiling(retargeters, loop, reporter),
            contextlib.ExitStack() as stack,
        ):
            loop.mailbox.bindings, loop.mailbox.press = self.bindings, press
            if self.pinches:
                loop.mailbox.see = watched(self.pinches, press, source_gaps(source))
            if self.attended:
                reporter.note(help_line(self.bindings, acts))
            if address is not None:
                reporter.note(f"listening for commands at {address}")

            def opened() -> None:
                nonlocal granted
                if teleop.priority == "high":
                    granted = stack.enter_context(going_first())
                stack.enter_context(_announced(source, reporter))
                trials.begin()
                if self.started is not None:
                    self.started(loop)

            loop.run(teleop.duration, recorded, started=opened)
        if headset is not None:
            headset.show(None)
        if page is not None and self.next_request is not None:
            page.change(replace(page.setup, hand=str(self.next_request.hand)))
        seconds = time.perf_counter() - begin
        trials.end()
        self._keep_operator(pipelines, switcher)
        more = {"priority": granted, "interrupted": ending.came, **trials.summary()}
        return summarise(loop, seconds, reporter, more)

    def _retargeters(self) -> dict[Side, Retargeter]:
        """Retargeters of the hands, which may not be compiled yet."""
        retargeters: dict[Side, Retargeter] = {}
        request, tracker = self.request, source_gaps(self.source)
        for side, (hand, config) in self.hands.items():
            for note in () if self.teleop.blind else config.notes(hand):
                self.reporter.note(note, matters=True)
            gaps = request.of(side).known_gaps(tracker)
            retargeters[side] = Retargeter(
                hand,
                config=config,
                seed=request.seed,
                cache=ProgramStore.of_user(),
                pinch_gaps=gaps,
            )
        return retargeters

    def _compile(self) -> None:
        """Compile the run's method and the further ones; this process then keeps them."""
        for side, (hand, own) in self.hands.items():
            configs = [(self.request.method, own)]
            configs += [(each.method, resolve_config(each, hand)) for each in self.others]
            for name, config in configs:
                method = "the method" if self.teleop.blind else name
                with self.reporter.waiting(f"compiling {method} for {hand.name} {side}"):
                    Retargeter(
                        hand,
                        config=config,
                        seed=self.request.seed,
                        cache=ProgramStore.of_user(),
                    ).warm_up()


def _operator(path: Path | None, side: Side) -> OperatorProfile | None:
    """Content of an operator's file; an empty profile if there is no file yet."""
    if path is None:
        return None
    if not path.parent.is_dir():
        raise ConfigError(
            f"{path}: there is no folder {path.parent}; create it or name another folder"
        )
    return read_operator(path) if path.exists() else OperatorProfile(side)


def _with_wrist(
    hands: LiveSource,
    text: str,
    sides: tuple[Side, ...],
    operator: OperatorProfile | None,
    reporter: Reporter,
) -> CombinedSource:
    """The source with the wrists of another one, which sits on the hands as the operator's file
    says."""
    wrist = build_source(text, sides[0] if len(sides) == 1 else "both")
    mounts = {} if operator is None else operator.mounts
    for side in sides:
        if side not in mounts:
            reporter.note(
                f"the pose from {wrist.label} is used as the pose of the {side} wrist, because "
                "the operator file does not say where the tracker sits; to measure that: "
                f"smooth-operator calibrate --wrist-source {text} --side {side} --output "
                "OPERATOR.json",
                matters=True,
            )
    return CombinedSource(hands, wrist, {side: mounts[side] for side in sides if side in mounts})


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
    """Compiles methods while the block runs; each hand moves once its method is compiled."""
    waiting = {side: each for side, each in retargeters.items() if not each.compiled}
    errors: list[Exception] = []

    def go_on(side: Side) -> None:
        loop.controls.change(lambda hand: hand.go_on() if hand.side == side else None)

    def compile_all() -> None:
        for side, retargeter in waiting.items():
            reporter.note(f"{side}: compiling the method; the robot holds its pose", matters=True)
            try:
                seconds = retargeter.warm_up()
            except Exception as error:  # raised on the loop's thread
                errors.append(error)
                loop.controls.quit()
                return
            go_on(side)
            reporter.note(f"{side}: compiled after {seconds:.1f} s")

    if waiting:
        # Not a daemon: a thread inside XLA at the end of the interpreter can abort the process.
        threading.Thread(target=compile_all, name=COMPILES).start()
    yield
    if errors:
        raise errors[0]


def _announced(source: LiveSource, reporter: Reporter) -> AbstractContextManager[None]:
    """Reports the address and the code that the operator needs to connect."""

    def tell(over: threading.Event) -> None:
        end = time.monotonic() + _ANNOUNCE_S
        while not (health := source.health()).detail and time.monotonic() < end:
            if over.wait(0.1):
                return
        if health.detail:
            reporter.note(f"{source.label}: {health.detail}", matters=health.state != "running")

    return background("announce", tell)


@dataclass(frozen=True)
class PageSettings:
    """Address and appearance of the live page. Needs the ``teleop`` extra.

    Attributes:
        host: address on which to listen. Other machines need a token in the page's address.
        port: first port to try; 0 for any free port.
        open_browser: True to open the page in the browser.
        model: the vendor's MJCF or URDF to draw in place of simple shapes, or ``menagerie``.
        meshes: True to draw meshes if there are any, False for simple shapes.
    """

    host: str = "127.0.0.1"
    port: int = 8080
    open_browser: bool = True
    model: Path | None = None
    meshes: bool = True


@contextlib.contextmanager
def _open_page(page: PageSettings, run: _Run) -> Iterator[LivePage]:
    """Starts the page's process and reports its address."""
    from smooth_operator.teleop.pages.live.live_page import LivePage, PageSetup

    with temporary_spec(run.request.hand) as hand:
        setup = PageSetup(
            hand,
            run.sides,
            run.request.fingers,
            page.host,
            page.port,
            any(sink.measures for sink in run.sinks),
            run.teleop.blind,
            None if page.model is None else str(page.model),
            page.meshes,
            arm=run.arm,
            attended=run.attended,
            keys=keys_of(run.bindings, run.offered),
        )
        with LivePage(setup) as live_page:
            run.reporter.note(f"page: {live_page.url}", matters=True)
            if page.open_browser:
                open_page(live_page.url)
            yield live_page
