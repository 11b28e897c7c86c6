"""Lets other programs send commands to a running loop (``teleop --control``): server and handlers.

A message is a command, or a JSON object with ``do``: ``stop``, ``release``, ``pause``, ``resume``,
``quit``, ``status`` and

    {"do": "method", "method": "dexpilot", "preset": "published"}
        Switches to another method; without a preset, uses its default one. The old method continues
        while the new one is compiled. The answer comes when the new one drives the hands:
        {"ok": true, "method": "dexpilot", "preset": "published"}.
    {"do": "calibration", "path": "operator.json"}
        Uses an operator's calibration for the hand of its side; without a path, no calibration:
        {"ok": true, "method": ..., "preset": ..., "side": "right", "hand": "mimic_p050"}.
    {"do": "rate", "rate": 30}
        Sets the number of commands per second: {"ok": true, "rate": 30.0}.
    {"do": "wrist", "engage": false}
        Releases the clutch of the wrist while the fingers continue to follow; true engages it:
        {"ok": true, "engage": false}.
    {"do": "task", "task": "card"}
        Loads the scene of a task, given by its name or its letter in the paper (A, B, C); without a
        task, the hand alone: {"ok": true, "task": "card", "title": ..., "instruction": ...,
        "time_limit_s": 60.0}. With "object": false the object appears when a trial begins.
    {"do": "trial"}
        Reports the trial. "begin": true begins one: the object is put at its start, and the entries
        of "about": {...} go into its record. With "when_clear": true its clock starts when the hand
        has been clear of the object for half a second ("phase" is waiting until then).
        "limit_s": 45 replaces the task's time limit. "finish": true ends the trial. "cancel": true
        discards it;
        with "mark": "undone" or "void" it marks the record of an ended trial whose entries match
        "about". "pause": true stops hand, scene and clock, and "resume": true continues. "side"
        chooses one of two hands:
        {"ok": true, "task": "card", "phase": "running", "elapsed_s": 3.2, "score": 0.0,
         "line": "not-done", "text": ..., "reason": "on the table", "time_s": null, "ended": null,
         "resets": 0, "number": 1, "placed": true, "paused": false, "pauses": 0, "side": "right"}.
        "phase" is ready, running or done; score, line and time_s are final only when it is done.
    {"do": "reset"}
        Uses up the single reset of a running trial; without a trial, just puts the object back. The
        answer is that of "trial".

"status" answers "method", "preset", "rate" (as requested), "sides", "hand", "blind", "building"
(the method that is being compiled), "compiling" (sides whose robot holds until their method is
compiled), "source" {"label", "state", "detail"}, "sinks", "operators" {side: origin of the
calibration}, "simulation" (true if there is one that can have a task), "task" and "trial" (null
without a task or trial), "object" (true if the object is in the scene) and the loop's "modes" and
"rate_hz".
"""

from __future__ import annotations

import contextlib
import math
import queue
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple, TypeAlias

from smooth_operator.calibration.operator_file import OperatorProfile, read_operator
from smooth_operator.errors import ConfigError, MissingExtraError, SmoothOperatorError, SourceError
from smooth_operator.io.documents import json_object
from smooth_operator.io.jsonable import to_json
from smooth_operator.teleop.control.method_switcher import DriverSpec, MethodSwitcher
from smooth_operator.teleop.runtime.loop import TeleopLoop
from smooth_operator.terminal import print_note
from smooth_operator.types import Side

if TYPE_CHECKING:
    from smooth_operator.simulation.tasks.task_session import TrialRunner


RpcHandler: TypeAlias = Callable[[Mapping[str, Any]], Mapping[str, Any]]
"""Function that carries out a command: takes the fields of the message and returns those of the
answer. If it raises ``SmoothOperatorError``, the answer has the error's message."""
Reply: TypeAlias = Callable[[bytes], None]
"""Function that sends an answer; may be called from any thread."""

_PATIENCE_S: Final = 0.5
"""Longest time that an answer waits for the loop to carry out a command [s]."""
_MOST_RUNNING: Final = 16
"""Largest number of running commands; further ones are refused."""
_MOST_QUEUED: Final = 4096
"""Largest number of waiting messages; further ones are refused."""
_SILENT: Final = "the loop does not answer: it is still starting, or it has stopped responding"
_TOO_MUCH: Final = "too many messages are waiting or in progress"


