"""The command line, end to end: what it writes, what it prints, and what it says when it can't."""

import json
import os
import re
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from processes import python

from smooth_operator import Retargeter, load_hand, read_commands, read_recording
from smooth_operator.cli import main
from smooth_operator.cli.console import print_summary
from smooth_operator.errors import RecordingError
from smooth_operator.metrics import METRICS
from smooth_operator.plugins import Entry
from smooth_operator.retargeting.presets import PRESETS
from smooth_operator.retargeting.sbr.method import SbrConfig
from smooth_operator.retargeting.sbr.sampling import SamplingConfig
from smooth_operator.synthetic import SyntheticOperator
from smooth_operator.teleop.recording import read_log
from smooth_operator.types import HandRecording, Side, Status

TINY = ("--method", "sbr", "--preset", "tiny")
QUICK = ("--method", "joint_angle")  # where the method doesn't matter
TOP_KEYS = {metric.name.split(".")[0] for metric in METRICS}

Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def run(run, monkeypatch) -> Run:
    # The smallest SBR there is: it compiles in a second. No cache, which would be global state.
    tiny = SbrConfig(sampling=SamplingConfig(samples=32, elites=8, cycles=2))
    monkeypatch.setitem(PRESETS["sbr"], "tiny", tiny)
    monkeypatch.setenv("SMOOTH_OPERATOR_CACHE", "off")
    return run


def recording(side: Side = "right", frames: int = 30) -> HandRecording:
    return SyntheticOperator(seed=2, side=side).record(frames / 100)


@pytest.fixture
def glove(tmp_path) -> Path:
    """A recording that says everything about itself."""
    return save(tmp_path / "glove.npz", recording())


def save(path: Path, hand: HandRecording) -> Path:
    np.savez(path, landmarks=hand.landmarks, timestamps=hand.stamps, side=hand.side)
    return path


def test_demo_writes_a_consistent_folder(run, tmp_path, monkeypatch):
    folder = tmp_path / "new" / "demo"
    options = ("--no-view", *TINY, "--landmark-loss", 0.05, "--duration", 0.5)
    status, out, err = run("demo", "--output", folder, *options)
    assert status == 0, err
    assert "retargeting" in err
    assert len(re.findall(r"^(good|look|–) +[A-Z0-9]", out, re.MULTILINE)) == 5
    assert "Next: try smooth-operator teleop" in out
    found = {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}
    plots = {f"plots/{name}.svg" for name in ("fingertips", "joints", "latency")}
    files = {"commands.npz", "commands.json", "config.json", "log.mcap", "metrics.json"}
    assert found == files | plots | {name.replace("svg", "png") for name in plots}

    commands, log = read_commands(folder / "commands.npz"), read_log(folder / "log.mcap")
    np.testing.assert_array_equal(commands.joint_positions, log.commands.joint_positions)
    np.testing.assert_array_equal(commands.stamps, log.recording.stamps)
    metrics = json.loads((folder / "metrics.json").read_text(encoding="utf-8"))
    assert metrics.keys() >= TOP_KEYS
    assert metrics["frames"] == len(commands) == 50
    assert metrics["status"]["invalid_landmarks"] == np.sum(commands.status != Status.OK) > 0
    config = json.loads((folder / "config.json").read_text(encoding="utf-8"))
    assert config == log.config
    assert config["operator"]["tracker"]["landmark_loss"] == 0.05
    assert config["config"]["sampling"]["samples"] == 32
    assert config["versions"]["jax"]

    # An earlier demo is replaced; another kind of folder is not.
    (folder / "notes.txt").write_text("mine", encoding="utf-8")
    again = ("--no-view", "--method", "joint_angle", "--duration", 0.2, "--quiet")
    monkeypatch.setattr("smooth_operator.reporting.run_plots.save_plots", lambda *_: None)
    some = ("--side", "left", "--fingers", "thumb,index,pinky=ring")
    status, *_ = run("demo", "--output", folder, *again, *some)
    assert status == 0
    assert read_recording(folder / "log.mcap").side == "left"
    config = json.loads((folder / "config.json").read_text(encoding="utf-8"))
    assert config["fingers"] == {"thumb": "thumb", "index": "index", "pinky": "ring"}
    metrics = json.loads((folder / "metrics.json").read_text(encoding="utf-8"))
    assert metrics["pinch_touch_share_per_finger"].keys() == {"index", "ring"}
    other = tmp_path / "other"
    other.mkdir()
    (other / "thesis.txt").write_text("mine", encoding="utf-8")
    status, out, err = run("demo", "--output", other, *options)
    assert (status, out) == (2, "")
    assert "another folder with --output" in err
    assert [path.name for path in other.iterdir()] == ["thesis.txt"]
    assert (folder / "notes.txt").read_text(encoding="utf-8") == "mine"


