"""Logs of version 2, whose messages are JSON, as this program wrote them before version 3.

The encoder of that time: it stands here so that such logs are read, and so that today's can be
held against it in size and time. It shares nothing with the package's own encoder.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from mcap.writer import CompressionType, Writer

from smooth_operator.landmarks import BONES, WRIST
from smooth_operator.teleop.recording.loop_state import LoopState
from smooth_operator.teleop.sinks.tick import ArmCommand, HandState, WristCommand
from smooth_operator.types import HandFrame, JointCommand, Status

OWN = ("/hand", "/command", "/status", "/timing", "/config", "/arm", "/loop", "/state", "/wrist")
OF_COMMANDS = ("/timing", "/status", "/loop", "/wrist", "/arm")
ENCODER = json.JSONEncoder(allow_nan=False, separators=(",", ":"))
PERIOD_NS = round(1e9 / 30.0)
ORIGIN = {
    "position": {"x": 0.0, "y": 0.0, "z": 0.0},
    "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0},
}


class JsonLogWriter:
    """The former ``LogWriter``, without its checks; use as a context manager."""

    def __init__(
        self,
        path: Path,
        *,
        chunk_bytes: int = 64 * 1024,
        flush_seconds: float = 1.0,
        keypoints: Callable[[np.ndarray], np.ndarray] | None = None,
        version: str = "2",
        overwrite: bool = False,
    ) -> None:
        self.path, self._version = path, version
        self.commands_flushed = 0
        self._chunk_bytes, self._flush_seconds = chunk_bytes, flush_seconds
        self._pending, self._since = 0, 0.0
        self._config: str | None = None
        self._sequence: dict[str, int] = {}
        self._foxglove = _Foxglove(keypoints)
        self._log_time = 0
        self._stream = path.open("wb" if overwrite else "xb")
        self._writer = Writer(self._stream, chunk_size=2**62, compression=CompressionType.ZSTD)
        self._writer.start(library="smooth-operator")
        self._channels: dict[str, int] = {}
        for topic in OWN[:5]:
            self._register(topic)
        self._writer.flush()

    def write_hand(self, frame: HandFrame, stamp: float | None = None) -> None:
        stamp = frame.time if stamp is None else stamp
        assert frame.valid is not None
        message: dict[str, Any] = {
            "stamp": stamp,
            "side": frame.side,
            "landmarks": points(frame.landmarks),
            "valid": frame.valid.tolist(),
        }
        if frame.metacarpals is not None:
            message["metacarpals"] = points(frame.metacarpals)
        if frame.orientations is not None:
            message["orientations"] = quaternions(frame.orientations)
        if frame.T_world_wrist is not None:
            message["wrist"] = pose(frame.T_world_wrist)
            if frame.world is not None:
                message["world"] = frame.world
        self._append(("/hand", message), *self._foxglove.hand(frame, nanoseconds(stamp)))

    def write_command(
        self,
        command: JointCommand,
        status: Status,
        latency_ms: float,
        stages: Mapping[str, float] | None = None,
        loop: LoopState | None = None,
        wrist: WristCommand | None = None,
        arm: ArmCommand | None = None,
    ) -> None:
        stamp = float(command.stamp)
        parts = [{"name": k, "ms": number(v)} for k, v in (stages or {}).items()]
        records: list[tuple[str, dict[str, Any]]] = [
            ("/timing", {"stamp": stamp, "latency_ms": number(latency_ms), "stages": parts}),
            ("/status", {"stamp": stamp, "status": int(status), "reason": Status(status).reason}),
        ]
        if loop is not None:
            records.append(("/loop", loop_message(stamp, loop)))
        if wrist is not None:
            told = {"engaged": wrist.engaged, "valid": wrist.valid, "world": wrist.world}
            records.append(("/wrist", {"stamp": stamp, "pose": pose(wrist.pose), **told}))
            records += self._foxglove.wrist(wrist, nanoseconds(stamp))
        if arm is not None:
            records.append(("/arm", arm_message(stamp, arm)))
        names, positions = tuple(command.names), np.asarray(command.positions)
        records += self._foxglove.command(names, positions, nanoseconds(stamp))
        message = {"stamp": stamp, "names": names, "positions": numbers(positions)}
        if self._version == "1":
            message["status"] = int(status)
            records = [record for record in records if record[0] != "/status"]
        self._append(*records, ("/command", message))

    def write_state(self, state: HandState) -> None:
        message: dict[str, Any] = {
            "stamp": state.stamp,
            "names": state.names,
            "positions": numbers(state.positions),
        }
        for name in ("velocities", "currents", "temperatures", "touch"):
            values = getattr(state, name)
            if values is not None:
                message[name] = numbers(values)
        if state.actuators:
            message["actuators"] = state.actuators
        self._append(("/state", message))

    def write_config(self, config: Mapping[str, Any]) -> None:
        self._config = json.dumps(dict(config))

    def write_origin(self, origin: Mapping[str, str]) -> None:
        self._writer.add_metadata("smooth_operator.origin", dict(origin))

    def write_method(self, stamp: float, method: str, preset: str, config: Any) -> None:
        told = {"stamp": repr(float(stamp)), "method": method, "preset": preset}
        self._writer.add_metadata("smooth_operator.method", {**told, "config": json.dumps(config)})

    def write_message(self, topic: str, message: dict[str, Any]) -> None:
        """Any message, also one that no reader takes."""
        self._append((topic, message))

    def flush(self, *, sync: bool = False) -> None:
        self._writer.flush()
        self._pending = 0

    def close(self) -> None:
        if self._config is not None:
            self._message("/config", {"configuration": self._config})
        self._writer.finish()
        self._stream.close()

    def __enter__(self) -> JsonLogWriter:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()

    def _append(self, *messages: tuple[str, dict[str, Any]]) -> None:
        now = time.monotonic()
        if not self._pending:
            self._since = now
        self._log_time = nanoseconds(messages[0][1]["stamp"])
        if self._config is not None:
            self._message("/config", {"configuration": self._config})
            self._config = None
        for topic, message in messages:
            self._message(topic, message)
        if self._pending >= self._chunk_bytes or now - self._since >= self._flush_seconds:
            self.flush()

    def _message(self, topic: str, message: dict[str, Any]) -> None:
        data = ENCODER.encode(message).encode()
        if topic not in self._channels:
            self._register(topic)
        sequence = self._sequence.get("/command" if topic in OF_COMMANDS else topic, 0)
        self._writer.add_message(
            self._channels[topic], self._log_time, data, self._log_time, sequence
        )
        self._sequence[topic] = self._sequence.get(topic, 0) + 1
        self._pending += len(data)

    def _register(self, topic: str) -> None:
        schema = self._writer.register_schema(topic, "jsonschema", b'{"type":"object"}')
        self._channels[topic] = self._writer.register_channel(
            topic, "json", schema, {"version": self._version}
        )


def loop_message(stamp: float, loop: LoopState) -> dict[str, Any]:
    message = {key: number(getattr(loop, key)) for key in (
        "time", "received", "tracker_stamp", "tracking_loss", "scale",
    )}  # fmt: skip
    return {
        "stamp": stamp,
        "number": loop.number,
        "mode": loop.mode,
        **message,
        "session": loop.session,
        "events": list(loop.events),
    }


def arm_message(stamp: float, arm: ArmCommand) -> dict[str, Any]:
    message: dict[str, Any] = {
        "stamp": stamp,
        "name": arm.name,
        "names": arm.joint_names,
        "positions": numbers(arm.positions),
        "velocities": numbers(arm.velocity),
        "pose": pose(arm.pose),
        "state": arm.state,
        "clearance": number(arm.clearance),
        "position_error": number(arm.position_error),
        "rotation_error": number(arm.rotation_error),
    }
    if arm.measured is not None:
        message["measured"] = numbers(arm.measured)
    return message


class _Foxglove:
    """The messages for Foxglove's 3D panel, as JSON."""

    def __init__(self, keypoints: Callable[[np.ndarray], np.ndarray] | None) -> None:
        self._keypoints = keypoints
        self._due: dict[str, int] = {}

    def hand(self, frame: HandFrame, at: int) -> Iterator[tuple[str, dict[str, Any]]]:
        assert frame.valid is not None
        wrist = frame.T_world_wrist
        if wrist is not None and np.isfinite(wrist).all() and self._is_due("human_wrist", at):
            yield "/foxglove/human_wrist", placed(wrist, frame.world or "world", at)
        if not frame.valid.any() or not self._is_due("hand", at):
            return
        transform = {
            "timestamp": stamp_of(at),
            "parent_frame_id": "robot",
            "child_frame_id": "tracker",
            "translation": points(frame.landmarks[WRIST][None])[0],
            "rotation": ORIGIN["orientation"],
        }
        yield "/foxglove/frames", {"transforms": [transform]}
        yield "/foxglove/hand", scene("tracker", frame.landmarks, frame.valid, at)

    def wrist(self, wrist: WristCommand, at: int) -> Iterator[tuple[str, dict[str, Any]]]:
        if self._is_due("wrist_target", at):
            yield "/foxglove/wrist_target", placed(wrist.pose, wrist.world, at)

    def command(
        self, names: tuple[str, ...], positions: np.ndarray, at: int
    ) -> Iterator[tuple[str, dict[str, Any]]]:
        if not self._is_due("joints", at):
            return
        finite = np.isfinite(positions)
        states = [
            {"name": name, "position": q} if there else {"name": name}
            for name, q, there in zip(names, positions.tolist(), finite, strict=True)
        ]
        yield "/foxglove/joints", {"timestamp": stamp_of(at), "joints": states}
        if self._keypoints is not None and finite.all():
            found = self._keypoints(positions)
            yield "/foxglove/robot", scene("robot", found, np.isfinite(found).all(axis=1), at)

    def _is_due(self, topic: str, at: int) -> bool:
        due = self._due.get(topic, at)
        if due - PERIOD_NS <= at < due:
            return False
        late = min(max(at - due, 0), PERIOD_NS // 2) if at >= due else 0
        self._due[topic] = at - late + PERIOD_NS
        return True


def scene(frame: str, landmarks: np.ndarray, valid: np.ndarray, at: int) -> dict[str, Any]:
    place = np.cumsum(valid) - 1
    lines = {
        "type": 2,
        "pose": ORIGIN,
        "thickness": 0.004,
        "scale_invariant": False,
        "points": points(landmarks[valid].round(6)),
        "color": {"r": 0.9, "g": 0.6, "b": 0.35, "a": 1.0},
        "colors": [],
        "indices": [int(place[i]) for bone in BONES if valid[list(bone)].all() for i in bone],
    }
    shapes = ("arrows", "cubes", "spheres", "cylinders", "triangles", "texts", "models")
    entity = {
        "timestamp": stamp_of(at),
        "frame_id": frame,
        "id": frame,
        "lifetime": {"sec": 0, "nsec": 0},
        "frame_locked": True,
        "metadata": [],
        **{shape: [] for shape in shapes},
        "lines": [lines],
    }
    return {"deletions": [], "entities": [entity]}


def placed(found: np.ndarray, frame: str, at: int) -> dict[str, Any]:
    return {"timestamp": stamp_of(at), "frame_id": frame, "pose": pose(found)}


def stamp_of(at: int) -> dict[str, int]:
    sec, nsec = divmod(at, 1_000_000_000)
    return {"sec": sec, "nsec": nsec}


def pose(array: np.ndarray) -> dict[str, Any]:
    return {
        "position": points(array[None, :3])[0],
        "orientation": quaternions(array[None, 3:])[0],
    }


def points(array: np.ndarray) -> list[dict[str, float | None]]:
    return [{"x": x, "y": y, "z": z} for x, y, z in rows(array)]


def quaternions(array: np.ndarray) -> list[dict[str, float | None]]:
    return [{"w": w, "x": x, "y": y, "z": z} for w, x, y, z in rows(array)]


def number(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else float(value)


def numbers(array: np.ndarray) -> list[float | None]:
    (row,) = rows(array[None])
    return row


def nanoseconds(stamp: float) -> int:
    return min(round(min(max(stamp * 1e9, 0.0), float(2**64 - 1))), 2**64 - 1)


def rows(array: np.ndarray) -> list[list[float | None]]:
    found: list[list[float | None]] = array.tolist()
    return found if np.isfinite(array).all() else [[number(x) for x in row] for row in found]