class _Message(NamedTuple):
    """A message in the queue."""

    command: str
    fields: Mapping[str, Any]
    reply: Reply


class _Switched(NamedTuple):
    """A switch that the loop has not confirmed yet."""

    done: threading.Event
    until: float
    reply: Reply


class RpcServer:
    """Carries out the commands in messages. One thread uses it; replies may come from other
    threads.

    A stop is carried out on receipt, before all waiting messages. A release that is still waiting
    when a stop arrives is refused, since it was meant for an earlier stop.

    Args:
        loop: the loop.
        handlers: further command -> its handler.
        status: returns further fields of the status; must be quick.
    """

    def __init__(
        self,
        loop: TeleopLoop,
        handlers: Mapping[str, RpcHandler] = {},
        status: Callable[[], Mapping[str, Any]] = dict,
    ) -> None:
        controls = loop.controls
        self._loop, self._handlers, self._status = loop, dict(handlers), status
        self._switches: dict[str, Callable[[], None]] = {
            "stop": controls.stop,
            "release": controls.release,
            "pause": controls.pause,
            "resume": controls.resume,
        }
        self._waiting: deque[_Message] = deque()
        self._unconfirmed: list[_Switched] = []
        self._under_way: list[str] = []

    @property
    def commands(self) -> tuple[str, ...]:
        """Names of all commands."""
        return (*self._switches, "quit", "status", *self._handlers)

    @property
    def queued(self) -> bool:
        """True if a message waits for its ``turn``."""
        return bool(self._waiting)

    @property
    def idle(self) -> bool:
        """True if no message is waiting and no method switch is waiting for its reply."""
        return not self._waiting and not self._unconfirmed

    def hear(self, message: bytes, reply: Reply) -> None:
        """Receives a message. A stop is carried out at once; other commands wait for ``turn``.

        Args:
            message: a command, or a JSON object with ``do``.
            reply: called once with the answer, from any thread, now or later.
        """
        read = _read(message)
        if read is None or read[0] not in self.commands:
            shown = message[:60].decode(errors="replace")
            reply(_refusal(f"can't do {shown!r}; expected one of {', '.join(self.commands)}"))
            return
        heard = _Message(*read, reply)
        if heard.command == "stop":
            self._switch(heard)
            for late in [waiting for waiting in self._waiting if waiting.command == "release"]:
                self._waiting.remove(late)
                late.reply(_refusal("an emergency stop arrived in the meantime; release it again"))
        elif len(self._waiting) >= _MOST_QUEUED:
            reply(_refusal(_TOO_MUCH))
        else:
            self._waiting.append(heard)

    def turn(self) -> None:
        """Carries out the oldest waiting command, and replies to method switches that are
        complete."""
        if self._waiting:
            message = self._waiting.popleft()
            try:
                self._do(message)
            except Exception as error:  # the next message may be a stop
                message.reply(_failure(message.command, error))
        self._confirm(time.monotonic())

    def finish(self) -> None:
        """Replies to all waiting messages at the end of the run."""
        while self._waiting:
            self._waiting.popleft().reply(_refusal("the run has ended"))
        self._confirm(math.inf)

    def _confirm(self, now: float) -> None:
        for switched in list(self._unconfirmed):
            if switched.done.is_set() or now > switched.until:
                self._unconfirmed.remove(switched)
                done = switched.done.is_set()
                switched.reply(_encoded(self._modes()) if done else _refusal(_SILENT))

    def _do(self, message: _Message) -> None:
        if message.command in self._switches:
            self._switch(message)
        elif message.command == "quit":
            self._loop.controls.quit()
            message.reply(_encoded(self._modes()))
        elif message.command == "status":
            # Not through the loop's thread, which would have to send a command for it.
            silent = self._loop.silent_s > max(_PATIENCE_S, 3 * self._loop.config.period)
            if silent:
                message.reply(_refusal(_SILENT))
                return
            status = {**self._modes(), **self._status(), "busy": list(self._under_way)}
            message.reply(_encoded(status))
        elif len(self._under_way) >= _MOST_RUNNING:
            message.reply(_refusal(_TOO_MUCH))
        else:
            self._under_way.append(message.command)
            threading.Thread(
                target=lambda: message.reply(self._done(message)),
                name=f"remote {message.command}",
                daemon=True,
            ).start()

    def _switch(self, message: _Message) -> None:
        """Carry out a switch; the loop carries out switches in order, but a stop at once."""
        self._switches[message.command]()
        done = threading.Event()
        self._loop.controls.change(lambda hand: done.set())
        until = time.monotonic() + _PATIENCE_S
        self._unconfirmed.append(_Switched(done, until, message.reply))

    def _modes(self) -> dict[str, Any]:
        modes = {side: hand.mode_now.value for side, hand in self._loop.pipelines.items()}
        return {"ok": True, "modes": modes, "rate_hz": self._loop.statistics.rate_hz}

    def _done(self, message: _Message) -> bytes:
        """Carry out any other command; called on a thread of its own."""
        try:
            return _encoded({"ok": True, **self._handlers[message.command](message.fields)})
        except SmoothOperatorError as error:
            return _refusal(str(error))
        except Exception as error:  # the caller must get an answer
            return _failure(message.command, error)
        finally:
            self._under_way.remove(message.command)


