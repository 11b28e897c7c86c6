"""The sink for Rerun: what a file of it holds, and what is refused."""

import importlib.util
from typing import Any

import numpy as np
import pytest

from smooth_operator import load_hand
from smooth_operator.errors import ConfigError
from smooth_operator.teleop.components import build_sink
from smooth_operator.teleop.sinks.sink import Sink
from smooth_operator.teleop.sinks.tick import HandState, Mode, Tick
from smooth_operator.types import HandFrame, JointCommand

HERE = importlib.util.find_spec("rerun") is not None


def tick(number: int) -> Tick:
    from smooth_operator.teleop.sources.live import Arrival

    hand = load_hand("mimic_p050")
    positions = hand.full_configuration(hand.neutral) + 0.01 * number
    stamp = 100.0 + 0.02 * number
    landmarks = np.arange(63.0).reshape(21, 3) / 1000 + number
    landmarks[20] = np.nan  # a fingertip that the tracker lost
    return Tick(
        "right",
        hand.name,
        JointCommand(positions, hand.joint_names, stamp),
        np.zeros(len(positions)),
        Mode.TRACKING,
        stamp,
        number,
        arrival=Arrival(HandFrame(landmarks, stamp, "right"), stamp),
        state=HandState("right", hand.name, stamp, hand.joint_names, positions - 0.5),
        events=("tracking",) if number == 0 else (),
    )


@pytest.mark.skipif(not HERE, reason="rerun-sdk is not installed")
def test_a_file_holds_hands_and_joints_on_the_loops_clock(tmp_path):
    from rerun import recording

    hand = load_hand("mimic_p050")
    sink: Sink = build_sink(f"rerun:{tmp_path / 'new' / 'take.rrd'}")
    sink.check({"right": hand})
    sink.open({"right": hand}, {})
    sender: Any = sink
    for number in range(20):
        sink.send(tick(number))
        while sender._sender()._newest:  # each is passed on
            pass
    sink.close()
    sink.close()
    rows: dict[str, list[Any]] = {}
    for chunk in recording.load_recording(tmp_path / "new" / "take.rrd").chunks():
        batch = chunk.to_record_batch()
        for name in batch.schema.names:
            rows.setdefault(f"{chunk.entity_path} {name}", []).extend(
                batch.column(name).to_pylist()
            )

    def values(path: str, kind: str) -> list[Any]:
        (key,) = [each for each in rows if each.startswith(f"/{path} ") and kind in each]
        return rows[key]

    command = np.array(values("right/command", "Scalars:scalars"))
    np.testing.assert_allclose(command, [tick(k).command.joint_positions for k in range(20)])
    np.testing.assert_allclose(values("right/measured", "Scalars:scalars"), command - 0.5)
    human = np.array(values("right/human/landmarks", "Points3D:positions"))
    assert human.shape == (20, 20, 3)  # without the one that was lost
    np.testing.assert_allclose(human[:, 0], 0.0, atol=1e-6)  # from the wrist
    assert np.shape(values("right/human/bones", "LineStrips3D:strips")) == (20, 19, 2, 3)
    assert np.shape(values("right/robot/landmarks", "Points3D:positions"))[0] == 20
    assert values("right/events", "TextLog:text") == [["tracking"]]


def test_what_rerun_is_to_write_to_is_checked():
    assert build_sink("rerun").label == "rerun rerun+http://127.0.0.1:9876/proxy"
    assert build_sink("rerun:take.rrd").observes
    with pytest.raises(ConfigError, match=r"NAME\.rrd, not 'take\.mcap'"):
        build_sink("rerun:take.mcap")
