"""Files that are damaged, or made to do harm: each is read soundly or refused in one sentence."""

import errno
import io
import json
import os
import socket
import sys
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import fuzzing
import h5py
import hostile_files
import numpy as np
import pytest

from smooth_operator import method_config, read_recording
from smooth_operator.atomic_files import output_error
from smooth_operator.cli import main
from smooth_operator.errors import ConfigError, DocumentError, OutputError, RecordingError
from smooth_operator.formats import commands as results_module
from smooth_operator.formats.arrays import ARRAYS_RATIO, FREE_BYTES, Allowance
from smooth_operator.formats.commands import encode_commands, read_commands, write_encoded_commands
from smooth_operator.io.documents import json_object, parse_json, read_text
from smooth_operator.io.entries import parse_toml
from smooth_operator.teleop.recording import read_log
from smooth_operator.teleop.recording.convert import read_episode, write_episode

HERE = str(Path(__file__).parent)

limited = pytest.mark.skipif(sys.platform != "linux", reason="limits and peaks are Linux's")


@pytest.fixture(scope="module")
def reader() -> Iterator[Callable[[str, Path], fuzzing.Verdict]]:
    """Calls a reader of ``hostile_files`` in a process with limits."""
    with fuzzing.ReaderProcess([HERE]) as process:
        yield lambda name, path: process.read(f"hostile_files:{name}", path)


def good(folder: Path, name: str = "good.npz") -> Path:
    episode = hostile_files.good_episode()
    write_episode(folder / name, episode)
    return folder / name


def test_json_object_of_other_values_is_none():
    for text in ("[1]", "{", '{"a":' * 2000 + "1" + "}" * 2000, b"\xff", "1"):
        assert json_object(text) is None
    assert json_object('{"do": "status"}') == json_object(b'{"do": "status"}') == {"do": "status"}


@limited
@pytest.mark.parametrize("tries", [12, pytest.param(64, marks=pytest.mark.weekly)])
def test_mutants_are_read_soundly_or_refused(tmp_path, tries):
    for name, counts in hostile_files.campaign(tmp_path, tries).items():
        assert counts["refused"] or name == "overwrite", (name, counts)