def _read(message: bytes) -> tuple[str, Mapping[str, Any]] | None:
    """(command, fields) of a message; None if it can't be read."""
    try:
        text = message.decode().strip()
    except UnicodeDecodeError:
        return None
    fields = json_object(text) if text.startswith("{") else {"do": text}
    if fields is None or not isinstance(command := fields.get("do"), str):
        return None
    return command, fields


def _refusal(error: str) -> bytes:
    return _encoded({"ok": False, "error": error})


def _failure(command: str, error: Exception) -> bytes:
    return _refusal(f"{command}: {type(error).__name__}: {error}")


def _encoded(answer: Mapping[str, Any]) -> bytes:
    return to_json(answer).encode()


_TURN_MS: Final = 20
_SOON_MS: Final = 1  # while an answer waits for the loop
_LARGEST: Final = 1 << 16  # [bytes]
_FRAMES: Final = 8
"""Largest number of parts of a message: one address per relay, an empty part and the command."""
_BATCH: Final = 256
"""Largest number of messages to receive before the next one is carried out."""
_END_S: Final = 2.0


@contextlib.contextmanager
def remote(
    loop: TeleopLoop,
    address: str,
    handlers: Mapping[str, RpcHandler] = {},
    status: Callable[[], Mapping[str, Any]] = dict,
) -> Iterator[str]:
    """Accepts commands of other programs while the loop runs.

    Args:
        address: address on which to listen, such as ``tcp://127.0.0.1:5558``;
            ``tcp://127.0.0.1:*`` uses any free port.
        handlers: further command -> its handler, which runs on a thread of its own.
        status: returns further fields of the status; must be quick.

    Yields:
        the address.

    Raises:
        MissingExtraError: pyzmq is not installed.
        SourceError: the address can't be listened on.
    """
    context, socket = _listening(address)
    bound = str(socket.last_endpoint.decode()).rstrip("\0")
    server = RpcServer(loop, handlers, status)
    answers: queue.SimpleQueue[list[bytes]] = queue.SimpleQueue()
    done = threading.Event()

    def send_all() -> None:
        with contextlib.suppress(queue.Empty):
            while True:
                socket.send_multipart(answers.get_nowait())

    def reply_to(envelope: list[bytes]) -> Reply:
        return lambda text: answers.put([*envelope, text])

    def hear() -> None:
        """Receive pending messages, so that a stop overtakes earlier messages."""
        for _ in range(_BATCH):
            if not socket.poll(0):
                return
            frames = socket.recv_multipart()
            if len(frames) <= _FRAMES:
                *envelope, message = frames
                server.hear(message, reply_to(envelope))

    def listen() -> None:
        try:
            while not done.is_set():
                if server.idle:
                    socket.poll(_TURN_MS)
                elif not server.queued:
                    socket.poll(_SOON_MS)
                try:
                    hear()
                    server.turn()
                    send_all()
                except Exception as error:  # no message may end the listening
                    print_note(f"note: {address}: {type(error).__name__}: {error}")
            server.finish()
            send_all()
        finally:
            socket.close()

    thread = threading.Thread(target=listen, name="remote", daemon=True)
    thread.start()
    try:
        yield bound
    finally:
        done.set()
        thread.join(_END_S)
        if not thread.is_alive():  # the context waits for its sockets to be closed
            context.term()


