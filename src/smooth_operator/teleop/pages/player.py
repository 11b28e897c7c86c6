"""The player: a local web page that shows a ``Playback``, in real time, from one thread."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Iterator, Sequence

import viser

from smooth_operator.errors import ConfigError
from smooth_operator.teleop.pages.playback import Playback, PlaybackClock, check_runs
from smooth_operator.teleop.pages.player_panel import HEIGHT, SPEEDS, Panel
from smooth_operator.teleop.pages.player_scene import Scene
from smooth_operator.teleop.pages.viser_server import PageServer, serve_page

_TICK = 1 / 60  # shortest time between two drawn frames [s]: what a display shows
_TEXT_TICK = 1 / 10  # same for text, slider and plot, which cost the browser far more than poses
_REST = 0.3  # a slider that has not moved for this long was released [s]


class PlaybackServer(PageServer):
    """Serves the page; controls work from any thread, drawing happens in one.

    Use as a context manager, or call ``start`` and ``stop``.

    Args:
        playback: what to show; several runs over the same frames stand side by side.
        host: address to listen on. The default is reachable from this machine only; any other
            wants the token that is in ``url``.
        port: first port to try; the next free one is taken, see ``url``. 0: any free one.
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
        self._frame = 0
        self._playing = False
        self._held_until = 0.0
        self._jobs: list[
            Callable[[], None]
        ] = []  # changes of the scene, done by the drawing thread
        self._dirty = True
        self._stopping = False
        self._thread: threading.Thread | None = None

    # -- life ---------------------------------------------------------------------------------

    def _build(self, server: viser.ViserServer) -> None:
        self._scene = Scene(server, self.runs, below=HEIGHT)
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

    # -- state --------------------------------------------------------------------------------

    @property
    def frame(self) -> int:
        """Index of the frame that is shown, or about to be."""
        return self._frame

    @property
    def playing(self) -> bool:
        """Whether time runs."""
        return self._playing

    # -- controls -----------------------------------------------------------------------------

    def set_frame(self, index: int) -> None:
        """Show a frame; playback, if it runs, goes on from there.

        Args:
            index: 0 .. T-1, or negative to count from the end.

        Raises:
            ConfigError: if there is no such frame.
        """
        count = len(self.playback)
        if not -count <= index < count:
            raise ConfigError(f"frame must be in {-count}..{count - 1}, not {index}")
        with self._change():
            self._go(index % count)

    def play(self) -> None:
        """Let time run; at the last frame, from the beginning."""
        with self._change():
            at_end = self._frame == len(self.playback) - 1
            self._go(0 if at_end else self._frame)
            self._playing = True

    def pause(self) -> None:
        """Hold the current frame."""
        with self._change():
            self._playing = False

    def toggle(self) -> None:
        """Play if paused, pause if playing."""
        (self.pause if self._playing else self.play)()

    def step(self, frames: int) -> None:
        """Pause and move by some frames; the ends wrap around if looping."""
        with self._change():
            self._playing = False
            count, target = len(self.playback), self._frame + frames
            self._go(target % count if self._clock.loop else min(max(target, 0), count - 1))

    def scrub(self, frame: int) -> None:
        """Go to a frame by hand: if playing, time waits until the slider rests."""
        with self._change():
            self._go(min(max(int(frame), 0), len(self.playback) - 1))
            self._held_until = time.monotonic() + _REST

    def set_speed(self, speed: float) -> None:
        """Set playback seconds per second.

        Raises:
            ConfigError: outside 0.1 .. 4.
        """
        if not SPEEDS[0] <= speed <= SPEEDS[1]:
            raise ConfigError(f"speed must be in {SPEEDS[0]}..{SPEEDS[1]}, not {speed}")
        with self._change():
            self._clock.set_speed(speed, time.monotonic())

    def set_loop(self, loop: bool) -> None:
        """Start over at the end, or stop there."""
        with self._change():
            self._clock.start(self._frame, time.monotonic())
            self._clock.loop = loop

    def set_overlay(self, overlay: bool) -> None:
        """Put all hands in one place, or side by side."""
        with self._change():
            self._jobs.append(lambda: self._scene.set_overlay(overlay))

    def set_keyvectors(self, visible: bool) -> None:
        """Show or hide the thumb-to-tip lines."""
        with self._change():
            self._jobs.append(lambda: self._scene.set_keyvectors(visible))

    def set_meshes(self, visible: bool) -> None:
        """Show the makers' meshes, or simple shapes."""
        with self._change():
            self._jobs.append(lambda: self._scene.set_meshes(visible))

    def aim(self, client: viser.ClientHandle) -> None:
        """Reset one browser's camera."""
        self._scene.aim(client)

    # -- inside -------------------------------------------------------------------------------

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
        self._scene.greet(client)
        self._fit(client.client_id, client.camera.image_width)

        async def fit(camera: viser.CameraHandle) -> None:
            self._fit(client.client_id, camera.image_width)

        client.camera.on_update(fit)
        with self._change():  # while nobody watched, nothing was drawn
            pass

    async def _forget(self, client: viser.ClientHandle) -> None:
        self._scene.forget(client)
        self._fit(client.client_id, None)

    def _fit(self, client: int, canvas_width: float | None) -> None:
        with self._change():  # browsers come and go on their own threads
            self._jobs.append(lambda: self._panel.fit(client, canvas_width))

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
                if dirty or self._server.get_clients():  # else nobody watches: only time runs
                    self._draw(frame, playing, jobs, text)
                if text:
                    next_text = begun + _TEXT_TICK
                with self._changed:
                    if self._playing or self._dirty:
                        # at display rate, also for a burst of slider events
                        rest = max(begun + _TICK - time.monotonic(), 0.0)
                        self._changed.wait_for(lambda: self._stopping, rest)
                    else:
                        self._changed.wait_for(lambda: self._dirty or self._stopping)
        except BaseException as error:  # handed to wait(): a thread has nobody to raise to
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
                self._panel.show_frame(frame)
                self._panel.show_playing(playing)
        self._server.flush()


def serve(
    playback: Playback | Sequence[Playback],
    *,
    host: str = "127.0.0.1",
    port: int = 8080,
    open_browser: bool = True,
    block: bool = True,
) -> PlaybackServer:
    """Show a recording in the browser.

    Args:
        playback: what to show; several runs over the same frames stand side by side.
        host: address to listen on; this machine only by default.
        port: first port to try; the one that was free is printed.
        open_browser: open the page, where there is a desktop to open it on.
        block: return only after Ctrl-C; otherwise immediately, and the caller stops the server.

    Returns:
        The server: stopped if ``block``, running otherwise.

    Raises:
        ConfigError: if the address is not one of this machine's, or no port is free.
        RecordingError: if several runs are not of the same frames and fingers.
    """
    server = PlaybackServer(playback, host=host, port=port).start()
    server.play()
    return serve_page(server, "playing at", open_browser=open_browser, block=block)