def test_retarget_is_the_library_and_repeats_itself(run, glove, tmp_path):
    once, again = tmp_path / "once.npz", tmp_path / "deep" / "er" / "again.npz"
    arguments = ("retarget", glove, *TINY, "--frames", "5:20", "--seed", 4)
    status, out, err = run(*arguments, "--output", once, "--json")
    assert status == 0, err
    metrics = json.loads(out)  # one object and nothing else
    assert metrics.keys() >= TOP_KEYS
    assert metrics["frames"] == 15
    assert metrics["tracking_loss"] > 0

    status, out, err = run(*arguments, "--output", again, "--quiet", "--all")
    assert status == 0
    assert "cosine_similarity" in out
    assert err == ""
    with np.load(once, allow_pickle=False) as a, np.load(again, allow_pickle=False) as b:
        assert {"joint_positions", "joint_names", "timestamps", "latency_ms", "status"} <= set(a)
        assert a["joint_positions"].tobytes() == b["joint_positions"].tobytes()
        np.testing.assert_array_equal(a["timestamps"], recording().stamps[5:20])
        assert a["joint_names"].tolist() == list(load_hand().joint_names)
        direct, _ = Retargeter(config=PRESETS["sbr"]["tiny"], seed=4).run(recording()[5:20])
        np.testing.assert_array_equal(a["joint_positions"], direct.joint_positions)

    config = json.loads(once.with_suffix(".json").read_text(encoding="utf-8"))
    assert config["source"] == {"path": str(glove), "frames": [5, 20]}
    expected = ("mimic_p050", "right", "sbr", "tiny", 4)
    assert tuple(config[k] for k in ("hand", "side", "method", "preset", "seed")) == expected

    before = once.read_bytes()
    status, _, err = run(*arguments, "--output", once)
    assert status == 2
    assert "add --overwrite" in err
    assert once.read_bytes() == before


def test_retarget_follows_the_side_and_the_scale_asked_for(run, tmp_path):
    left, out = save(tmp_path / "left.npz", recording("left", 8)), tmp_path / "out.npz"
    status, _, err = run("retarget", left, *QUICK, "--output", out, "--scale", "calibrate")
    assert status == 0, err
    config = json.loads(out.with_suffix(".json").read_text(encoding="utf-8"))
    assert config["side"] == "left"
    assert 0.5 < config["config"]["alignment"]["scale"] < 1.5
    np.save(tmp_path / "plain.npy", recording(frames=5).landmarks)
    arguments = ("--rate", 100, *QUICK, "--output", out, "--quiet", "--overwrite")
    status, _, err = run("retarget", tmp_path / "plain.npy", *arguments)
    assert status == 0
    assert "assuming right" in err


USER_ERRORS = """
retarget gone.npz                             | no such file
retarget plain.npy                            | --rate 100
retarget mm.npy --rate 60                     | millimetres
retarget glove.npz --side left                | --side right
retarget glove.npz --hand mimic_p5            | Did you mean 'mimic_p050'?
retarget glove.npz --method srb               | Did you mean 'sbr'?
retarget glove.npz --method sbr --preset papr | Did you mean 'paper'?
retarget glove.npz --preset paper             | 'paper' is a preset of sbr
retarget glove.npz --frames 90:99             | selects nothing
retarget glove.npz --scale 77                 | 0.1 to 10
retarget glove.npz --output out.csv           | end in .npz
retarget glove.npz --output glove.npz         | is the recording itself
retarget glove.npz --output foreign.npz       | is not a configuration
retarget glove.npz --output file/out.npz      | a folder is expected
demo --output file                            | it is a file; give the name of a folder
demo --duration 0                             | duration must be
demo --frame-loss -1                          | frame_loss must be
view glove.npz glove.npz                      | not a file of commands
"""
"""What a user gets wrong, and what the message must say."""


def test_user_errors_say_what_to_do_and_leave_nothing(run, glove, tmp_path, monkeypatch):
    monkeypatch.setattr(Retargeter, "run", lambda *_, **__: pytest.fail("the long work began"))
    monkeypatch.chdir(tmp_path)
    np.save("plain.npy", recording(frames=5).landmarks)
    np.save("mm.npy", 1e3 * recording(frames=5).landmarks)
    Path("foreign.json").write_text("{}", encoding="utf-8")
    Path("file").touch()
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    for line in USER_ERRORS.strip().splitlines():
        words, message = (part.strip() for part in line.split("|"))
        to = () if "--output" in words or "view" in words else ("--output", "results/out.npz")
        status, out, err = run(*words.split(), *to)
        assert (status, out) == (2, ""), f"{words}: {err}"
        assert message in err, words
        assert err.startswith("smooth-operator: "), words
        assert "Traceback" not in err, words
    after = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    assert after == before
    assert [path.name for path in tmp_path.iterdir() if path.is_dir()] == []

    with pytest.raises(RecordingError, match="no such file"):
        run("retarget", "gone.npz", "--output", "out.npz", "--debug")
    monkeypatch.setenv("SMOOTH_OPERATOR_DEBUG", "1")
    with pytest.raises(RecordingError, match="no such file"):
        run("retarget", "gone.npz", "--output", "out.npz")


