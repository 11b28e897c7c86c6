"""A folder into a folder: the same bytes whoever made them, whatever was killed on the way."""

import functools
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from smooth_operator import Retargeter, load_hand, read_commands, read_recording
from smooth_operator.atomic_files import claimed
from smooth_operator.compilation.batching import BLOCK
from smooth_operator.errors import ConfigError, OutputError, RecordingError, UnknownNameError
from smooth_operator.offline import folder as pipeline
from smooth_operator.offline.folder import (
    Entry,
    Job,
    Survey,
    checked,
    find_recordings,
    retarget_all,
    survey,
)
from smooth_operator.planning import RetargetRequest, code_of_commands, make_request
from smooth_operator.retargeting.presets import PRESETS
from smooth_operator.retargeting.sbr.method import SbrConfig
from smooth_operator.retargeting.sbr.sampling import SamplingConfig
from smooth_operator.synthetic import SyntheticOperator
from smooth_operator.teleop.recording import LogWriter
from smooth_operator.types import HandRecording, Side, Status

# A small SBR, quick to compile.
TINY = SbrConfig(sampling=SamplingConfig(samples=256, elites=8, cycles=2, draws="quasi"))
ASKED = RetargetRequest("mimic_p050", "sbr", "tiny", TINY, seed=3)
TINY_SBR = ("--method", "sbr", "--preset", "tiny")
FRAMES = {"a": 30, "b": 2 * BLOCK + 7, "deep/c": BLOCK, "deep/er/d": 90, "e": 1}

Run = Callable[..., tuple[int, str, str]]
Bytes = dict[str, bytes]


pytestmark = pytest.mark.usefixtures("compiled_once")


def hand(frames: int, seed: int = 0, side: Side = "right") -> HandRecording:
    return SyntheticOperator(seed=seed, side=side).record((frames + 0.5) / 100)[:frames]


def save(path: Path, recording: HandRecording) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savez(path, landmarks=recording.landmarks, timestamps=recording.stamps, side=recording.side)
    return path


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """Five recordings, one with lost frames."""
    at = tmp_path_factory.mktemp("data") / "recordings"
    for seed, (name, frames) in enumerate(FRAMES.items()):
        recording = hand(frames, seed)
        if name == "b":
            lost = recording.landmarks.copy()
            lost[10:13] = np.nan
            recording = replace(recording, landmarks=lost, valid=None)
        save(at / f"{name}.npz", recording)
    return at


def do(folder: Path, output: Path, asked: RetargetRequest = ASKED) -> tuple[Survey, list[Entry]]:
    """One after the other, in this process."""
    todo = survey(folder, output, asked)
    return todo, list(retarget_all(todo.jobs, workers=0))


def contents(output: Path) -> Bytes:
    files = (path for path in output.rglob("*") if path.is_file() and path.name != "summary.json")
    return {path.relative_to(output).as_posix(): path.read_bytes() for path in files}


@pytest.fixture(scope="module")
def expected(folder, tmp_path_factory) -> Bytes:
    """What one process makes of the folder, undisturbed."""
    output = tmp_path_factory.mktemp("once") / "out"
    _, entries = do(folder, output)
    assert {entry.state for entry in entries} == {"done"}
    found = contents(output)
    assert found.keys() == {f"{name}.{suffix}" for name in FRAMES for suffix in ("npz", "json")}
    return found


def test_a_result_is_that_of_the_library(folder, expected):
    """Of a batch to the last bit, whatever else is in it; of a frame after a frame but for
    rounding."""
    retargeter = Retargeter(config=TINY, seed=3)
    for name, frames in FRAMES.items():
        recording = read_recording(folder / f"{name}.npz")
        ((alone, loss),) = retargeter.batch([recording])
        live, _ = retargeter.run(recording)
        config = json.loads(expected[f"{name}.json"])
        path = folder.parent / "one.npz"
        path.write_bytes(expected[f"{name}.npz"])
        commands = read_commands(path)
        assert commands.joint_positions.tobytes() == alone.joint_positions.tobytes()
        np.testing.assert_allclose(commands.joint_positions, live.joint_positions, atol=0.02)
        np.testing.assert_array_equal(commands.status, live.status)
        np.testing.assert_array_equal(commands.stamps, recording.stamps)
        assert np.isnan(commands.latency_ms).all()
        assert config["commands"]["tracking_loss"] == float(np.nanmean(loss))
        assert config["commands"]["held"] == (3 if name == "b" else 0)
        assert config["side"] == recording.side
        assert config["recording"]["frames"] == frames
        assert config["source"]["path"] == str(folder / f"{name}.npz")
        assert "created" not in config


