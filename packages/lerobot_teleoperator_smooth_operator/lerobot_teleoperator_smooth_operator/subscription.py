"""Sources of commands: a ZeroMQ subscription, or a loop in this process."""

from __future__ import annotations

import atexit
import contextlib
import math
import threading
from pathlib import Path
from typing import Any, TypeAlias, cast

import zmq

from lerobot_teleoperator_smooth_operator.commands import Newest
from lerobot_teleoperator_smooth_operator.config_smooth_operator import SmoothOperatorConfig

_POLL_MS = 50
"""Interval at which the thread checks whether it should end [ms]."""

_PATIENCE_S = 5.0
"""Longest time that closing waits for a thread [s]."""


class Subscription:
    """Thread that receives the messages of ``smooth-operator teleop --sink zmq``.

    The publisher may start later: ZeroMQ connects when it starts, and again after an interruption.

    Args:
        address: address of the publisher.
        newest: store for the messages.

    Raises:
        ValueError: the text is not a ZeroMQ address.
    """

    def __init__(self, address: str, newest: Newest) -> None:
        self._newest = newest
        self._context = zmq.Context()
        self._socket = self._context.socket(zmq.SUB)
        self._socket.setsockopt(zmq.LINGER, 0)
        self._socket.setsockopt(zmq.SUBSCRIBE, b'{"side":')
        try:
            self._socket.connect(address)
        except zmq.ZMQError as error:
            self._socket.close()
            self._context.term()
            raise ValueError(
                f"{address!r} is not a ZeroMQ address ({error}); expected an address such as "
                "tcp://127.0.0.1:5556"
            ) from error
        self.error: Exception | None = None
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run, name="smooth-operator", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the thread and close the socket."""
        self._ending.set()
        self._thread.join(_PATIENCE_S)

    def _run(self) -> None:
        try:
            while not self._ending.is_set():
                if self._socket.poll(_POLL_MS):
                    self._newest.receive(self._socket.recv())
        except zmq.ZMQError as error:
            self.error = error
        finally:
            self._socket.close()
            self._context.term()
            self._newest.wake()


class InProcess:
    """Runs smooth-operator's loop on a thread of this process.

    The loop compiles and solves in the process of LeRobot's own loop; on a busy machine, a separate
    ``teleop`` process runs more smoothly.

    Args:
        config: settings of the teleoperator, with a source of hand frames.
        newest: store for the commands.
        hand: the robot hand.
        operator: file of the operator's calibration, which the loop updates at its end; None for
            no file.

    Raises:
        ImportError: smooth-operator is not installed.
    """

    def __init__(
        self, config: SmoothOperatorConfig, newest: Newest, hand: str, operator: Path | None
    ) -> None:
        try:
            from lerobot_teleoperator_smooth_operator.mailbox_sink import MailboxSink
            from smooth_operator.teleop import TeleopRequest, teleoperate
            from smooth_operator.teleop.runtime.settings import WristConfig
        except ImportError as error:
            raise ImportError(
                "a loop in this process needs smooth-operator: python -m pip install "
                "'lerobot_teleoperator_smooth_operator[inprocess]'; without it, subscribe to a "
                "running `smooth-operator teleop --sink zmq`"
            ) from error
        self._newest, self._loop = newest, None
        self.error: Exception | None = None
        self._ending = threading.Event()
        method, side = config.method or "smooth", cast(Any, config.side)
        request = TeleopRequest(
            source=config.source,
            hand=hand,
            side=side,
            method=method,
            arm=config.arm or None,
            # If an arm follows the wrist, the hand's own wrist joints do not.
            wrist_joints="auto" if config.wrist == "none" else "off",
            methods=(method,),  # compiled before the first action
            operator=operator,
            bind=tuple(config.bind),
            wrist=WristConfig(scale=config.wrist_scale, yaw=math.radians(config.wrist_yaw)),
        )

        def started(loop: Any) -> None:
            self._loop = loop
            if self._ending.is_set():
                loop.controls.quit()

        def run() -> None:
            try:
                sink = MailboxSink(newest)
                teleoperate(request, sinks=[sink], started=started)
            except Exception as error:  # `connect` and `get_action` raise it
                self.error = error
            newest.wake()

        self._thread = threading.Thread(target=run, name="smooth-operator", daemon=True)
        self._thread.start()
        atexit.register(self.close)  # a program that fails must not end while the loop runs

    def close(self) -> None:
        """End the loop."""
        atexit.unregister(self.close)
        self._ending.set()
        if self._loop is not None:
            # At a program's end no thread can start that wakes the loop; its next turn ends it.
            with contextlib.suppress(RuntimeError):
                self._loop.controls.quit()
        self._thread.join(_PATIENCE_S)


Feed: TypeAlias = Subscription | InProcess
"""An open source of commands. The ``error`` that ended it is None while it works."""