def test_arguments_that_do_not_parse_exit_2_and_help_exits_0(run):
    for arguments in (("retarget",), ("bogus",), ("demo", "--side", "up"), ("view", "a")):
        status, out, err = run(*arguments)
        assert (status, out) == (2, ""), arguments
        assert err
    for arguments in ((), ("--help",), ("retarget", "--help"), ("demo", "-h"), ("view", "-h")):
        status, out, err = run(*arguments)
        assert (status, err) == (0, ""), arguments
        assert "Examples:" in out
    status, out, _ = run("--version")
    assert status == 0
    assert out.split()[0] == "smooth-operator"


def test_stopping_while_writing_leaves_the_former_result(run, glove, tmp_path, monkeypatch):
    out = tmp_path / "out.npz"
    arguments = ("retarget", glove, *TINY, "--frames", ":5", "--overwrite", "--output", out)
    assert run(*arguments)[0] == 0
    before = out.read_bytes()

    def half_written(file: object, **_: object) -> None:
        file.write(b"PK")
        raise KeyboardInterrupt

    monkeypatch.setattr(np, "savez", half_written)
    status, stdout, err = run(*arguments)
    assert (status, stdout) == (130, "")
    assert "stopped" in err
    assert out.read_bytes() == before
    assert sorted(path.name for path in tmp_path.iterdir()) == ["glove.npz", "out.json", "out.npz"]

    demo = ("demo", "--no-view", *TINY, "--duration", 0.1)
    assert run(*demo, "--output", tmp_path / "demo")[0] == 130
    assert not (tmp_path / "demo").exists()


SUMMED: dict[str, object] = {
    "finger_direction_error_deg": 7.25,
    "pinch_touch_share": 0.65,
    "self_collision": {"share": 0.0175},
    "jumps_per_1000": None,
    "latency_ms": {"p99": 12.0},
    "rate_hz": 100.0,
}


def test_a_summary_says_what_is_good_and_what_to_do(capsys):
    colliding = SUMMED | {"self_collision": {"share": 0.5}}
    for method in ("joint_angle", "smooth"):  # the method that ran is not advised
        print_summary("a title", method, colliding, [])
        assert ("--method smooth" in capsys.readouterr().out) == (method != "smooth")
    print_summary("a title", "smooth", SUMMED, ["Next: something"])
    lines = [line.split(maxsplit=1) for line in capsys.readouterr().out.splitlines()]
    assert [mark for mark, _ in lines[1:6]] == ["good", "look", "good", "–", "look"]
    text = " ".join(" ".join(parts) for parts in lines)
    text = " ".join(text.split())  # the terminal wraps sentences
    assert "7.25° away" in text
    assert "1.75 % of the frames" in text
    assert "12 ms (good: up to 10 ms, the time between two frames)" in text
    assert text.count("calibrate") == 1
    assert "doctor" in text
    assert lines[-1] == ["Next:", "something"]


def test_nobody_reading_is_no_error():
    code = "import sys; from smooth_operator.cli import main; sys.exit(main(['demo', '--help']))"
    reader, writer = os.pipe()
    os.close(reader)
    done = subprocess.run(
        [sys.executable, "-c", code], stdout=writer, stderr=subprocess.PIPE, check=False
    )
    os.close(writer)
    assert done.returncode == 141
    assert done.stderr == b""


LEFT = """
import atexit, sys, threading, time
from smooth_operator.cli import process
atexit.register(lambda: print("tidied up"))
def done(**_) -> int:
    threading.Thread(target=time.sleep, args=(600,), daemon=True).start()  # does not answer
    threading.Thread(target=lambda: (time.sleep(0.3), print("written"))).start()
    print("done")
    return 130
process.main = done
sys.exit(process.program())
"""


def test_a_thread_that_does_not_answer_spoils_no_ending():
    """What is to be written is, though the interpreter is not torn down around such a thread."""
    ended = python("-c", LEFT)
    assert (ended.returncode, ended.stderr) == (130, "")
    assert ended.stdout.split("\n") == ["done", "written", "tidied up", ""]


