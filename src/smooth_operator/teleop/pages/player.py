"""Player for retargeted recordings, on a local web page."""

from __future__ import annotations

import contextlib
import html
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import viser
from jaxtyping import Bool, Float

from smooth_operator.errors import ConfigError, HandModelError, RecordingError
from smooth_operator.hands.hand import Hand
from smooth_operator.landmarks import FINGERS, TIPS
from smooth_operator.metrics import Trace
from smooth_operator.metrics.pinches import pinched_frames
from smooth_operator.teleop.pages.front import GuardedServer
from smooth_operator.teleop.pages.hand_view import (
    Aiming,
    HandView,
    css,
    finger_colors,
    moved,
    plan,
    view_axes,
)
from smooth_operator.teleop.pages.scene import TRANSLUCENT, HandRow, RobotLooks
from smooth_operator.teleop.pages.viser_server import (
    PageServer,
    add_hotkeys,
    from_person,
    name_panel,
    read_script,
    serve_page,
)
from smooth_operator.types import Status


@dataclass(frozen=True, eq=False)
class Playback:
    """A retargeted recording for the player.

    Attributes:
        title: title of the page.
        hand: the robot hand.
        trace: the run, in the palm frame.
        drawn: the same hand on a model with meshes and the same joint names, in any order. The page
            then has a switch between meshes and simple shapes; None for simple shapes only.
        label: label above the robot; with several robots, it says how its motion was made.
        palms: (T, 7) poses of the palm relative to that at rest, for commands of wrist joints.

    Raises:
        RecordingError: the run has no frames.
        HandModelError: the robot's positions are not finite.
    """

    title: str
    hand: Hand
    trace: Trace
    drawn: Hand | None = None
    label: str = "robot"
    palms: Float[np.ndarray, "T 7"] | None = None

    def __post_init__(self) -> None:
        if not len(self.trace):
            raise RecordingError("there is nothing to play: the run has no frames")
        for name in ("joint_positions", "robot_tips", "robot_wrist"):
            if not np.isfinite(getattr(self.trace, name)).all():
                raise HandModelError(
                    f"{name} contains NaN or infinity; repeat the last valid value instead"
                )

    def __len__(self) -> int:
        return len(self.trace)

    @property
    def times(self) -> Float[np.ndarray, " T"]:
        """(T,) times since the first frame [s]."""
        return np.asarray(self.trace.stamps - self.trace.stamps[0])

    @property
    def tips(self) -> list[int]:
        """Indices of the human fingertip landmarks that drive the robot, thumb first."""
        return [TIPS[FINGERS.index(name)] for name in self.trace.fingers]

    def pinches(self) -> Bool[np.ndarray, "T G"]:
        """(T, F-1) True where the human pinches; False where the tracker lost the hand."""
        return pinched_frames(self.trace.human_tips)


def check_runs(runs: Sequence[Playback]) -> None:
    """Raises RecordingError if there are no runs, or if their frames or fingers differ."""
    if not runs:
        raise RecordingError("there is nothing to play: pass at least one run")
    first = runs[0]
    for run in runs[1:]:
        if not np.array_equal(run.trace.stamps, first.trace.stamps):
            raise RecordingError(
                f"the timestamps of {run.label!r} ({len(run)} frames) and {first.label!r} "
                f"({len(first)} frames) differ: retarget the same frames of one recording with "
                "both methods"
            )
        mine, theirs = (", ".join(each.trace.fingers) for each in (run, first))
        if mine != theirs:
            raise RecordingError(
                f"{run.label!r} drives {mine}, but {first.label!r} drives {theirs}: use runs with "
                "the same fingers"
            )


