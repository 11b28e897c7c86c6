"""``retarget --dataset``: the actions of another robot hand, from the human hands of a data set."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from robot_clips import robot_clip
from test_dataset_lerobot import mp4

from smooth_hand_datasets.pipeline.another_hand import retarget_dataset
from smooth_hand_datasets.pipeline.writers.registry import WRITERS, WritingOptions
from smooth_operator.cli import main
from smooth_operator.episode_files.lerobot import open_dataset, write_dataset
from smooth_operator.errors import OutputError, RecordingError
from smooth_operator.execution import execute
from smooth_operator.formats.episode import Episode
from smooth_operator.planning import RetargetRequest, make_request, plan
from smooth_operator.reporter import Reporter
from smooth_operator.synthetic import SyntheticOperator
from smooth_operator.teleop.recording.convert import read_episode

pq = pytest.importorskip("pyarrow.parquet", reason="pyarrow is not installed")

FORMER, NEW = "mimic_p050", "leap_hand"


def request(hand: str, **changes: Any) -> RetargetRequest:
    return make_request(hand=hand, method="joint_angle", **changes)


@pytest.fixture(scope="module")
def takes() -> list[Episode]:
    """Two takes of a right hand with the commands that ``retarget`` computes for each."""
    made = []
    for seed, task in enumerate(("pinch", "open")):
        recording = SyntheticOperator(seed=seed).record(0.3)
        commands = execute(plan(recording, request(FORMER))).commands
        made.append(Episode(recording, commands, {"hand": FORMER}, task=task, name=f"take {seed}"))
    return made


@pytest.fixture
def source(takes: list[Episode], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The takes as a data set of ``convert``, each in its own data file."""
    monkeypatch.setattr("smooth_operator.episode_files.lerobot.writer.FILE_MB", 0)
    write_dataset(tmp_path / "set", [lambda take=take: take for take in takes], fps=100)
    return tmp_path / "set"


def read(folder: Path, number: int = 0) -> dict[str, np.ndarray]:
    table = pq.read_table(folder / f"data/chunk-000/file-{number:03d}.parquet", partitioning=None)
    return {name: np.array(table.column(name).to_pylist()) for name in table.column_names}


def info(folder: Path) -> dict[str, Any]:
    return dict(json.loads((folder / "meta/info.json").read_text()))


def test_the_same_hand_gets_the_same_actions(source, tmp_path):
    status = main(
        f"retarget --dataset {source} --hand {FORMER} --method joint_angle --quiet "
        f"--output {tmp_path / 'again'}".split()
    )
    assert status == 0
    for number in (0, 1):
        old, new = read(source, number), read(tmp_path / "again", number)
        np.testing.assert_allclose(new["action"], old["action"], atol=1e-5)
        state = np.concatenate([new["action"][:1], new["action"][:-1]])
        np.testing.assert_array_equal(new["observation.state"], state)
        kept = old.keys() & new.keys() - {"action", "observation.state"}
        assert {"right_landmarks", "right_landmarks_valid", "stamp", "timestamp"} < kept
        for name in kept:
            np.testing.assert_array_equal(new[name], old[name], err_msg=name)


def test_another_hand(source, tmp_path, takes):
    made = retarget_dataset(source, tmp_path / "new", request(NEW))
    hand = request(NEW).load_hand("right")
    names = [f"{name}.pos" for name in hand.joint_names]
    described = info(tmp_path / "new")
    for name in ("action", "observation.state"):
        feature = {"dtype": "float32", "shape": [len(names)], "names": names}
        assert described["features"][name] == feature
    assert not {"joint_positions", "status", "latency_ms"} & described["features"].keys()
    assert described["robot_type"] == NEW
    assert {k: described[k] for k in ("total_episodes", "total_frames", "fps")} == {
        k: info(source)[k] for k in ("total_episodes", "total_frames", "fps")
    }
    stats = json.loads((tmp_path / "new/meta/stats.json").read_text())
    assert stats.keys() == described["features"].keys()
    actions = np.concatenate([read(tmp_path / "new", n)["action"] for n in (0, 1)])
    np.testing.assert_allclose(stats["action"]["mean"], actions.mean(axis=0), atol=1e-6)
    assert open_dataset(tmp_path / "new").row(1)["tasks"] == ["open"]
    for number, take in enumerate(takes):
        back = read_episode(tmp_path / "new", episode=number)
        assert back.name == take.name
        np.testing.assert_array_equal(back.recording.landmarks, take.recording.landmarks)
        expected = execute(plan(take.recording, request(NEW))).commands.joint_positions
        np.testing.assert_allclose(read(tmp_path / "new", number)["action"], expected, atol=1e-5)
    assert made["source"]["robot_type"] == FORMER
    assert made["configuration"]["hand"] == NEW
    assert json.loads((tmp_path / "new/meta/smooth_operator.json").read_text()) == made