def test_view_finds_the_frames_and_refuses_another_recording(run, glove, tmp_path, monkeypatch):
    out = tmp_path / "out.npz"
    arguments = (*TINY, "--frames", "7:19", "--output", out)
    assert run("retarget", glove, *arguments)[0] == 0
    pages = []
    monkeypatch.setattr("smooth_operator.teleop.pages.serve", lambda page, **_: pages.append(page))
    status, _, err = run("view", out, glove)
    assert status == 0, err
    ((page,),) = pages
    np.testing.assert_array_equal(page.trace.stamps, recording().stamps[7:19])
    np.testing.assert_array_equal(page.trace.joint_positions, read_commands(out).joint_positions)
    assert "tiny" in page.title
    assert run("view", out, out, glove)[0] == 0  # several, side by side
    assert [one.label for one in pages[-1]] == ["sbr tiny (out)"] * 2
    assert pages[-1][0].title == "mimic_p050 right"
    assert "and then the recording" in run("view", glove)[2]
    out.with_suffix(".json").unlink()  # the commands alone will do
    assert run("view", out, glove)[0] == 0

    other = save(tmp_path / "other.npz", SyntheticOperator(rate_hz=93).record(1.0))
    status, _, err = run("view", out, other)
    assert status == 2
    assert "was not made from" in err


def test_a_stop_says_in_one_line_how_to_go_on(run, glove, tmp_path, monkeypatch):
    def stop(*_: object, **more: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("smooth_hand_datasets.commands.dataset.make_dataset", stop)
    folder = tmp_path / "results"
    status, out, err = run("retarget", glove.parent, *TINY, "--output", folder)
    assert (status, out) == (130, "")
    assert [line for line in err.splitlines() if "stopped" in line] == [
        f"smooth-operator: stopped; run the same command again to continue in {folder}"
    ]


def test_a_ctrl_c_that_the_garbage_collector_swallows_comes_again(monkeypatch, capsys):
    class Swallowing:
        def __del__(self) -> None:
            raise KeyboardInterrupt  # where Python only writes a note of it

    class Busy:
        debug = False

        def run(self) -> None:
            Swallowing()
            time.sleep(60)  # unless Ctrl-C comes again

    monkeypatch.setattr("smooth_operator.cli.app.parse", lambda arguments: Busy())
    assert main(["demo"]) == 130
    assert "stopped" in capsys.readouterr().err


def test_ctrl_c_on_a_page_is_the_usual_end(run, monkeypatch):
    def pressed(page: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("smooth_operator.teleop.pages.viser_server.PageServer.wait", pressed)
    status, _, err = run("hands", "show", "leap_hand", "--port", 0, "--no-browser")
    assert (status, "Traceback" in err) == (0, False)
    assert "press Ctrl-C to stop" in err


@pytest.mark.parametrize(
    ("command", "distribution"),
    [
        ("paper --output x", "./research"),
        ("bench --physics", "./research"),
        ("study simulate x", "./research"),
        ("dataset", "./packages/smooth_hand_datasets"),
        ("dataset --help", "./packages/smooth_hand_datasets"),
        ("dataset takes/ --output out", "./packages/smooth_hand_datasets"),
        ("retarget . --output out", "./packages/smooth_hand_datasets"),
        ("retarget --dataset fingers --output out", "./packages/smooth_hand_datasets"),
        ("bench recording.npz --output out", "./packages/smooth_operator_benchmark"),
        ("bench --help", "./packages/smooth_operator_benchmark"),
        ("study", "./packages/smooth_operator_study"),
        ("study --help", "./packages/smooth_operator_study"),
        ("study analyze trials.csv --output out", "./packages/smooth_operator_study"),
        ("hardware list", "./packages/smooth_operator_devices"),
        ("hardware --help", "./packages/smooth_operator_devices"),
    ],
)
def test_a_command_of_another_distribution_says_what_to_install(
    command, distribution, monkeypatch, capsys
):
    monkeypatch.setattr("smooth_operator.plugins._installed", lambda group: {})
    assert main(command.split()) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.endswith(distribution)
    assert "which is not installed; in a clone of the repository, run: python" in line


def test_a_plugin_adds_a_command_to_a_group(monkeypatch, capsys):
    entry = Entry("smooth_operator.cli.sample:Sample", "from elsewhere", "elsewhere")
    monkeypatch.setattr("smooth_operator.plugins._installed", lambda group: {"study.draw": entry})
    assert main(["study", "draw", "--help"]) == 0
    assert "usage: smooth-operator study draw" in capsys.readouterr().out
    assert main(["study", "drew"]) == 2
