"""The documented commands with the real LeRobot, word for word: record, train, roll out, evaluate,
edit, correct by DAgger; and a log that merges with a recording.

Needs LeRobot and our four plug-ins installed; CI has a job with them (``lerobot-policy``).
"""

import contextlib
import importlib.metadata
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
from lerobot_stand_in import ENVIRONMENT, REAL, ROBOT, TELEOPERATOR
from live_time import PATIENCE_S

from smooth_operator import load_hand
from smooth_operator.cli import main
from smooth_operator.errors import ConfigError
from smooth_operator.simulation.camera import SimulatedCamera
from smooth_operator.simulation.physics import HandPhysics

INSTALLED = {str(each.metadata["Name"]) for each in importlib.metadata.distributions()}
LACKING = {"lerobot", "accelerate", TELEOPERATOR, ROBOT, ENVIRONMENT} - INSTALLED

zmq = pytest.importorskip("zmq")

pytestmark = [
    pytest.mark.lerobot,
    pytest.mark.skipif(
        not REAL or bool(LACKING), reason=f"not installed: {', '.join(sorted(LACKING))}"
    ),
]

FPS, TASK = 10, "Move the fingers"
SMALL = {
    "type": "act",
    "device": "cpu",
    "push_to_hub": "false",
    "dim_model": 32,
    "n_heads": 2,
    "dim_feedforward": 64,
    "n_encoder_layers": 1,
    "use_vae": "false",
    "chunk_size": 5,
    "n_action_steps": 5,
    "pretrained_backbone_weights": "null",
}
DOCS = Path(__file__).resolve().parents[1] / "docs" / "how-to" / "lerobot.md"


def run(module: str, folder: Path, options: dict[str, Any]) -> str:
    """One of LeRobot's programs, offline; what it said."""
    environment = {
        **os.environ,
        "HF_HUB_OFFLINE": "1",
        "HF_HOME": str(folder / "huggingface"),
        "JAX_PLATFORMS": "cpu",
    }
    done = subprocess.run(
        [
            sys.executable,
            "-m",
            f"lerobot.scripts.{module}",
            *(f"--{name}={value}" for name, value in options.items()),
        ],
        env=environment,
        cwd=folder,
        capture_output=True,
        encoding="utf-8",
        timeout=3000,
    )
    assert done.returncode == 0, f"{module}: {done.stderr[-4000:]}"
    return done.stdout + done.stderr


def train(folder: Path, data: Path, name: str, **more: Any) -> Path:
    """Three steps of ACT; the folder of the weights."""
    run(
        "lerobot_train",
        folder,
        {
            "dataset.repo_id": f"test/{data.name}",
            "dataset.root": data,
            "steps": 3,
            "save_freq": 3,
            "batch_size": 4,
            "num_workers": 0,
            "env_eval_freq": 0,
            "output_dir": folder / name,
            "wandb.enable": "false",
            **{f"policy.{key}": value for key, value in SMALL.items()},
            **more,
        },
    )
    model = folder / name / "checkpoints" / "last" / "pretrained_model"
    assert (model / "model.safetensors").exists()
    return model


