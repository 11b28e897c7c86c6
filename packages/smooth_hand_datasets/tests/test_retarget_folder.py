"""A folder into a folder, by the pipeline of data sets (``test_dataset_pipeline``).

Resumption after a killed run, and after a change of a recording or of the code, is tested there.
"""

import functools
import json
import os
import shutil
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from two_hands import Counting

import smooth_hand_datasets.pipeline.run as pipeline
from smooth_hand_datasets.pipeline.request import MirrorRequest
from smooth_hand_datasets.pipeline.run import make_dataset
from smooth_hand_datasets.pipeline.sources import find_items
from smooth_hand_datasets.pipeline.work import Job, Results
from smooth_hand_datasets.pipeline.writing import Summary
from smooth_operator import read_commands, read_recording
from smooth_operator.atomic_files import claimed
from smooth_operator.errors import ConfigError, OutputError, RecordingError, UnknownNameError
from smooth_operator.execution import checked
from smooth_operator.planning import RetargetRequest, make_request
from smooth_operator.reporter import Reporter
from smooth_operator.retargeting.batching import BLOCK, BatchRetargeter
from smooth_operator.retargeting.preset_files import method_config
from smooth_operator.synthetic import SyntheticOperator
from smooth_operator.teleop.recording import LogWriter
from smooth_operator.types import HandRecording, Side

FAST = method_config("joint_angle")  # the quickest to compile
ASKED = RetargetRequest(
    hand="mimic_p050", method="joint_angle", preset="default", config=FAST, seed=3
)
METHOD = ("--method", "joint_angle")
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
            recording.landmarks[10:13] = np.nan
        save(at / f"{name}.npz", recording)
    return at


def do(
    folder: Path,
    output: Path,
    asked: RetargetRequest = ASKED,
    reporter: Reporter | None = None,
    again: bool = False,
    **more: Any,
) -> Summary:
    """As the command does it, in this process."""
    request = MirrorRequest(sources=(str(folder),), output=output, **{"workers": 0} | more)
    return make_dataset(request, reporter, resolved=asked, again=again)


def contents(output: Path) -> Bytes:
    """The results, without the report and the folder that later runs go on from."""
    own = {".work", "report.json", "episodes.jsonl"}
    files = (path.relative_to(output) for path in output.rglob("*") if path.is_file())
    return {
        name.as_posix(): (output / name).read_bytes() for name in files if name.parts[0] not in own
    }


@pytest.fixture(scope="module")
def whole(folder, tmp_path_factory) -> Path:
    """A folder of results with all that later runs go on from; one process, undisturbed."""
    output = tmp_path_factory.mktemp("whole") / "out"
    assert do(folder, output).failed == {}
    return output


@pytest.fixture(scope="module")
def expected(whole) -> Bytes:
    found = contents(whole)
    assert found.keys() == {f"{name}.{suffix}" for name in FRAMES for suffix in ("npz", "json")}
    return found


def test_a_result_equals_that_of_the_library(folder, whole):
    """Of a batch to the last bit, whatever else is in it; of a frame after a frame but for
    rounding."""
    retargeter = BatchRetargeter(config=FAST, seed=3)
    for name, frames in FRAMES.items():
        recording = read_recording(folder / f"{name}.npz")
        ((alone, loss),) = retargeter.batch([recording])
        live, _ = retargeter.run(recording)
        config = json.loads((whole / f"{name}.json").read_text(encoding="utf-8"))
        commands = read_commands(whole / f"{name}.npz")
        assert commands.joint_positions.tobytes() == alone.joint_positions.tobytes()
        np.testing.assert_allclose(commands.joint_positions, live.joint_positions, atol=1e-4)
        np.testing.assert_array_equal(commands.status, live.status)
        np.testing.assert_array_equal(commands.stamps, recording.stamps)
        assert np.isnan(commands.latency_ms).all()
        figures = config["figures"]
        assert figures["right.tracking_loss"] == pytest.approx(float(np.nanmean(loss)), rel=1e-6)
        assert config["held"] == (3 if name == "b" else 0)
        assert config["side"] == recording.side
        assert config["recording"]["frames"] == frames
        assert config["source"][0]["path"] == f"{name}.npz"
        assert "created" not in config


def killed_once(job: Job) -> Results:
    """``do_job``, but the process that first packs ``c`` is killed in the middle of it."""
    mark = job.folder / "killed"
    if any(item.name == "deep/c" for item in job.items) and not mark.exists():
        job.folder.mkdir(parents=True, exist_ok=True)
        (job.folder / ".pack-0.zip.00000000-7.abc12345.tmp").write_bytes(b"half")
        mark.touch()
        os.kill(os.getpid(), 9)
    return REAL_JOB(job)