@pytest.mark.weekly
def test_with_the_default_method_too(tmp_path):
    """Of two recordings by one retargeter, neither leaves anything to the other."""
    for seed, frames in enumerate((BLOCK + 9, 30)):
        save(tmp_path / "in" / f"{seed}.npz", hand(frames, seed))
    todo, entries = do(tmp_path / "in", tmp_path / "out", make_request(seed=3))
    assert len(todo.jobs) == 2
    assert {entry.state for entry in entries} == {"done"}
    retargeter = Retargeter(seed=3)
    for seed in (0, 1):
        recording = read_recording(tmp_path / "in" / f"{seed}.npz")
        ((direct, _),) = retargeter.batch([recording])
        commands = read_commands(tmp_path / "out" / f"{seed}.npz")
        assert commands.joint_positions.tobytes() == direct.joint_positions.tobytes()
        assert (commands.status == Status.OK).all()


def test_the_longest_is_begun_first(folder, tmp_path):
    names = [job.found.name for job in survey(folder, tmp_path / "out", ASKED).jobs]
    assert names == ["b.npz", "deep/er/d.npz", "deep/c.npz", "a.npz", "e.npz"]


def killed_once(group: Sequence[Job]) -> tuple[Entry, ...]:
    """``retarget_group``, but the process that first writes ``c`` is killed in the middle of it."""
    job = group[0]
    mark = job.output.parent.parent / "killed"
    if job.found.name == "deep/c.npz" and not mark.exists():

        def half(path: Path, *_: object) -> None:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.with_name(f".{path.name}.00000000-7.abc12345.tmp").write_bytes(b"half")
            mark.touch()
            os.kill(os.getpid(), signal.SIGKILL)

        pipeline.write_encoded_commands = half
    return pipeline.retarget_group(group)


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGKILL")
def test_a_killed_worker_loses_nothing(folder, expected, tmp_path, monkeypatch):
    monkeypatch.setattr(pipeline, "MOST", 1)  # each recording is a task
    monkeypatch.setattr(pipeline, "retarget_group", killed_once)
    todo = survey(folder, tmp_path / "out", ASKED)
    entries = list(retarget_all(todo.jobs, workers=1))
    assert {entry.state for entry in entries} == {"done"}
    assert {entry.name: entry.attempts for entry in entries}["deep/c.npz"] == 2
    assert sum(entry.attempts for entry in entries) > len(FRAMES)
    (tmp_path / "out" / "killed").unlink()
    assert contents(tmp_path / "out") == expected


def not_the_last(group: Sequence[Job]) -> tuple[Entry, ...]:
    """``retarget_group``, but ``e`` does not end."""
    if group[0].found.name == "e.npz":
        time.sleep(600)
    return pipeline.retarget_group(group)