def load(root: Path) -> Any:
    """A data set as LeRobot's own class opens it."""
    os.environ["HF_HUB_OFFLINE"] = "1"
    from lerobot.datasets import LeRobotDataset

    return LeRobotDataset(f"test/{root.name}", root=root)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with ``plain``, recorded by lerobot-record, and ``take.mcap``."""
    folder = tmp_path_factory.mktemp("policy")
    address = f"tcp://127.0.0.1:{free_port()}"
    teleop = [
        "teleop",
        "--source",
        "synthetic",
        "--hand",
        "mimic_p050",
        "--method",
        "joint_angle",
        "--sink",
        f"zmq:{address},valid_for_s=10",
        "mujoco",
        f"record:{folder / 'take.mcap'}",
        "--no-view",
    ]
    record = {
        "robot.type": "smooth_hand",
        "robot.hand": "mimic_p050",
        "teleop.type": "smooth_operator",
        "teleop.address": address,
        "teleop.timeout_s": 120,
        "dataset.num_episodes": 1,
        "dataset.episode_time_s": 3,
        "dataset.reset_time_s": 0,
        "dataset.fps": FPS,
        "dataset.single_task": TASK,
        "dataset.push_to_hub": "false",
        "dataset.video": "false",
        "play_sounds": "false",
    }
    with subprocess.Popen(
        [sys.executable, "-m", "smooth_operator", *teleop],
        cwd=folder,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        encoding="utf-8",
    ) as process:
        try:
            where = {"dataset.repo_id": "test/plain", "dataset.root": folder / "plain"}
            run("lerobot_record", folder, {**record, **where})
        finally:
            process.terminate()
            process.communicate(timeout=PATIENCE_S)
    return folder


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
        **os.environ,
        "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
        "HF_HUB_OFFLINE": "1",
        "HF_HOME": str(folder / "huggingface"),
        "JAX_PLATFORMS": "cpu",
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
def operator(folder: Path) -> Iterator[None]:
    """The documented ``teleop``, from its first command on; Ctrl-C at the end."""
    with started(documented("smooth-operator teleop"), folder, stdin=subprocess.DEVNULL) as process:
        try:
            with zmq.Context() as context, context.socket(zmq.SUB) as socket:
                socket.setsockopt(zmq.SUBSCRIBE, b"")
                socket.connect("tcp://127.0.0.1:5556")
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
    with operator(folder):
        typed(documented("smooth-operator-lerobot-record"), folder)
    typed(documented("lerobot-train", "policy.type=act"), folder)
    return folder


def test_documented_commands_record_train_roll_out_and_evaluate(trained):
    data = load(trained / "fingers")
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
    assert load(trained / "fingers-good").num_episodes == 1
    typed(documented("smooth-operator retarget"), trained)
    assert load(trained / "fingers-leap").num_episodes == 2
    typed(documented("smooth-operator convert"), trained)
    assert "observation.environment_state" in load(trained / "state").features


def test_the_documented_dagger_records_a_correction(trained, tmp_path):
    """With a person at the keyboard, who waits before each key until the hand is at rest."""
    keys = [(" recording started", 2.0, b" "), ("autonomous -> paused", 6.0, b"\t")]
    keys += [("paused -> correcting", 2.0, b"\t")]
    keyboard, terminal = pty.openpty()
    with operator(tmp_path):
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
    rows = load(trained / "corrections").hf_dataset.with_format("numpy")[:]
    assert len(rows["intervention"]) > 10
    assert np.all(rows["intervention"])
    # the correction begins where the robot is
    assert np.abs(rows["action"][0] - rows["observation.state"][0]).max() < 0.2


def test_a_log_merges_with_a_recording_by_lerobots_tool(recorded):
    command = ["convert", str(recorded / "take.mcap"), "--columns", "robot", "--fps", str(FPS)]
    output, merged = recorded / "plain-log", recorded / "plain-both"
    assert main([*command, "--task", TASK, "--output", str(output)]) == 0
    own, log = load(recorded / "plain"), load(output)
    assert log.features == own.features
    assert log.meta.robot_type == own.meta.robot_type == "smooth_hand"
    run(
        "lerobot_edit_dataset",
        recorded,
        {
            "new_repo_id": f"test/{merged.name}",
            "new_root": merged,
            "operation.type": "merge",
            "operation.repo_ids": f"[test/plain, test/{output.name}]",
            "operation.roots": f"[{recorded / 'plain'}, {output}]",
            "push_to_hub": "false",
        },
    )
    both = load(merged)
    assert (both.num_episodes, len(both)) == (2, len(own) + len(log))
    np.testing.assert_array_equal(both[len(own)]["action"], log[0]["action"])


def test_a_policy_is_evaluated_in_the_environment(recorded):
    """A data set of the environment, made by holding the start pose; ACT; lerobot-eval."""
    import lerobot_env_smooth_hand as package
    from lerobot.datasets import LeRobotDataset
    from lerobot_env_smooth_hand.environment import OBJECT_NAMES

    environment = package.HandTask(task="card", fps=FPS)
    joints = [f"{name}.pos" for name in environment.hand.actuated_names]
    names = {
        "observation.state": joints,
        "observation.environment_state": list(OBJECT_NAMES),
        "action": joints,
    }
    data = LeRobotDataset.create(
        "test/card",
        FPS,
        root=recorded / "card",
        robot_type="smooth_hand",
        use_videos=False,
        features={
            key: {"dtype": "float32", "shape": (len(each),), "names": each}
            for key, each in names.items()
        },
    )
    for seed in range(2):
        seen, _ = environment.reset(seed=seed)
        for _ in range(15):
            action = environment.hand.neutral.astype(np.float32)
            data.add_frame(
                {
                    "observation.state": seen["agent_pos"],
                    "action": action,
                    "task": "card",
                    "observation.environment_state": seen["environment_state"],
                }
            )
            seen, *_ = environment.step(action)
        data.save_episode()
    data.finalize()
    evaluate(recorded, train(recorded, recorded / "card", "card-policy"), "evaluation")


def evaluate(recorded: Path, model: Path, name: str) -> None:
    run(
        "lerobot_eval",
        recorded,
        {
            "policy.path": model,
            "policy.device": "cpu",
            "env.type": "smooth_hand",
            "env.task": "card",
            "env.fps": FPS,
            "env.seconds": 1,
            "env.width": 64,
            "env.height": 64,
            "eval.n_episodes": 2,
            "eval.batch_size": 2,
            "output_dir": recorded / name,
            "eval.recording": str(not can_draw()).lower(),  # else it renders videos
        },
    )
    info = json.loads((recorded / name / "eval_info.json").read_text())
    assert info["overall"]["n_episodes"] == 2
    assert 0.0 <= info["overall"]["pc_success"] <= 100.0