REAL_JOB = pipeline.do_job


@pytest.fixture
def copy(folder, whole, tmp_path) -> tuple[Path, Path]:
    """Folders of recordings and of finished results, to be changed."""
    shutil.copytree(folder, tmp_path / "in")  # with the dates
    shutil.copytree(whole, tmp_path / "out")
    return tmp_path / "in", tmp_path / "out"


def kept(recordings: Path, output: Path, request: RetargetRequest = ASKED, **more: Any) -> int:
    """Number of recordings that a run keeps."""
    count = Counting()
    do(recordings, output, request, count, **more)
    return count.kept


def test_finished_results_are_kept(copy, expected):
    recordings, output = copy
    before = {path: path.stat().st_mtime_ns for path in output.rglob("*.npz")}
    os.utime(recordings / "a.npz")  # another date, the same content
    assert kept(recordings, output) == len(FRAMES)
    # A rate is for recordings without stamps, and these have theirs.
    assert kept(recordings, output, replace(ASKED, rate=50.0)) == len(FRAMES)
    assert {path: path.stat().st_mtime_ns for path in output.rglob("*.npz")} == before
    report = json.loads((output / "report.json").read_text(encoding="utf-8"))
    assert report["notes"] == [f"3 of {sum(FRAMES.values())} frames had no usable hand"]
    assert kept(recordings, output, again=True) == 0
    assert contents(output) == expected


@pytest.mark.parametrize(
    "change",
    [{"seed": 4}, {"frames": ":20"}, {"config": FAST.with_alignment(scale=0.8)}],
)
def test_another_request_replaces_the_results(copy, change, expected):
    recordings, output = copy
    for name in FRAMES:
        if name not in ("a", "e"):
            (recordings / f"{name}.npz").unlink()
    count = Counting()
    do(recordings, output, replace(ASKED, **change), count)
    assert (count.kept, count.again) == (0, "making 2 results again")
    assert (output / "a.json").read_bytes() != expected["a.json"]
    assert (output / "b.npz").read_bytes() == expected["b.npz"]  # of no recording that is there


def damage(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)


@pytest.mark.parametrize(
    "spoil",
    [
        lambda output: damage(output / "a.npz"),
        lambda output: (output / "a.npz").unlink(),
        lambda output: (output / "a.json").unlink(),
        lambda output: (output / ".a.npz.00000000-7.0123abcd.tmp").write_bytes(b"half"),
        lambda output: (output / "a.npz").write_bytes(b""),
        lambda output: shutil.copy(output / "e.npz", output / "a.npz"),
    ],
    ids=["a bit", "no result", "no json", "unfinished", "empty", "another's"],
)
def test_a_damaged_result_is_written_again(copy, spoil, expected):
    recordings, output = copy
    spoil(output)
    assert kept(recordings, output) == len(FRAMES)
    assert contents(output) == expected


def test_two_runs_in_one_folder_are_refused(tmp_path):
    pytest.importorskip("fcntl")
    with claimed(tmp_path):
        other = pytest.raises(OutputError, match="another run is writing there")
        with other, claimed(tmp_path):
            pass
    with claimed(tmp_path):
        pass
    assert list(tmp_path.iterdir()) == []


def test_files_that_are_found(tmp_path, expected):
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
    found = find_items([str(tmp_path)], layout="files", leave_out=tmp_path / "results")
    assert [item.name for item in found.items] == ["broken", "glove", "plain", "run"]
    assert found.passed_over == {".npz": 1, ".txt": 1}


def test_refused_before_any_work(tmp_path):
    recordings, output = tmp_path / "in", tmp_path / "out"
    for name in ("one", "report", "taken", "beside", "deep/under", "fine"):
        save(recordings / f"{name}.npz", hand(3))
    shutil.copy(recordings / "one.npz", recordings / "one.npy")
    output.mkdir()
    (output / "taken.npz").write_text("my thesis", encoding="utf-8")
    (output / "beside.json").write_text("{}", encoding="utf-8")
    (output / "deep").write_text("mine", encoding="utf-8")
    count = Counting()
    summary = do(recordings, output, reporter=count)
    assert count.items == summary.episodes == 1
    reasons = summary.failed
    assert "one.npy and one.npz would both become one.npz" in reasons["one"]
    assert reasons["one"] == reasons["one~2"]
    assert "rename the recording" in reasons["report"]
    assert "something other than commands" in reasons["taken"]
    assert "beside.json" in reasons["beside"]
    assert "deep is not a folder" in reasons["deep/under"]
    assert (output / "taken.npz").read_text(encoding="utf-8") == "my thesis"
    assert len(read_commands(output / "fine.npz")) == 3
    for there in (recordings, tmp_path):
        with pytest.raises(OutputError, match="it contains the recordings"):
            do(recordings, there)


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
def run(run) -> Run:
    return functools.partial(run, "retarget")