class PlaybackClock:
    """Converts wall time [s] to frames of a recording. A slow player skips frames to stay on
    time."""

    def __init__(
        self, times: Float[np.ndarray, " T"], speed: float = 1.0, loop: bool = True
    ) -> None:
        self._times = np.asarray(times, np.float64) - times[0]
        # the last frame is shown for the usual time, so a loop has no jump
        period = float(np.median(np.diff(self._times))) if len(self._times) > 1 else 0.0
        self._duration = float(self._times[-1]) + period
        self._speed, self.loop = speed, loop
        self._wall = self._time = 0.0

    def start(self, frame: int, now: float) -> None:
        """Sets the frame that is due at wall time ``now`` [s]."""
        self._time, self._wall = float(self._times[frame]), now

    def set_speed(self, speed: float, now: float) -> None:
        """Changes the speed at wall time ``now`` [s], without a jump."""
        self._time += (now - self._wall) * self._speed
        self._wall, self._speed = now, speed

    def frame(self, now: float) -> tuple[int, bool]:
        """The frame that is due at wall time ``now`` [s], and True if playback has ended."""
        time = self._time + (now - self._wall) * self._speed
        if time >= self._duration:
            if not self.loop or self._duration <= 0.0:
                return len(self._times) - 1, True
            time %= self._duration
        return max(int(np.searchsorted(self._times, time, side="right")) - 1, 0), False


SPEEDS = (0.1, 4.0)
"""Slowest and fastest playback, as a multiple of real time."""

_TICK = 1 / 60  # shortest time between two drawn frames [s], that of a display
_TEXT_TICK = 1 / 10  # the same for text and slider, which take a browser longer than poses
_REST = 0.3  # time after which a slider that does not move counts as released [s]


