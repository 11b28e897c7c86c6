"""Results: OUT.npz with OUT.json beside it, and files that are whole or not there."""

import enum
import json
import os
import signal
import stat
import subprocess
import sys
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from smooth_operator.atomic_files import atomic_write
from smooth_operator.errors import ConfigError, OutputError, RecordingError
from smooth_operator.formats.commands import config_path, read_commands, write_commands
from smooth_operator.io.jsonable import to_json
from smooth_operator.types import CommandTrajectory, Status


def trajectory(frames: int = 6, joints: int = 3) -> CommandTrajectory:
    rng = np.random.default_rng(0)
    return CommandTrajectory(
        joint_positions=rng.normal(size=(frames, joints)),
        joint_names=tuple(f"joint_{i}" for i in range(joints)),
        stamps=1.7e9 + np.arange(frames) / 115.0,
        latency_ms=rng.uniform(0.5, 2.0, frames),
        status=np.arange(frames) % len(Status),
    )


@pytest.mark.parametrize("frames", [6, 0])
def test_round_trip(tmp_path, frames):
    commands = trajectory(frames)
    path = tmp_path / "run.1.npz"
    write_commands(path, commands, {"method": "sbr", "seed": np.int64(3)})
    back = read_commands(path)
    for name in ("joint_positions", "stamps", "latency_ms", "status"):
        np.testing.assert_array_equal(getattr(back, name), getattr(commands, name))
    assert back.joint_names == commands.joint_names
    assert sorted(p.name for p in tmp_path.iterdir()) == ["run.1.json", "run.1.npz"]
    assert json.loads(config_path(path).read_text()) == {"method": "sbr", "seed": 3}


def test_stored_form(tmp_path):
    write_commands(tmp_path / "a.npz", trajectory(), {})
    with np.load(tmp_path / "a.npz", allow_pickle=False) as stored:
        forms = {name: (stored[name].dtype.str[1:], stored[name].shape) for name in stored}
        names = stored["status_names"]
        assert [str(names[code]) for code in stored["status"]] == [
            Status(i % len(Status)).name for i in range(6)
        ]
    assert forms["joint_positions"] == ("f8", (6, 3))
    assert forms["joint_names"] == ("U7", (3,))
    assert forms["timestamps"] == ("f8", (6,))
    assert forms["latency_ms"] == ("f8", (6,))
    assert forms["status"] == ("i1", (6,))


def test_status_is_found_by_name(tmp_path):
    write_commands(tmp_path / "a.npz", trajectory(4), {})
    with np.load(tmp_path / "a.npz", allow_pickle=False) as stored:
        arrays = dict(stored)
    arrays["status"] = np.array([1, 0, 0, 2])
    arrays["status_names"] = np.array(["SOLVER_FAILED", "OK", "FROM_THE_FUTURE"])
    np.savez(tmp_path / "b.npz", **arrays)
    with pytest.raises(RecordingError, match=r"status \[2\] is not one of"):
        read_commands(tmp_path / "b.npz")
    arrays["status"][3] = 1
    np.savez(tmp_path / "b.npz", **arrays)
    assert read_commands(tmp_path / "b.npz").status.tolist() == [0, 3, 3, 0]
    del arrays["status_names"]
    np.savez(tmp_path / "b.npz", **arrays)
    assert read_commands(tmp_path / "b.npz").status.tolist() == [1, 0, 0, 1]


@pytest.mark.parametrize(
    ("key", "value", "match"),
    [
        ("joint_positions", None, "it lacks joint_positions"),
        ("status", None, r"it lacks status .*it contains .*timestamps \(6,\)"),
        ("joint_positions", np.zeros(6), "must have shape \\(frames, joints\\)"),
        ("joint_positions", np.zeros((6, 4)), r"joint_names must have shape \(4,\)"),
        ("timestamps", np.zeros(5), r"timestamps must have shape \(6,\).*not \(5,\)"),
        ("latency_ms", np.zeros((6, 1)), "latency_ms must have shape"),
        ("latency_ms", np.array(["a"] * 6), "must hold real numbers"),
        ("joint_names", np.zeros(3), "must hold text"),
        ("joint_names", np.array([None, 1, 2]), "pickled objects"),
        ("status", np.full(6, 9), r"status \[9\] is not one of"),
        ("status", np.array(["OK"] * 6), "status must hold whole numbers"),
    ],
)
def test_bad_results(tmp_path, key, value, match):
    path = tmp_path / "a.npz"
    write_commands(path, trajectory(), {})
    with np.load(path, allow_pickle=False) as stored:
        arrays = dict(stored)
    arrays[key] = value
    np.savez(path, **{name: array for name, array in arrays.items() if array is not None})
    with pytest.raises(RecordingError, match=match) as caught:
        read_commands(path)
    assert str(path) in str(caught.value)


def test_other_files_are_not_results(tmp_path):
    np.save(tmp_path / "a.npy", np.zeros(3))
    with pytest.raises(RecordingError, match="not a file of commands"):
        read_commands(tmp_path / "a.npy")
    (tmp_path / "b.npz").write_bytes(b"PK\x03\x04rubbish")
    with pytest.raises(RecordingError, match="damaged or incomplete"):
        read_commands(tmp_path / "b.npz")
    with pytest.raises(RecordingError, match="no such file"):
        read_commands(tmp_path / "c.npz")