def test_the_command_retargets_a_folder_and_lists_failures(
    run, folder, expected, tmp_path, monkeypatch
):
    """The worker is killed once in the middle of the folder, and nothing is lost."""
    if sys.platform != "win32":  # it has no SIGKILL
        monkeypatch.setattr(pipeline, "do_job", killed_once)
    recordings, output = tmp_path / "in", tmp_path / "new" / "out"
    shutil.copytree(folder, recordings)
    (recordings / "deep" / "[bold]empty.npz").write_bytes(b"")
    np.save(recordings / "norate.npy", hand(8).landmarks)
    options = (recordings, "--output", output, *METHOD, "--seed", 3)
    status, out, err = run(*options, "--workers", 1)
    assert status == 1, err
    assert list(output.rglob("killed")) or sys.platform == "win32"
    assert "7/7 clips" in err
    assert "5 clips (" in out
    assert "2 failed" in out
    assert "deep/[bold]empty" in out
    assert "the file is empty" in out
    assert "--rate" in out
    assert f"3 of {sum(FRAMES.values())} frames had no usable hand" in out
    assert str(output / "report.json") in " ".join(out.split())
    assert contents(output) == expected

    report = json.loads((output / "report.json").read_text(encoding="utf-8"))
    assert (report["episodes"], report["frames"]) == (5, sum(FRAMES.values()))
    assert list(report["failed"]) == ["deep/[bold]empty", "norate"]
    lines = (output / "episodes.jsonl").read_text(encoding="utf-8").splitlines()
    assert [json.loads(line)["clip"] for line in lines] == sorted(FRAMES)

    # Mended, the rest is done, and what was done is kept.
    save(recordings / "deep" / "[bold]empty.npz", hand(6, side="left"))
    status, out, err = run(*options, "--rate", 100, "--workers", 0, "--json", "--quiet")
    assert (status, err) == (0, "")
    report = json.loads(out)
    assert (report["episodes"], report["failed"]) == (7, {})
    assert "1 clip: the side is not stated, so right is assumed" in report["notes"][0]
    sides = {}
    for name in ("norate", "deep/[bold]empty"):
        config = json.loads((output / f"{name}.json").read_text(encoding="utf-8"))
        sides[name] = (config["side"], config["rate"])
    assert sides == {"norate": ("right", 100.0), "deep/[bold]empty": ("left", None)}
    assert len(read_commands(output / "norate.npz")) == 8
    status, out, err = run(*options, "--rate", 100)
    assert status == 0
    assert "0 to retarget, 7 already done" in err


def test_every_run_shows_the_notes_on_the_reading(run, tmp_path):
    (tmp_path / "in").mkdir()
    arrays = {"landmarks": hand(20).landmarks, "timestamps": hand(20).stamps, "side": "right"}
    np.savez(tmp_path / "in" / "a.npz", **arrays, is_tracked=np.ones(20, bool))
    options = (tmp_path / "in", "--output", tmp_path / "out", *METHOD, "--workers", 0)
    for _ in range(2):
        status, out, err = run(*options)
        assert status == 0, err
        assert "1 clip: ignored: is_tracked" in out


def test_requests_that_the_command_refuses(run, folder, tmp_path):
    empty = tmp_path / "empty"
    empty.mkdir()
    output = tmp_path / "out"
    other = tmp_path / "other"
    other.mkdir()
    (other / "report.json").write_text("{}", encoding="utf-8")
    one = folder / "a.npz"
    for arguments, reason in (
        ((empty, "--output", output), "nothing to retarget in"),
        ((folder, "--output", folder), "it contains the recordings"),
        ((folder, "--output", tmp_path / "out.npz"), "name a folder"),
        ((folder, "--output", other), "report.json"),
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
        *(shared / "recordings", "--output", tmp_path / "out", *METHOD),
        *("--rate", 30, "--frames", ":200", "--workers", 0, "--json"),
    )
    failed = json.loads(out)["failed"]
    for name in ("manus_right_subject-000_run-010", "wilor_test_long_21x3", "human_alex_21x3"):
        assert len(read_commands(tmp_path / "out" / f"{name}.npz")) == 200
    # One that holds several poses, and not a recording, says so.
    assert status == (1 if failed else 0), err
    with pytest.raises(RecordingError):
        read_recording(shared / "recordings" / "pinch_poses_wilor_21x3.npz", rate=30)
