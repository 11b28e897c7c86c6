"""ROS 2 by rclpy, which comes with a ROS 2 installation and not from a package index."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable
from typing import Any

from smooth_operator.errors import ConfigError
from smooth_operator.teleop.ros2.messages import M, Message, Time, from_foreign, to_foreign
from smooth_operator.teleop.ros2.transport import DEPTH, MANY, Endpoint, Received, describe


class RclpyTransport:
    """A node; only the thread that uses the transport touches it.

    Args:
        endpoint: settings; without a domain ROS 2's own (``ROS_DOMAIN_ID``) holds.

    Raises:
        SinkError, SourceError: rclpy can't be imported, or does not start.
        ConfigError: a network is asked for, which ROS 2's own variables decide.
    """

    def __init__(self, endpoint: Endpoint) -> None:
        self._endpoint = endpoint
        if endpoint.network is not None:
            raise ConfigError(
                f"{endpoint.feature}: with rclpy, ROS 2 itself decides whom it reaches: leave out "
                "network and set ROS_AUTOMATIC_DISCOVERY_RANGE (up to Humble ROS_LOCALHOST_ONLY)"
            )
        domain = None if endpoint.domain is None else endpoint.domain_id()
        self._rclpy, contexts, self._qos, executors = (
            self._import(f"rclpy{name}") for name in ("", ".context", ".qos", ".executors")
        )
        # A context of our own: the default one would take over Ctrl-C, and may be in use.
        self._context = contexts.Context()
        try:
            self._rclpy.init(context=self._context, domain_id=domain)
            self._node = self._rclpy.create_node(endpoint.node, context=self._context)
            self._executor = executors.SingleThreadedExecutor(context=self._context)
            self._executor.add_node(self._node)
        except Exception as error:  # rclpy's own errors have no common base
            raise endpoint.error(
                f"ROS 2 does not start: {describe(error)}; check its setup and ROS_DOMAIN_ID"
            ) from error
        self._received: list[Received] = []
        self._classes: dict[type[Message], Any] = {}
        self.label = "rclpy"

    def publisher(self, kind: type[M], topic: str, depth: int = DEPTH) -> Callable[[M], None]:
        """See ``Transport``."""
        publisher = self._node.create_publisher(
            self._class(kind), topic, self._profile("RELIABLE", depth)
        )

        def publish(message: M) -> None:
            publisher.publish(to_foreign(message, self._class))

        return publish

    def subscribe(self, kind: type[Message], topic: str, depth: int) -> None:
        """See ``Transport``."""

        def take(message: Any) -> None:
            self._received.append((topic, from_foreign(message, kind)))

        profile = self._profile("BEST_EFFORT", depth)
        self._node.create_subscription(self._class(kind), topic, take, profile)

    def receive(self, timeout: float) -> list[Received]:
        """See ``Transport``."""
        before = -1
        while before < len(self._received) < MANY:
            before = len(self._received)
            self._executor.spin_once(timeout_sec=timeout if before == 0 else 0.0)
        received, self._received = self._received, []
        return received

    def now(self) -> Time:
        """By the node's clock, which may be a simulation's."""
        return from_foreign(self._node.get_clock().now().to_msg(), Time)

    def close(self) -> None:
        """See ``Transport``."""
        self._executor.shutdown()
        self._node.destroy_node()
        self._rclpy.shutdown(context=self._context)

    def _profile(self, reliability: str, depth: int) -> Any:
        qos = self._qos
        return qos.QoSProfile(
            history=qos.HistoryPolicy.KEEP_LAST,
            depth=depth,
            reliability=qos.ReliabilityPolicy[reliability],
            durability=qos.DurabilityPolicy.VOLATILE,
        )

    def _class(self, kind: type[Message]) -> Any:
        if kind not in self._classes:
            package, _, name = kind.type_name.partition("/msg/")
            self._classes[kind] = getattr(self._import(f"{package}.msg"), name)
        return self._classes[kind]

    def _import(self, name: str) -> Any:
        try:
            return importlib.import_module(name)
        except ImportError as error:
            version = f"{sys.version_info.major}.{sys.version_info.minor}"
            raise self._endpoint.error(
                f"{self._endpoint.feature} needs ROS 2's {name}, which pip can't install: run "
                "'source /opt/ros/DISTRO/setup.bash' first, with a ROS 2 whose Python is this one, "
                f"{version} ({error})"
            ) from error