def check_address(address: str) -> None:
    """Checks that ``remote`` can listen on an address, before any slow preparation.

    Raises:
        MissingExtraError, SourceError: as ``remote``.
    """
    context, socket = _listening(address)
    socket.close(0)
    context.term()


def _listening(address: str) -> tuple[Any, Any]:
    """A ZeroMQ context with a socket that listens on an address."""
    try:
        import zmq
    except ImportError:
        raise MissingExtraError(
            "listening for commands of other programs (--control)", "zmq"
        ) from None
    context = zmq.Context()
    # ROUTER, since with REP a stop would wait for the answer to the previous message.
    socket = context.socket(zmq.ROUTER)
    socket.setsockopt(zmq.LINGER, 200)
    socket.setsockopt(zmq.MAXMSGSIZE, _LARGEST)
    try:
        socket.bind(address)
    except zmq.ZMQError as error:
        socket.close()
        context.term()
        raise SourceError(
            f"can't listen for messages on {address!r} ({error}); an address looks like "
            "tcp://127.0.0.1:5558"
        ) from error
    return context, socket


_LOOK_S: Final = 0.5
"""Interval of the checks whether the run continues [s]."""


class RpcHandlers:
    """Carries out the commands that other programs send to a running loop.

    Args:
        loop: the loop.
        switcher: switcher of its methods.
        runner: returns the trial runner of the simulation, or None; called for every command.
        blind: True if the operator must not know the method; for the status.
    """

    def __init__(
        self,
        loop: TeleopLoop,
        switcher: MethodSwitcher,
        runner: Callable[[], TrialRunner | None] = lambda: None,
        *,
        blind: bool = False,
    ) -> None:
        self._loop, self._switcher, self._runner, self._blind = loop, switcher, runner, blind

    @property
    def by_command(self) -> dict[str, RpcHandler]:
        """Maps the name of each command to the function that carries it out."""
        return {
            "method": self._method,
            "calibration": self._calibration,
            "rate": self._rate,
            "wrist": self._wrist,
            "task": self._task,
            "trial": self._trial,
            "reset": self._reset,
        }

    def status(self) -> dict[str, Any]:
        """Status of the run, read without a request to the loop."""
        loop, switcher, runner = self._loop, self._switcher, self._runner()
        used = switcher.used
        task = None if runner is None else runner.task
        trial = None
        if runner is not None and task is not None:
            try:
                trial = runner.report()
            except SmoothOperatorError:  # the scene is just being changed
                task = None
        return {
            "method": used.method,
            "preset": used.preset,
            "rate": loop.config.rate,
            "building": switcher.building,
            "compiling": [s for s, hand in loop.pipelines.items() if hand.supervisor.compiling],
            "blind": self._blind,
            "sides": list(loop.pipelines),
            "hand": next(iter(loop.pipelines.values())).retargeter.hand.name,
            "source": {"label": loop.source.label, **asdict(loop.source.health())},
            "sinks": [asdict(health) for health in loop.sinks.health()],
            "operators": {
                side: None if operator is None else operator.source
                for side, operator in switcher.operators.items()
            },
            "simulation": runner is not None,
            "task": None if task is None else task.name,
            "object": runner is not None and task is not None and runner.object_there,
            "trial": trial,
        }

    def _method(self, fields: Mapping[str, Any]) -> dict[str, Any]:
        method, preset = _text(fields, "method"), _text(fields, "preset")
        if method is None:
            raise ConfigError('name the method: {"do": "method", "method": "dexpilot"}')
        return _driven(self._await(self._switcher.choose(method, preset)))

    def _calibration(self, fields: Mapping[str, Any]) -> dict[str, Any]:
        path = _text(fields, "path")
        if path is None:
            none: dict[Side, OperatorProfile | None] = dict.fromkeys(self._loop.pipelines)
            return _driven(self._await(self._switcher.operate(none)))
        operator = read_operator(Path(path))
        spec = self._await(self._switcher.operate({operator.side: operator}))
        return {**_driven(spec), "side": operator.side}

    def _rate(self, fields: Mapping[str, Any]) -> dict[str, Any]:
        rate = fields.get("rate")
        if isinstance(rate, bool) or not isinstance(rate, int | float):
            raise ConfigError(f"rate: expected a number of commands per second, not {rate!r}")
        self._loop.pace(float(rate))
        return {"rate": self._loop.config.rate}

    def _wrist(self, fields: Mapping[str, Any]) -> dict[str, Any]:
        engage = fields.get("engage")
        if not isinstance(engage, bool):
            raise ConfigError(f"engage: expected true or false, not {engage!r}")
        self._loop.controls.follow(engage)
        return {"engage": engage}

    def _task(self, fields: Mapping[str, Any]) -> dict[str, Any]:
        there = fields.get("object", True)
        if not isinstance(there, bool):
            raise ConfigError(f"object: expected true or false, not {there!r}")
        loaded = self._open_runner().change(_text(fields, "task"), there)
        if loaded is None:
            return {"task": None}
        task = loaded.task
        return {
            "task": loaded.name,
            "title": task.title,
            "instruction": task.instruction,
            "time_limit_s": task.time_limit_s,
            "rubric": [asdict(line) for line in task.rubric],
        }

    def _trial(self, fields: Mapping[str, Any]) -> dict[str, Any]:
        runner = self._open_runner()
        actions = [
            word for word in ("begin", "finish", "cancel", "pause", "resume") if fields.get(word)
        ]
        if len(actions) > 1:
            raise ConfigError(f"a trial can't {' and '.join(actions)} at the same time")
        about = fields.get("about") or {}
        if not isinstance(about, dict) or {"when_clear", "limit_s", "mark"} & about.keys():
            raise ConfigError(
                f"about: expected an object without when_clear, limit_s and mark, not {about!r}"
            )
        if "begin" in actions:
            clear = bool(fields.get("when_clear"))
            runner.go(when_clear=clear, limit_s=_limit(fields), **about)
        elif "cancel" in actions:
            mark = _text(fields, "mark")
            if mark not in (None, "undone", "void"):
                raise ConfigError(f"mark: expected undone or void, not {mark!r}")
            runner.cancel(mark, **about)
        elif "finish" in actions:
            runner.finish()
        elif actions:
            runner.pause("pause" in actions)
        return runner.report(_side(fields))

    def _reset(self, fields: Mapping[str, Any]) -> dict[str, Any]:
        runner = self._open_runner()
        runner.reset()
        return runner.report(_side(fields))

    def _open_runner(self) -> TrialRunner:
        runner = self._runner()
        if runner is None:
            raise ConfigError(
                "this run has no simulation: start teleop with --task card or with --sink mujoco"
            )
        return runner

    def _await(self, request: Future[DriverSpec]) -> DriverSpec:
        """Wait until the requested method drives the hands, and return it."""
        while True:
            try:
                return request.result(_LOOK_S)
            except TimeoutError:
                if self._loop.controls.quitting:
                    raise ConfigError("the run has ended") from None


def _driven(spec: DriverSpec) -> dict[str, Any]:
    return {"method": spec.method, "preset": spec.preset}


def _text(fields: Mapping[str, Any], name: str) -> str | None:
    value = fields.get(name)
    if value is not None and not (isinstance(value, str) and value):
        raise ConfigError(f"{name}: expected a string, not {value!r}")
    return value


def _limit(fields: Mapping[str, Any]) -> float | None:
    value = fields.get("limit_s")
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value < 1e5:
        raise ConfigError(f"limit_s: expected a number of seconds above 0, not {value!r}")
    return float(value)


def _side(fields: Mapping[str, Any]) -> Side | None:
    side = _text(fields, "side")
    if side not in (None, "right", "left"):
        raise ConfigError(f"side: expected right or left, not {side!r}")
    return side  # type: ignore[return-value]  # just looked at