class PlaybackServer(PageServer):
    """Serves the player's page; see ``PageServer``. Any thread may call the controls; one thread
    draws.

    Args:
        playback: motion to show; several runs over the same frames are shown side by side.
        host: address to listen on. By default only this machine can reach the page; with another
            address, the token in ``url`` is required.
        port: first port to try; 0 for any free one.
        loop: start over at the end.
    """

    def __init__(
        self,
        playback: Playback | Sequence[Playback],
        host: str = "127.0.0.1",
        port: int = 8080,
        loop: bool = True,
    ) -> None:
        super().__init__(host, port)
        self.runs = (playback,) if isinstance(playback, Playback) else tuple(playback)
        check_runs(self.runs)
        self.playback = self.runs[0]
        self._clock = PlaybackClock(self.playback.times, loop=loop)
        self._changed = threading.Condition()
        self._frame, self._held_until = 0, 0.0
        self._jobs: list[Callable[[], None]] = []  # changes of the scene for the drawing thread
        self._playing, self._stopping, self._dirty = False, False, True
        self._thread: threading.Thread | None = None

    @property
    def title(self) -> str:
        """Title of the first run, which is the page's title."""
        return self.playback.title

    def _build(self, server: GuardedServer) -> None:
        server.front.scripts.append(read_script(__package__, "player.js"))
        self._scene = Scene(server, self.runs)
        self._panel = Panel(server.gui, self.runs, self, self._clock.loop)
        self._scene.draw(0)

    def _begin(self, server: viser.ViserServer) -> None:
        server.on_client_connect(self._greet)
        server.on_client_disconnect(self._forget)
        self._thread = threading.Thread(target=self._run, name="playback", daemon=True)
        self._thread.start()

    def _end(self) -> None:
        with self._changed:
            self._stopping = True
            self._changed.notify_all()
        if self._thread is not None:
            self._thread.join()
            self._thread = None

    @property
    def frame(self) -> int:
        """Index of the current frame."""
        return self._frame

    @property
    def playing(self) -> bool:
        """True during playback."""
        return self._playing

    def set_frame(self, index: int) -> None:
        """Shows a frame; negative numbers count from the end. Raises ConfigError if out of
        range."""
        count = len(self.playback)
        if not -count <= index < count:
            raise ConfigError(f"frame must be in {-count}..{count - 1}, not {index}")
        with self._change():
            self._go(index % count)

    def play(self) -> None:
        """Starts playback. If the last frame is shown, starts from the beginning."""
        with self._change():
            at_end = self._frame == len(self.playback) - 1
            self._go(0 if at_end else self._frame)
            self._playing = True

    def pause(self) -> None:
        """Stops at the current frame."""
        with self._change():
            self._playing = False

    def toggle(self) -> None:
        """Starts or pauses playback."""
        (self.pause if self._playing else self.play)()

    def step(self, frames: int) -> None:
        """Pauses and moves by a number of frames; wraps around if playback loops."""
        with self._change():
            self._playing = False
            count, target = len(self.playback), self._frame + frames
            self._go(target % count if self._clock.loop else min(max(target, 0), count - 1))

    def scrub(self, frame: int) -> None:
        """Goes to the slider's frame. Playback continues when the slider stops moving."""
        with self._change():
            self._go(min(max(int(frame), 0), len(self.playback) - 1))
            self._held_until = time.monotonic() + _REST

    def set_speed(self, speed: float) -> None:
        """Sets the playback speed relative to real time; ConfigError outside 0.1 to 4."""
        if not SPEEDS[0] <= speed <= SPEEDS[1]:
            raise ConfigError(f"speed must be in {SPEEDS[0]}..{SPEEDS[1]}, not {speed}")
        with self._change():
            self._clock.set_speed(speed, time.monotonic())

    def set_loop(self, loop: bool) -> None:
        """Sets whether playback starts over at the end or stops there."""
        with self._change():
            self._clock.start(self._frame, time.monotonic())
            self._clock.loop = loop

    def set_overlay(self, overlay: bool) -> None:
        """Shows all hands in one place, or side by side."""
        with self._change():
            self._jobs.append(lambda: self._scene.set_overlay(overlay))

    def set_keyvectors(self, visible: bool) -> None:
        """Shows or hides the thumb-to-tip lines."""
        with self._change():
            self._jobs.append(lambda: self._scene.row.set_keyvectors(visible))

    def set_meshes(self, visible: bool) -> None:
        """Shows the vendors' meshes or simple shapes."""
        with self._change():
            self._jobs.append(lambda: self._scene.set_meshes(visible))

    def aim(self, client: viser.ClientHandle) -> None:
        """Resets one browser's camera."""
        self._scene.aiming.aim(client)

    @contextlib.contextmanager
    def _change(self) -> Iterator[None]:
        with self._changed:
            yield
            self._dirty = True
            self._changed.notify_all()

    def _go(self, frame: int) -> None:
        self._frame = frame
        self._clock.start(frame, time.monotonic())

    async def _greet(self, client: viser.ClientHandle) -> None:
        self._scene.aiming.greet(client)
        with self._change():  # without a browser nothing was drawn
            pass

    async def _forget(self, client: viser.ClientHandle) -> None:
        self._scene.aiming.forget(client)

    def _run(self) -> None:
        assert self._server is not None
        try:
            next_text = 0.0
            while True:
                with self._changed:
                    self._tick(time.monotonic())
                    if self._stopping:
                        return
                    jobs, self._jobs = self._jobs, []
                    frame, playing, dirty = self._frame, self._playing, self._dirty
                    self._dirty = False
                begun = time.monotonic()
                text = dirty or begun >= next_text
                if dirty or self._server.get_clients():
                    self._draw(frame, playing, jobs, text)
                if text:
                    next_text = begun + _TEXT_TICK
                with self._changed:
                    if self._playing or self._dirty:
                        # at the rate of a display, also in a burst of slider events
                        rest = max(begun + _TICK - time.monotonic(), 0.0)
                        self._changed.wait_for(lambda: self._stopping, rest)
                    else:
                        self._changed.wait_for(lambda: self._dirty or self._stopping)
        except BaseException as error:  # wait() raises it in the caller's thread
            self._error = error
            self._ended.set()

    def _tick(self, now: float) -> None:
        if not self._playing:
            return
        if now < self._held_until:
            self._clock.start(self._frame, now)
            return
        self._frame, over = self._clock.frame(now)
        if over:
            self._playing, self._dirty = False, True

    def _draw(self, frame: int, playing: bool, jobs: list[Callable[[], None]], text: bool) -> None:
        assert self._server is not None
        with self._server.atomic():
            for job in jobs:
                job()
            self._scene.draw(frame)
            if text:
                self._panel.show(frame, playing)
        self._server.flush()


def serve(
    playback: Playback | Sequence[Playback],
    *,
    host: str = "127.0.0.1",
    port: int = 8080,
    open_browser: bool = True,
    block: bool = True,
) -> PlaybackServer:
    """Shows a recording in the browser.

    Args:
        playback: motion to show; several runs over the same frames are shown side by side.
        host: address to listen on; by default only this machine can reach it.
        port: first port to try. The page's address is printed.
        open_browser: open the page if there is a desktop.
        block: wait for Ctrl-C and stop the server; otherwise the caller stops it.

    Returns:
        The server: stopped if ``block``, running otherwise.

    Raises:
        ConfigError: the address is not one of this machine's, or no port is free.
        RecordingError: several runs have different frames or fingers.
    """
    server = PlaybackServer(playback, host=host, port=port).start()
    server.play()
    return serve_page(server, "playing at", open_browser=open_browser, block=block)