def test_unwritable_results(tmp_path):
    for change, said in (
        ({"joint_names": ("a",)}, "joint_names must have shape"),
        ({"latency_ms": np.zeros(2)}, "latency_ms must have shape"),
        ({"joint_positions": np.zeros(3)}, "must have shape"),
        ({"status": np.full(6, 42)}, r"status \[42\]"),
    ):
        with pytest.raises(RecordingError, match=said):
            write_commands(tmp_path / "a.npz", replace(trajectory(), **change), {})
    with pytest.raises(OutputError, match=r"must end in .npz, for example out.npz"):
        write_commands(tmp_path / "out", trajectory(), {})
    with pytest.raises(OutputError, match="does not exist; create it first"):
        write_commands(tmp_path / "no" / "a.npz", trajectory(), {})
    with pytest.raises(ConfigError, match=r"configuration\.x is a object"):
        write_commands(tmp_path / "a.npz", trajectory(), {"x": object()})
    assert not list(tmp_path.iterdir())


def test_old_file_survives_a_failure(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text("old")

    def interrupted() -> None:
        with atomic_write(path) as file:
            file.write(b"half of the n")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]
    with atomic_write(path) as file:
        file.write(b"new")
        file.flush()
        assert path.read_text() == "old"  # until the block ends
    assert path.read_text() == "new"
    assert list(tmp_path.iterdir()) == [path]


KILLED = """
import os, signal, sys
from pathlib import Path
from smooth_operator.atomic_files import atomic_write
from smooth_operator.episode_files.staging import staged_file, staged_folder
at = Path(sys.argv[1])
with atomic_write(at / "a.json"), staged_file(at / "a.h5") as file:
  with staged_folder(at / "set") as folder:
      file.write_bytes(b"half")
      (folder / "part").write_bytes(b"half")
      os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.skipif(os.name == "nt", reason="Windows has no SIGKILL")
def test_the_next_write_removes_files_of_a_killed_process(tmp_path, monkeypatch):
    run = subprocess.run([sys.executable, "-c", KILLED, str(tmp_path)], check=False)
    assert run.returncode == -signal.SIGKILL
    assert len(list(tmp_path.iterdir())) == 3
    foreign = [".a.json.tmp", ".a.json.0123abcd.tmp", ".a.json.00000000-1.0123abcd.tmp"]
    for name in foreign:  # no file of this package, or one of another machine
        (tmp_path / name).touch()
    with atomic_write(tmp_path / "b.json") as file:
        file.write(b"{}")
        monkeypatch.setattr("smooth_operator.atomic_files._swept", set())  # as another process
        with atomic_write(tmp_path / "c.json"):
            pass  # and what is being written stays
    names = sorted(path.name for path in tmp_path.iterdir())
    assert names == [*sorted(foreign), "b.json", "c.json"]


@pytest.mark.skipif(os.name == "nt", reason="POSIX permissions")
def test_mode_of_a_new_file(tmp_path):
    (tmp_path / "plain").touch()
    with atomic_write(tmp_path / "atomic") as file:
        file.write(b"x")
    modes = [stat.S_IMODE((tmp_path / name).stat().st_mode) for name in ("plain", "atomic")]
    assert modes[0] == modes[1]


@pytest.mark.skipif(os.name == "nt", reason="links need a privilege on Windows")
def test_links_are_followed_and_devices_left_alone(tmp_path):
    target = tmp_path / "target"
    target.write_text("old")
    link = tmp_path / "link"
    link.symlink_to(target)
    with atomic_write(link) as file:
        file.write(b"new")
    assert link.is_symlink()
    assert target.read_text() == "new"
    fifo = tmp_path / "fifo"
    os.mkfifo(fifo)
    with pytest.raises(OutputError, match="not a regular file"), atomic_write(fifo):
        pytest.fail("the block must not run")
    assert stat.S_ISFIFO(fifo.stat().st_mode)


def test_bad_targets(tmp_path):
    with pytest.raises(FileNotFoundError) as caught, atomic_write(tmp_path / "a.txt"):
        (tmp_path / "input.txt").read_bytes()  # an error about another file stays as it is
    assert not isinstance(caught.value, OutputError)
    for path, match in (
        (tmp_path, "it is a folder"),
        (tmp_path / "no" / "a", "does not exist"),
        (tmp_path / ("x" * 400), "name is too long|choose another path"),
    ):
        with pytest.raises(OutputError, match=match), atomic_write(path) as file:
            file.write(b"x")
    assert not list(tmp_path.iterdir())


class Colour(enum.Enum):
    RED = 1


@dataclass(frozen=True)
class Settings:
    limit: float = float("inf")
    colour: Colour = Colour.RED
    names: tuple[str, ...] = ("a", "b")
    table: dict[Any, Any] = field(default_factory=lambda: {Status.OK: np.float32(0.5), 3: None})


def test_to_json_is_strict_and_complete():
    value = {
        "settings": Settings(),
        "array": np.array([[1.0, np.nan]]),
        "flag": np.bool_(True),
        "path": Path("a") / "b",
        "set": {3, 1, 2},
        "status": Status.SOLVER_FAILED,
        "text": "é",
    }
    table = {"OK": 0.5, "3": None}

    def reject(constant: str) -> None:
        pytest.fail(f"{constant} is not JSON")

    assert json.loads(to_json(value), parse_constant=reject) == {
        "settings": {"limit": "inf", "colour": "RED", "names": ["a", "b"], "table": table},
        "array": [[1.0, "nan"]],
        "flag": True,
        "path": str(Path("a") / "b"),
        "set": [1, 2, 3],
        "status": "SOLVER_FAILED",
        "text": "é",
    }


def test_to_json_names_the_place():
    with pytest.raises(ConfigError, match=r"configuration\.a\[1\].b is a builtin_function"):
        to_json({"a": [0, {"b": print}]})
