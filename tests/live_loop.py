"""A teleoperation loop that runs in a thread, with the session, server and panel of a page."""

import contextlib
import threading
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from live_time import PATIENCE_S, until

from smooth_operator.hands.hand import Hand
from smooth_operator.teleop.control.method_switcher import MethodSwitcher
from smooth_operator.teleop.control.switches import actions
from smooth_operator.teleop.pages.live.live_panel import LivePanel
from smooth_operator.teleop.pages.live.live_scene import LiveScene
from smooth_operator.teleop.pages.live.live_session import LiveSession
from smooth_operator.teleop.pages.live.stop_panel import StopPanel
from smooth_operator.teleop.pages.viser_server import open_server
from smooth_operator.teleop.recording.takes import Takes
from smooth_operator.teleop.runtime.loop import TeleopLoop
from smooth_operator.teleop.runtime.priority import low_jitter
from smooth_operator.teleop.sinks.tick import Mode, Tick
from smooth_operator.types import Side


@dataclass
class Running:
    """A running loop and the ticks that it has sent."""

    loop: TeleopLoop
    ticks: list[Tick] = field(default_factory=list)

    def mode(self) -> Mode:
        return self.ticks[-1].mode

    def passes(self, ticks: int = 25) -> list[Tick]:
        """Waits for some commands and returns them."""
        first = len(self.ticks)
        until(lambda: len(self.ticks) > first + ticks)
        return self.ticks[first:]

    def stays(self, mode: Mode) -> None:
        """Checks that the mode is this one now, and still is some commands later."""
        until(lambda: self.mode() is mode)
        assert {tick.mode for tick in self.passes(5)} == {mode}


@dataclass
class Stage:
    """A running loop and the session that a page has with it."""

    run: Running
    session: LiveSession

    @property
    def loop(self) -> TeleopLoop:
        return self.run.loop

    @property
    def ticks(self) -> list[Tick]:
        return self.run.ticks

    def mode(self) -> Mode:
        return self.run.mode()


@contextlib.contextmanager
def running(
    loop: TeleopLoop,
    see: Callable[[Tick], None] = lambda tick: None,
    started: Callable[[], None] = lambda: None,
) -> Iterator[Running]:
    """Runs a loop in a thread while the block runs; ``see`` gets each tick first."""
    built = Running(loop)

    def watch(tick: Tick) -> None:
        see(tick)
        built.ticks.append(tick)

    loop.watch = watch
    thread = threading.Thread(target=lambda: loop.run(started=started), daemon=True)
    with low_jitter():  # as in a run
        thread.start()
        until(lambda: built.ticks)
        yield built
        loop.controls.quit()
        thread.join(PATIENCE_S)
    assert not thread.is_alive()


def session_of(
    loop: TeleopLoop, switcher: MethodSwitcher, folder: Path = Path(), *sinks: Any, **more: Any
) -> LiveSession:
    """Makes the session of a page, as a run does."""
    takes = Takes(loop.sinks, folder / "takes", switcher.configuration)
    offered = actions(loop, {}, lambda text: None)
    return LiveSession(loop, sinks, switcher, takes, offered, **more)


@contextlib.contextmanager
def serving(host: str = "127.0.0.1") -> Iterator[Any]:
    """A server without reflections, which a software renderer takes seconds to prepare."""
    server = open_server(host, 0)
    server.scene.configure_environment_map(None)
    try:
        yield server
    finally:
        server.stop()


def panel_of(
    server: Any, hands: Mapping[Side, Hand], simulated: bool = False, blind: bool = False
) -> LivePanel:
    """The live page's scene and panel, whose clicks go nowhere."""
    stop = StopPanel(server, lambda _: None, attended=True)
    scene = LiveScene(server, hands, simulated)
    return LivePanel(server, hands, lambda *_: None, scene, stop, blind)