class Scene:
    """3D scene with the human hand of the first run, and the robot hand of each run."""

    def __init__(self, server: viser.ViserServer, runs: Sequence[Playback]) -> None:
        self._runs = tuple(runs)
        first = self._runs[0]
        self._pinches = first.pinches()
        scene = server.scene
        words = {"human": "human"} | {f"robot_{i}": run.label for i, run in enumerate(self._runs)}
        self.row = HandRow(
            scene, "", first.tips, words, anchor="bottom-center", font_screen_scale=1.25
        )
        axes = view_axes(HandView(first.hand, simple=True))
        self.robots = [
            RobotLooks(scene, run.hand, _views(run), f"/robot_{i}/look", distal=axes[1])
            for i, run in enumerate(self._runs)
        ]
        bounds = [_bounds(run, robot) for run, robot in zip(runs, self.robots, strict=True)]
        layout = self._layout = plan(axes, first.trace.human, first.trace.robot_wrist, *bounds)
        for label, top in zip(self.row.labels.values(), layout.tops, strict=True):
            label.position = top
        self.aiming = Aiming(server, axes, layout.centre, layout.half)
        self.set_overlay(False)

    def draw(self, frame: int) -> None:
        """Shows all hands in one frame."""
        roots = [*self.row.roots.values()][1:]
        for run, robot, root, place in zip(
            self._runs, self.robots, roots, self._places, strict=True
        ):
            robot.draw(run.trace.joint_positions[frame])
            if run.palms is not None:
                root.position = place + run.palms[frame, :3]
                root.wxyz = run.palms[frame, 3:]
        tips = [run.trace.robot_tips[frame] for run in self._runs]
        self.row.draw(self._runs[0].trace.human[frame], tips, self._pinches[frame])

    def set_overlay(self, overlay: bool) -> None:
        """Shows all hands in one place, or side by side."""
        shifts = (self._layout.human_shift, *self._layout.robot_shifts)
        places = [np.zeros(3) if overlay else shift for shift in shifts]
        for root, place in zip(self.row.roots.values(), places, strict=True):
            root.position = place
        self._places = places[1:]
        for label in self.row.labels.values():
            label.visible = not overlay
        for robot in self.robots:
            robot.show(opacity=TRANSLUCENT if overlay else None)

    def set_meshes(self, visible: bool) -> None:
        """Draws the vendors' meshes or simple shapes, if a run has both."""
        for robot in self.robots:
            robot.show(meshes=visible)


def _views(run: Playback) -> list[HandView]:
    """The models with which the robot can be drawn, simple shapes last."""
    return [*([HandView(run.drawn)] if run.drawn else []), HandView(run.hand, simple=True)]


def _bounds(run: Playback, robot: RobotLooks) -> Float[np.ndarray, "N 3"]:
    """(N, 3) fingertips, and corners of the bodies at 16 frames, in the palm frame [m]."""
    frames = np.unique(np.linspace(0, len(run) - 1, 16).astype(int))
    corners = [robot.shown.corners(run.trace.joint_positions[frame]) for frame in frames]
    tips = run.trace.robot_tips
    if run.palms is not None:
        corners = [moved(run.palms[i], each) for i, each in zip(frames, corners, strict=True)]
        tips = moved(run.palms[:, None], tips)
    return np.concatenate([tips.reshape(-1, 3), *corners])


_PLAY, _PAUSE = "Play (Space)", "Pause (Space)"
_STEPS: Final = {"−1 (J)": -1, "+1 (L)": 1}