def test_both_hands_with_wrists_and_videos(tmp_path):
    """A data set of ``dataset``: the action stays the state of the next frame."""
    film = mp4(tmp_path / "film.mp4")
    with WRITERS.load("lerobot").open(tmp_path / "set", WritingOptions(videos="copy")) as writer:
        for number in range(2):
            writer.write(robot_clip(number, frames=8, video=film, video_start_s=0.4 * number))
    retarget_dataset(tmp_path / "set", tmp_path / "new", request(NEW))
    old, new = read(tmp_path / "set"), read(tmp_path / "new")
    names = info(tmp_path / "new")["features"]["action"]["names"]
    former = info(tmp_path / "set")["features"]["action"]["names"]
    sides = [name.partition("_")[0] for name in names]
    assert sides == sorted(sides, reverse=True)
    wrists = [name for name in former if "_tcp." in name]
    assert [name for name in names if "_tcp." in name] == wrists
    for column in ("action", "observation.state"):
        picked = [names.index(name) for name in wrists], [former.index(name) for name in wrists]
        np.testing.assert_array_equal(new[column][:, picked[0]], old[column][:, picked[1]])
    joints = [i for i, name in enumerate(names) if "_tcp." not in name]
    state, action = new["observation.state"][:8, joints], new["action"][:8, joints]
    np.testing.assert_array_equal(action, np.concatenate([state[1:], state[-1:]]))
    assert np.ptp(state, axis=0).max() < 1e-4  # the fingers of these clips do not move
    assert np.abs(state).max() > 0.0
    video = "videos/observation.images.camera/chunk-000/file-000.mp4"
    assert (tmp_path / "new" / video).samefile(tmp_path / "set" / video)
    rows = [open_dataset(tmp_path / name).row(1) for name in ("set", "new")]
    place = "videos/observation.images.camera/from_timestamp"
    assert rows[0][place] == rows[1][place] > 0.0


class Stopping(Reporter):
    """Ends the run in its second episode."""

    @contextmanager
    def counting(self, name: str, total: int, unit: str, **_: Any) -> Iterator[Any]:
        episodes: list[int] = []

        def advance(count: int = 1, **_: Any) -> None:
            if episodes:
                raise KeyboardInterrupt
            episodes.append(count)

        yield advance


def test_a_stopped_run_leaves_nothing(source, tmp_path):
    with pytest.raises(KeyboardInterrupt):
        retarget_dataset(source, tmp_path / "new", request(NEW), reporter=Stopping())
    assert {p.name for p in tmp_path.iterdir()} == {"set"}


def test_what_can_not_be_retargeted(source, tmp_path, takes):
    def refused(folder: Path, match: str, **changes: Any) -> None:
        with pytest.raises(RecordingError, match=match):
            retarget_dataset(folder, tmp_path / "new", request(NEW, **changes))
        assert not (tmp_path / "new").exists()

    refused(
        source, "it contains only the right human hand, but side 'left' was requested", side="left"
    )
    robot = tmp_path / "robot"
    write_dataset(robot, [lambda: replace(takes[0], recording=None)])
    refused(
        robot, "expected the columns right_landmarks or left_landmarks .* smooth-operator-lerobot-"
    )
    unseen = replace(takes[0].recording, valid=np.zeros((len(takes[0].recording), 21), bool))
    write_dataset(tmp_path / "unseen", [lambda: replace(takes[0], recording=unseen)])
    refused(tmp_path / "unseen", "no human hand is seen in any frame; delete the episode")
    with pytest.raises(OutputError, match="it already exists; choose another name, or remove it"):
        retarget_dataset(source, robot, request(NEW))
    assert main(f"retarget --dataset {tmp_path / 'none'} --output {tmp_path / 'new'}".split()) == 2