RUN = """
import sys
from pathlib import Path
sys.path.insert(0, sys.argv[1])
from smooth_operator.offline import folder
from smooth_operator.offline.folder import retarget_all, survey
from test_retarget_folder import ASKED, not_the_last

if __name__ == "__main__":
    folder.MOST = 2
    folder.retarget_group = not_the_last
    todo = survey(Path(sys.argv[2]), Path(sys.argv[3]), ASKED)
    for entry in retarget_all(todo.jobs, workers=1):
        print(entry.name, flush=True)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGKILL")
def test_a_killed_run_is_resumed(folder, expected, tmp_path):
    script, output = tmp_path / "run.py", tmp_path / "out"
    script.write_text(RUN, encoding="utf-8")
    tests = str(Path(__file__).parent)
    with subprocess.Popen(
        [sys.executable, str(script), tests, str(folder), str(output)], stdout=subprocess.PIPE
    ) as process:
        assert process.stdout.readline()  # one is done, and then
        process.kill()
    before = -1
    while len(contents(output)) != before:  # its worker sees it
        before = len(contents(output))
        time.sleep(0.5)
    assert 0 < before < len(expected), "it was not in the middle"

    # What else a sudden end may leave: an unfinished file, half a result, one without the other.
    done = next(name for name in expected if (output / name).exists() and name.endswith(".npz"))
    (output / done).write_bytes(expected[done][:-100])
    (output / f".{Path(done).name}.00000000-7.0123abcd.tmp").write_bytes(b"half")
    missing = next(n for n in expected if n.endswith(".json") and not (output / n).exists())
    (output / missing).parent.mkdir(parents=True, exist_ok=True)
    (output / missing).write_bytes(expected[missing])
    todo, _ = do(folder, output)  # the rest in this process
    assert todo.leftovers >= 1
    assert todo.remade >= 1
    assert contents(output) == expected


@pytest.mark.weekly
def test_ray_makes_the_same_bytes(folder, expected, tmp_path):
    pytest.importorskip("ray", reason="needs ray: in the clone, pip install '.[cluster]'")
    todo = survey(folder, tmp_path / "out", ASKED)
    entries = list(retarget_all(todo.jobs, workers=1, cluster="local"))
    assert [entry.reason for entry in entries] == [None] * len(FRAMES)
    assert contents(tmp_path / "out") == expected


@pytest.fixture
def copy(folder, expected, tmp_path) -> tuple[Path, Path]:
    """Folders of recordings and of finished results, to be changed."""
    recordings, output = tmp_path / "in", tmp_path / "out"
    shutil.copytree(folder, recordings)  # with the dates
    for name, data in expected.items():
        (output / name).parent.mkdir(parents=True, exist_ok=True)
        (output / name).write_bytes(data)
    return recordings, output


def left(recordings: Path, output: Path, asked: RetargetRequest = ASKED, **more: Any) -> set[str]:
    return {job.found.name for job in survey(recordings, output, asked, **more).jobs}


def test_what_is_finished_is_kept(copy):
    recordings, output = copy
    todo = survey(recordings, output, ASKED)
    assert todo.jobs == []
    assert {(entry.name, entry.state, entry.frames) for entry in todo.settled} == {
        (f"{name}.npz", "kept", frames) for name, frames in FRAMES.items()
    }
    assert sum(entry.held for entry in todo.settled) == 3
    os.utime(recordings / "a.npz")  # another date, the same content
    assert left(recordings, output) == set()
    assert left(recordings, output, overwrite=True) == {f"{name}.npz" for name in FRAMES}
    # A rate is for recordings without stamps, and these have theirs.
    assert left(recordings, output, replace(ASKED, rate=50.0)) == set()


@pytest.mark.parametrize(
    "change",
    [
        {"seed": 4},
        {"frames": ":20"},
        {"scale": 0.8},
        {"side": "left"},
        {"config": replace(TINY, settle_rounds=2)},
    ],
)
def test_another_request_is_another_result(copy, change):
    todo = survey(*copy, replace(ASKED, **change))
    assert len(todo.jobs) == todo.remade == len(FRAMES)


def damage(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)


@pytest.mark.parametrize(
    "spoil",
    [
        lambda recordings, output: save(recordings / "a.npz", hand(30, 9)),
        lambda recordings, output: damage(output / "a.npz"),
        lambda recordings, output: (output / "a.npz").unlink(),
        lambda recordings, output: (output / "a.json").unlink(),
        lambda recordings, output: (output / "a.npz").write_bytes(b""),
        lambda recordings, output: shutil.copy(output / "e.npz", output / "a.npz"),
        lambda recordings, output: of_other_code(output / "a.json"),
    ],
    ids=["new recording", "a bit", "no result", "no json", "empty", "another's", "code"],
)
def test_only_what_is_whole_and_its_own_is_kept(copy, spoil, expected):
    recordings, output = copy
    spoil(recordings, output)
    assert left(recordings, output) == {"a.npz"}


def of_other_code(path: Path) -> None:
    config = json.loads(path.read_text(encoding="utf-8"))
    config["made_by"] = config["made_by"][::-1]
    path.write_text(json.dumps(config), encoding="utf-8")


def test_after_a_change_of_the_code_all_is_made_again(copy, monkeypatch):
    assert not left(*copy)
    names: list[str] = []

    def digest_of(*parts: str) -> str:
        names.extend(parts)
        return "another"

    monkeypatch.setattr("smooth_operator.planning.code_digest", digest_of)
    assert left(*copy) == {f"{name}.npz" for name in FRAMES}
    for name in ("retargeting", "hands", "formats", "io", "offline"):
        assert name in names


def test_after_a_change_of_the_robot_hand_all_is_made_again(copy, monkeypatch, tmp_path):
    hand = load_hand(ASKED.hand_name, "right")
    model = Path(shutil.copy(hand.spec.model, tmp_path))
    same = replace(hand, spec=replace(hand.spec, model=model))
    monkeypatch.setattr(RetargetRequest, "load_hand", lambda self, side: same)
    before = code_of_commands(ASKED)
    model.write_bytes(model.read_bytes() + b"\n")
    assert code_of_commands(ASKED) != before


def test_two_runs_do_not_meet(tmp_path):
    pytest.importorskip("fcntl")
    with claimed(tmp_path):
        other = pytest.raises(OutputError, match="another run is writing there")
        with other, claimed(tmp_path):
            pass
    with claimed(tmp_path):
        pass
    assert list(tmp_path.iterdir()) == []


def test_what_is_found(tmp_path, expected):
    save(tmp_path / "glove.npz", hand(5))
    np.save(tmp_path / "plain.npy", hand(7).landmarks)
    with LogWriter(tmp_path / "run.mcap") as log:
        for frame in hand(6):
            log.write_hand(frame)
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "commands.npz").write_bytes(expected["a.npz"])
    (tmp_path / "results" / "deep").mkdir(parents=True)
    save(tmp_path / "results" / "deep" / "mine.npz", hand(4))
    save(tmp_path / ".hidden" / "x.npz", hand(4))
    save(tmp_path / ".hidden.npz", hand(4))
    (tmp_path / "notes.txt").write_text("mine", encoding="utf-8")
    (tmp_path / "broken.npz").write_bytes(b"PK\x03\x04")
    (tmp_path / "again").symlink_to(tmp_path, target_is_directory=True)
    found, commands = find_recordings(tmp_path, leave_out=tmp_path / "results")
    counted = {item.name: item.frames for item in found}
    assert counted.keys() == {"plain.npy", "run.mcap", "glove.npz", "broken.npz"}
    assert (counted["plain.npy"], counted["glove.npz"], counted["broken.npz"]) == (7, 5, 0)
    assert commands == 1


def test_refused_before_any_work(tmp_path):
    recordings, output = tmp_path / "in", tmp_path / "out"
    one = save(recordings / "one.npz", hand(3))
    shutil.copy(one, recordings / "one.npy")
    save(recordings / "summary.npz", hand(3))
    save(recordings / "taken.npz", hand(3))
    save(recordings / "beside.npz", hand(3))
    save(recordings / "fine.npz", hand(3))
    output.mkdir()
    (output / "taken.npz").write_text("my thesis", encoding="utf-8")
    (output / "beside.json").write_text("{}", encoding="utf-8")
    todo = survey(recordings, output, ASKED)
    assert [job.found.name for job in todo.jobs] == ["fine.npz"]
    reasons = {entry.name: entry.reason or "" for entry in todo.settled}
    assert "one.npy and one.npz would both become one.npz" in reasons["one.npz"]
    assert reasons["one.npz"] == reasons["one.npy"]
    assert "rename it" in reasons["summary.npz"]
    assert "something other than commands" in reasons["taken.npz"]
    assert "beside.json" in reasons["beside.npz"]
    assert (output / "taken.npz").read_text(encoding="utf-8") == "my thesis"
    for there in (recordings, tmp_path):
        with pytest.raises(OutputError, match="the recordings are there"):
            survey(recordings, there, ASKED)


def test_a_request_is_checked_once_and_not_per_recording():
    assert checked(make_request(preset="teleop")) == make_request()
    with pytest.raises(UnknownNameError, match="unknown hand"):
        checked(make_request(hand="foot"))
    with pytest.raises(UnknownNameError, match="unknown method"):
        make_request(method="sbrr")
    for wrong in ({"frames": "1-2"}, {"frames": "5:5"}, {"rate": -1.0}, {"scale": 40.0}):
        with pytest.raises(ConfigError):
            checked(make_request(**wrong))


@pytest.fixture
def run(run, monkeypatch) -> Run:
    monkeypatch.setitem(PRESETS["sbr"], "tiny", TINY)
    return functools.partial(run, "retarget")


def test_the_command_retargets_a_folder_and_says_what_failed(run, folder, expected, tmp_path):
    recordings, output = tmp_path / "in", tmp_path / "new" / "out"
    shutil.copytree(folder, recordings)
    (recordings / "deep" / "[bold]empty.npz").write_bytes(b"")
    np.save(recordings / "norate.npy", hand(8).landmarks)
    options = (recordings, "--output", output, *TINY_SBR, "--seed", 3)
    status, out, err = run(*options, "--workers", 2)
    assert status == 1, err
    assert "7/7 recordings" in err
    assert "5 recordings done (" in out
    assert "0 kept, 2 failed" in out
    assert "deep/[bold]empty.npz" in out
    assert "the file is empty" in out
    assert "--rate" in out
    npz = {name: data for name, data in contents(output).items() if name.endswith(".npz")}
    assert npz == {name: data for name, data in expected.items() if name.endswith(".npz")}

    summary = json.loads((output / "summary.json").read_text(encoding="utf-8"))
    assert (summary["done"], summary["kept"], summary["failed"]) == (5, 0, 2)
    assert summary["frames"] == sum(FRAMES.values())
    assert summary["held"] == 3
    assert summary["created"]
    entries = {entry["name"]: entry for entry in summary["recordings"]}
    assert list(entries) == sorted(entries)
    assert entries["deep/c.npz"]["output"] == "deep/c.npz"
    assert entries["deep/[bold]empty.npz"]["state"] == "failed"

    # Mended, the rest is done, and what was done is kept.
    save(recordings / "deep" / "[bold]empty.npz", hand(6, side="left"))
    status, out, err = run(*options, "--rate", 100, "--workers", 0, "--json", "--quiet")
    assert (status, err) == (0, "")
    summary = json.loads(out)
    assert (summary["done"], summary["kept"], summary["failed"]) == (2, 5, 0)
    entry = next(entry for entry in summary["recordings"] if entry["name"] == "norate.npy")
    assert (entry["side"], entry["side_assumed"]) == ("right", True)
    entry = next(entry for entry in summary["recordings"] if "empty" in entry["name"])
    assert (entry["side"], entry["side_assumed"]) == ("left", False)
    assert len(read_commands(output / "norate.npz")) == 8
    status, out, err = run(*options, "--rate", 100)
    assert status == 0
    assert "0 recordings to retarget, 7 done already" in err


def test_notes_on_the_reading_are_told_by_the_run_that_made_a_result_and_later_ones(run, tmp_path):
    one = hand(20)
    (tmp_path / "in").mkdir()
    np.savez(
        tmp_path / "in" / "a.npz",
        landmarks=one.landmarks, timestamps=one.stamps, side="right", is_tracked=np.ones(20, bool),
    )  # fmt: skip
    options = (tmp_path / "in", "--output", tmp_path / "out", *TINY_SBR, "--workers", 0)
    for _ in range(2):
        status, out, err = run(*options)
        assert status == 0, err
        assert "a.npz: not read: is_tracked" in out


def test_what_the_command_refuses(run, folder, tmp_path):
    empty = tmp_path / "empty"
    empty.mkdir()
    output = tmp_path / "out"
    other = tmp_path / "other"
    other.mkdir()
    (other / "summary.json").write_text("{}", encoding="utf-8")
    one = folder / "a.npz"
    for arguments, reason in (
        ((empty, "--output", output), "no recordings in it"),
        ((folder, "--output", folder), "the recordings are there"),
        ((folder, "--output", tmp_path / "out.npz"), "name a folder"),
        ((folder, "--output", other), "summary.json"),
        ((folder, "--output", output, "--preset", "no"), "unknown preset"),
        ((folder, "--output", output, "--workers", -1), "workers must be 0 or more"),
        ((one, "--output", tmp_path / "one.npz", "--workers", 2), "--workers is for a folder"),
        ((one, "--output", tmp_path / "one.npz", "--cluster", "auto"), "--cluster is for a"),
    ):
        status, out, err = run(*arguments)
        assert (status, out) == (2, ""), arguments
        assert reason in err
    assert not output.exists()


@pytest.mark.shared
def test_real_recordings(run, shared, tmp_path):
    status, out, err = run(
        *(shared / "recordings", "--output", tmp_path / "out", *TINY_SBR),
        *("--rate", 30, "--frames", ":200", "--workers", 0, "--json"),
    )
    summary = json.loads(out)
    states = {entry["name"]: entry["state"] for entry in summary["recordings"]}
    assert states["manus_right_subject-000_run-010.npz"] == "done"
    assert states["wilor_test_long_21x3.npz"] == "done"
    assert states["human_alex_21x3.npy"] == "done"
    # One that holds several poses, and not a recording, says so.
    assert status == (1 if "failed" in states.values() else 0), err
    with pytest.raises(RecordingError):
        read_recording(shared / "recordings" / "pinch_poses_wilor_21x3.npz", rate=30)