class Panel:
    """Control panel of the player."""

    def __init__(
        self, gui: viser.GuiApi, runs: Sequence[Playback], controls: PlaybackServer, loop: bool
    ) -> None:
        self._runs = runs
        name_panel(gui, runs[0].title)
        self._status = gui.add_html(status_line(runs, 0))
        last = len(runs[0]) - 1
        self._slider: Any = gui.add_slider(
            "Frame", min=0, max=max(last, 1), step=1, initial_value=0, disabled=last == 0
        )
        self._play = gui.add_button(_PLAY, icon=viser.Icon.PLAYER_PLAY, hint="also K")
        step = gui.add_button_group("Step", tuple(_STEPS))
        slow, fast = SPEEDS
        speed = gui.add_slider("Speed", slow, fast, 0.1, initial_value=1.0, hint="times real time")
        looping = gui.add_checkbox("Loop", loop)
        overlay = gui.add_checkbox("Overlay", False, hint="all hands in one place")
        vectors = gui.add_checkbox("Keyvectors", True, hint="thumb tip to fingertips")
        values = [
            (self._slider, controls.scrub),
            (speed, controls.set_speed),
            (looping, controls.set_loop),
            (overlay, controls.set_overlay),
            (vectors, controls.set_keyvectors),
        ]
        if any(run.drawn is not None for run in runs):
            hint = "show the vendor's meshes or simple shapes"
            values.append((gui.add_checkbox("Meshes", True, hint=hint), controls.set_meshes))
        view = gui.add_button("Reset view", color="gray", icon=viser.Icon.FOCUS_CENTERED)
        gui.add_html(legend(runs[0].trace.fingers))

        for handle, use in values:
            handle.on_update(from_person(lambda event, use=use: use(event.target.value)))
        self._play.on_click(from_person(lambda _: controls.toggle()))
        step.on_click(from_person(lambda event: controls.step(_STEPS[event.target.value])))
        view.on_click(from_person(lambda event: controls.aim(event.client)))
        # Arrow keys move the slider that has the focus. ``player.js`` sends Space as K.
        add_hotkeys(
            gui,
            ("Play / pause", "K", controls.toggle),
            ("Step back", "J", lambda: controls.step(-1)),
            ("Step forward", "L", lambda: controls.step(1)),
        )
        gui.main_panel.dock_right()

    def show(self, frame: int, playing: bool) -> None:
        """Updates the status line, the slider and the play button."""
        self._status.content = status_line(self._runs, frame)
        self._slider.value = frame
        self._play.label = _PAUSE if playing else _PLAY
        self._play.icon = viser.Icon.PLAYER_PAUSE if playing else viser.Icon.PLAYER_PLAY


def status_line(runs: Sequence[Playback], frame: int) -> str:
    """Lines under the title, as HTML: frame and time, then each run's status and solving time."""
    times = runs[0].times
    parts = (
        f"<b>frame {frame}</b>/{len(times) - 1}",
        f"<b>{times[frame]:.2f}</b>/{times[-1]:.2f} s",
    )
    lines = [_status_text(run, frame, named=len(runs) > 1) for run in runs]
    return (
        f'<div id="playback-status" data-frame="{frame}" role="status" '
        'style="padding:0.4em 0.8em;font-size:0.875em;font-variant-numeric:tabular-nums">'
        f"{' · '.join(parts)}<br>{'<br>'.join(lines)}</div>"
    )


def _status_text(run: Playback, frame: int, named: bool) -> str:
    try:
        status = Status(int(run.trace.status[frame]))
        good = status is Status.OK
        reason = "frame used" if good else status.reason
    except ValueError:  # a file of a newer release
        reason, good = f"status {int(run.trace.status[frame])}", False
    latency = run.trace.latency_ms[frame]
    time = f"solved in {latency:.2f} ms" if np.isfinite(latency) else "solving time unknown"
    name = f"{html.escape(run.label)}: " if named else ""
    return f"{name}<b>{'✓' if good else '⚠'}</b> {html.escape(reason)} · {time}"


def legend(fingers: Sequence[str]) -> str:
    """Legend of the fingers' colours, as HTML."""
    chips = "".join(
        f'<span style="white-space:nowrap;margin-right:0.7em"><span style="color:{css(color)}">⬤'
        f"</span> {html.escape(name)}</span>"
        for name, color in zip(fingers, finger_colors(len(fingers)), strict=True)
    )
    return f'<div style="padding:0 0.8em 0.5em;font-size:0.75em">{chips}</div>'