def zeros_npz(path: Path, frames: int) -> Path:
    """Zeros that deflate packs a thousandfold."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        head = io.BytesIO()
        about = {"descr": "|i1", "fortran_order": False, "shape": (frames, 21, 3)}
        np.lib.format.write_array_header_1_0(head, about)
        with archive.open("landmarks.npy", "w") as member:
            member.write(head.getvalue())
            for _ in range(frames // 10_000):
                member.write(bytes(10_000 * 63))
    return path


def names_npz(path: Path) -> Path:
    """A billion texts of no characters take no byte."""
    parts = {
        "joint_positions": "'<f8', 'fortran_order': False, 'shape': (0, 1000000000)",
        "joint_names": "'<U0', 'fortran_order': False, 'shape': (1000000000,)",
    }
    with zipfile.ZipFile(path, "w") as archive:
        for name, text in parts.items():
            header = ("{'descr': " + text + ", }").ljust(117) + "\n"
            content = b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header.encode()
            archive.writestr(f"{name}.npy", content)
        for name in ("timestamps", "latency_ms", "status"):
            stream = io.BytesIO()
            np.save(stream, np.zeros(0, np.int8 if name == "status" else float))
            archive.writestr(f"{name}.npy", stream.getvalue())
    return path


def empty_h5(path: Path) -> Path:
    """An array that was never written."""
    with h5py.File(path, "w") as file:
        file.create_dataset("hand/landmarks", (50_000_000, 21, 3), "f8", chunks=(1000, 21, 3))
        file.create_dataset("hand/stamps", (50_000_000,), "f8", chunks=(1000,))
    return path


def packed_log(path: Path, compression: str) -> Path:
    from mcap.writer import CompressionType, Writer

    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=1 << 30, compression=CompressionType[compression])
        writer.start()
        schema = writer.register_schema("s", "jsonschema", b"{}")
        channel = writer.register_channel("/hand", "protobuf", schema, {"version": "3"})
        for _ in range(4):
            writer.add_message(channel, 0, b" " * 20_000_000 + b"{}", 0)
        writer.finish()
    return path


@limited
@pytest.mark.parametrize(
    ("name", "make"),
    [
        ("recording", lambda folder: zeros_npz(folder / "a.npz", 100_000)),
        ("commands", lambda folder: names_npz(folder / "a.npz")),
        ("recording", lambda folder: empty_h5(folder / "a.h5")),
        ("recording", lambda folder: packed_log(folder / "a.mcap", "ZSTD")),
        ("latency", lambda folder: packed_log(folder / "a.mcap", "LZ4")),
    ],
    ids=["zeros", "empty names", "unwritten HDF5", "packed log", "latency of a packed log"],
)
def test_small_files_take_little_memory(tmp_path, reader, name, make):
    verdict = reader(name, make(tmp_path))
    assert verdict.outcome == "refused", verdict
    assert "for a file of this size" in verdict.detail
    assert verdict.megabytes < 200


def test_hours_of_a_real_tracker_are_allowed():
    """25 nodes of 7 numbers at 115 Hz, as float32 without compression, read as float64."""
    frame = 25 * 7 * 4
    for hours in (1, 8, 24):
        size = hours * 3600 * 115 * frame
        Allowance.of(Path("a.npz"), size).take("data", 2 * size)
        Allowance.of(Path("a.npz"), size // 4).take("data", 2 * size)  # packed to a quarter
    assert FREE_BYTES / (21 * 3 * 8) > 600 * 100  # ten minutes, however well they are packed
    with pytest.raises(RecordingError, match="save it without compression"):
        Allowance.of(Path("a.npz"), 10**7).take("data", ARRAYS_RATIO * 10**7 + 1)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="the system has no named pipes")
def test_pipes_and_sockets_are_not_opened(tmp_path, capsys):
    os.mkfifo(tmp_path / "x.npz")
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(str(tmp_path / "s.npz"))
        for name, kind in (("x.npz", "a pipe"), ("s.npz", "a socket")):
            with pytest.raises(RecordingError, match=f"it is {kind}, not a regular file"):
                read_recording(tmp_path / name)
            with pytest.raises(DocumentError, match=kind):
                read_text(tmp_path / name)
    assert main(["latency", str(tmp_path / "x.npz")]) == 2
    assert "regular file" in capsys.readouterr().err


def test_hdf5_links_to_other_files_are_refused(tmp_path):
    good(tmp_path, "secret.h5")
    for name in ("hand", "hand/landmarks"):
        path = good(tmp_path, "linked.h5")
        with h5py.File(path, "r+") as file:
            del file[name]
            file[name] = h5py.ExternalLink("secret.h5", f"/{name}")
        with pytest.raises(RecordingError, match="is a link, and links are not followed"):
            read_episode(path)
    path = good(tmp_path, "outside.h5")
    with h5py.File(path, "r+") as file:
        shape = file["hand/stamps"].shape
        del file["hand/stamps"]
        file["hand"].create_dataset("stamps", shape, "f8", external=[("/etc/hostname", 0, 96)])
    with pytest.raises(RecordingError, match="are in other files"):
        read_episode(path)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[" * 100_000, "levels"),
        ("[" * 900 + "]" * 900, "levels"),
        ('{"a":' * 65 + "1" + "}" * 65, "levels"),
        ("9" * 400, "digits"),
        ("-" + "9" * 5000, "digits"),
        ('"\\ud800"', "surrogates"),
        (b"\xff", "decode"),
        ('["a"', "line 1"),
        (" " * 8_000_001, "bytes"),
    ],
)
def test_json_beyond_bounds(text, said):
    with pytest.raises(DocumentError, match=said):
        parse_json(text)


def test_json_within_bounds():
    deep: Any = 18446744073709551615
    for _ in range(63):
        deep = [deep]
    texts = ["[" * 300, "]}" * 300, 'a"[', "\\", "\U0001f600", "é"]
    for value in (deep, texts, [[i, {"[": []}] for i in range(200)], 1e308, None):
        assert parse_json(json.dumps(value)) == value
        assert parse_json(json.dumps(value, ensure_ascii=False).encode()) == value


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("a = " + "[" * 100_000, "levels"),
        ("a." * 100 + "a = 1", "levels"),
        ("a." * 200_000 + "a = 1", "dots"),
        ("a = " + "9" * 400, "digits"),
        ("a = " + "9" * 5000, "digits"),
        ("a = ", "Invalid value"),
    ],
)
def test_toml_beyond_bounds(text, said):
    with pytest.raises(DocumentError, match=said):
        parse_toml(text)


def test_a_preset_of_a_hundred_billion_samples_is_refused(tmp_path):
    path = tmp_path / "p.toml"
    for value in ("100000000000", "1e11", "9" * 19):
        path.write_text(
            'format = 1\nmethod = "sbr"\nbase = "realtime"\n'
            f'[settings]\n"sampling.samples" = {value}\n'
        )
        with pytest.raises(ConfigError, match="at most 1048576"):
            method_config("sbr", str(path))


@pytest.mark.parametrize("stamp", [np.nan, np.inf, -np.inf])
def test_commands_without_a_time_are_refused(tmp_path, stamp):
    commands = hostile_files.good_episode().commands
    stamps = commands.stamps.copy()
    stamps[3] = stamp
    path = tmp_path / "out.npz"
    with np.load(io.BytesIO(encode_commands(commands))) as file:
        np.savez(path, **{**file, "timestamps": stamps})
    with pytest.raises(RecordingError, match=r"the timestamp of command 3 is -?(nan|inf)"):
        read_commands(path)


def test_latency_of_another_file_names_a_command(tmp_path, capsys):
    path = good(tmp_path)
    assert main(["latency", str(path)]) == 2
    said = capsys.readouterr().err
    assert "smooth-operator teleop" in said
    assert "read_" not in said
    with pytest.raises(RecordingError, match="not a log"):
        read_log(path)


def test_a_result_that_is_not_written_leaves_no_configuration(tmp_path, monkeypatch):
    episode = hostile_files.good_episode()
    encoded = encode_commands(episode.commands)

    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    (tmp_path / "old.json").write_text("old")
    with monkeypatch.context() as patch:
        patch.setattr(results_module.os, "fsync", full)
        for name in ("full.npz", "old.npz"):
            with pytest.raises(OutputError, match="no space is left"):
                write_encoded_commands(tmp_path / name, encoded, {"a": 1})
            with pytest.raises(OutputError, match="no space is left"):
                write_episode(tmp_path / name, episode)
    assert [path.name for path in tmp_path.iterdir()] == ["old.json"]
    assert (tmp_path / "old.json").read_text() == "old"


@pytest.mark.parametrize(
    ("path", "number", "said"),
    [
        ("", errno.EACCES, "permission denied; choose a folder that you may write to"),
        ("", errno.EROFS, "read-only"),
        ("", errno.EIO, "choose another path"),
        ("", errno.EISDIR, "it is a folder; give the name of a file"),
        ("x.npz", errno.ENOENT, "no file can be created there"),
        ("a/x.npz", errno.ENOENT, "create it first"),
    ],
)
def test_errors_of_the_system_say_what_to_do(tmp_path, path, number, said):
    error = output_error(tmp_path / path, OSError(number, os.strerror(number)))
    assert said in str(error)
    assert error.errno == number


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="the system has no /proc")
def test_no_file_in_proc(tmp_path, capsys):
    assert main(["retarget", str(good(tmp_path)), "--output", "/proc/x.npz"]) == 2
    said = capsys.readouterr().err
    assert "choose another folder" in said
    assert "'/' does not exist" not in said
