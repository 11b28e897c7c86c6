"""The documented commands with the real LeRobot, word for word: record, train, roll out, evaluate,
edit, correct by DAgger; and a log that merges with a recording.

Needs LeRobot and our four plug-ins installed; CI has a job with them (``lerobot-policy``).
"""

import contextlib
import json
import os
import pty
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from free_port import free_port
from lerobot_stand_in import ENVIRONMENT, ROBOT, TELEOPERATOR, load_dataset, needs_lerobot, offline
from live_time import PATIENCE_S

from smooth_operator import load_hand
from smooth_operator.errors import ConfigError
from smooth_operator.simulation.camera import SimulatedCamera
from smooth_operator.simulation.physics import HandPhysics

zmq = pytest.importorskip("zmq")

pytestmark = needs_lerobot("accelerate", TELEOPERATOR, ROBOT, ENVIRONMENT)

FPS, TASK = 10, "Move the fingers"
DOCS = Path(__file__).resolve().parents[1] / "docs" / "how-to" / "lerobot.md"


def can_draw() -> bool:
    try:
        SimulatedCamera(HandPhysics(load_hand("mimic_p050")), 64, 64).close()
    except ConfigError:
        return False
    return True


def documented(start: str, word: str = "") -> str:
    """The one documented command that begins so and contains a word, as one line."""
    text = DOCS.read_text(encoding="utf-8").replace("\\\n", " ")
    lines = "".join(re.findall(r"```bash\n(.*?)```", text, re.DOTALL)).splitlines()
    (found,) = [line for line in lines if line.startswith(start) and word in line]
    return found


def started(command: str, folder: Path, **options: Any) -> subprocess.Popen[str]:
    """A documented command, as typed into a shell without a display or a network."""
    environment = {
        **offline(folder),
        "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
        "BROWSER": "true",
    }
    return subprocess.Popen(
        ["bash", "-c", command],
        env=environment,
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        encoding="utf-8",
        **options,
    )


def typed(command: str, folder: Path) -> str:
    """Run a documented command to its end; what it said."""
    with started(command, folder, stdin=subprocess.DEVNULL) as process:
        said, _ = process.communicate(timeout=3000)
    assert process.returncode == 0, f"{command}: {said[-4000:]}"
    return said


@contextlib.contextmanager
def operator(folder: Path, command: str, address: str = "tcp://127.0.0.1:5556") -> Iterator[None]:
    """Runs ``teleop``, from its first command on; Ctrl-C at the end."""
    with started(command, folder, stdin=subprocess.DEVNULL) as process:
        try:
            with zmq.Context() as context, context.socket(zmq.SUB) as socket:
                socket.setsockopt(zmq.SUBSCRIBE, b"")
                socket.connect(address)
                while b'"mode":"tracking"' not in socket.recv():
                    assert process.poll() is None
            yield
        finally:
            process.send_signal(signal.SIGINT)
            process.communicate(timeout=PATIENCE_S)


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with ``fingers`` and ``policy``, by the documented commands."""
    if not can_draw():
        pytest.skip("this machine can't draw with OpenGL")
    folder = tmp_path_factory.mktemp("documented")
    with operator(folder, documented("smooth-operator teleop")):
        typed(documented("smooth-operator-lerobot-record"), folder)
    typed(documented("lerobot-train", "policy.type=act"), folder)
    return folder


def test_documented_commands_record_train_roll_out_and_evaluate(trained):
    data = load_dataset(trained / "fingers")
    assert data.num_episodes == 2
    picture = data[len(data) // 2]["observation.images.front"]
    assert tuple(picture.shape) == (3, 120, 160)
    assert float(picture.max() - picture.min()) > 0.3  # the hand, and what is behind it
    config = trained / "policy" / "checkpoints" / "last" / "pretrained_model" / "config.json"
    inputs = json.loads(config.read_text())["input_features"]
    assert set(inputs) == {"observation.state", "observation.images.front"}
    said = typed(documented("lerobot-rollout", "--duration"), trained)
    assert "Rollout finished" in said
    assert "pc_success" in typed(documented("lerobot-eval"), trained)


def test_documented_commands_edit_the_data_set_and_change_the_hand(trained):
    typed(documented("lerobot-edit-dataset"), trained)
    assert load_dataset(trained / "fingers-good").num_episodes == 1
    typed(documented("smooth-operator retarget"), trained)
    assert load_dataset(trained / "fingers-leap").num_episodes == 2
    typed(documented("smooth-operator convert"), trained)
    assert "observation.environment_state" in load_dataset(trained / "state").features


def test_the_documented_dagger_records_a_correction(trained, tmp_path):
    """With a person at the keyboard, who waits before each key until the hand is at rest."""
    keys = [(" recording started", 2.0, b" "), ("autonomous -> paused", 6.0, b"\t")]
    keys += [("paused -> correcting", 2.0, b"\t")]
    keyboard, terminal = pty.openpty()
    with operator(tmp_path, documented("smooth-operator teleop")):
        command, said = documented("lerobot-rollout", "dagger"), ""
        with started(command, trained, stdin=terminal) as process:
            assert process.stdout is not None
            for line in process.stdout:
                said += line
                if keys and keys[0][0] in line:
                    _, seconds, key = keys.pop(0)
                    time.sleep(seconds)
                    os.write(keyboard, key)
        assert process.returncode == 0, said[-4000:]
    for handle in (keyboard, terminal):
        os.close(handle)
    assert "Correction 1/1 saved" in said
    rows = load_dataset(trained / "corrections").hf_dataset.with_format("numpy")[:]
    assert len(rows["intervention"]) > 10
    assert np.all(rows["intervention"])
    # the correction begins where the robot is
    assert np.abs(rows["action"][0] - rows["observation.state"][0]).max() < 0.2


def test_a_log_merges_with_a_recording_by_lerobots_tool(tmp_path):
    address = f"tcp://127.0.0.1:{free_port()}"
    teleop = (
        "smooth-operator teleop --source synthetic --hand mimic_p050 --method joint_angle"
        f" --sink zmq:{address},valid_for_s=10 mujoco record:take.mcap --no-view"
    )
    record = (
        "lerobot-record --robot.type=smooth_hand --robot.hand=mimic_p050"
        f" --teleop.type=smooth_operator --teleop.address={address} --teleop.timeout_s=120"
        " --dataset.repo_id=test/plain --dataset.root=plain --dataset.num_episodes=1"
        f" --dataset.episode_time_s=3 --dataset.reset_time_s=0 --dataset.fps={FPS}"
        f" --dataset.single_task='{TASK}' --dataset.push_to_hub=false --dataset.video=false"
        " --play_sounds=false"
    )
    with operator(tmp_path, teleop, address):
        typed(record, tmp_path)
    convert = f"smooth-operator convert take.mcap --columns robot --fps {FPS} --task '{TASK}'"
    typed(f"{convert} --output plain-log", tmp_path)
    own, log = load_dataset(tmp_path / "plain"), load_dataset(tmp_path / "plain-log")
    assert log.features == own.features
    assert log.meta.robot_type == own.meta.robot_type == "smooth_hand"
    typed(
        "lerobot-edit-dataset --new_repo_id=test/both --new_root=both --operation.type=merge"
        " --operation.repo_ids='[test/plain, test/plain-log]'"
        " --operation.roots='[plain, plain-log]' --push_to_hub=false",
        tmp_path,
    )
    both = load_dataset(tmp_path / "both")
    assert (both.num_episodes, len(both)) == (2, len(own) + len(log))
    np.testing.assert_array_equal(both[len(own)]["action"], log[0]["action"])
