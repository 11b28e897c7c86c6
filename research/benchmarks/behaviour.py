"""Records the output of the installed program, and compares two records.

A change of the program's structure must not change its results. Record before and after:

    python research/benchmarks/behaviour.py record before --shared FOLDER
    python research/benchmarks/behaviour.py record after --shared FOLDER
    python research/benchmarks/behaviour.py compare before after

A record holds the commands of all methods and presets on five recordings and two hands, the metrics
of these commands, the study's results on the oracle's data, converted files, the bytes of a data
set of 20 clips, and the figures of the paper's quick run. It takes about half an hour of one core.
Only the command line and public names are used, so that one script serves both programs.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from smooth_operator import (
    HandFrame,
    HandRecording,
    Retargeter,
    assemble_trace,
    evaluate,
    load_hand,
    read_recording,
)
from smooth_operator.retargeting.batching import BatchRetargeter

HANDS = ("mimic_p050", "leap_hand")
PRESETS = {
    "sbr": ("realtime", "paper"),
    "smooth": ("teleop", "precise"),
    "joint_angle": ("default",),
    "keyvector": ("published", "fast"),
    "hybrid": ("published", "fast"),
    "dexpilot": ("published", "fast"),
    "ako": ("published", "fast"),
}
SLOW = ("paper", "published")
FRAMES, SLOW_FRAMES = 100, 20
GLOVE = "manus_right_subject-000_run-010.npz"
CLIPS = {
    "glove": (GLOVE, 1000, None),
    "glove_later": (GLOVE, 3000, None),
    "alex": ("human_alex_21x3.npy", 500, 30.0),
    "wilor": ("wilor_test_long_21x3.npz", 0, 30.0),
    "workspace": ("wilor_workspace_21x3.npz", 0, 30.0),
}
"""Clip -> recording, its first frame, and the frame rate if the recording has no stamps."""

SMALL_DIFFERENCE = 1e-5


def record(folder: Path, shared: Path, parts: list[str]) -> None:
    """Writes the parts of a record that `folder` lacks."""
    folder.mkdir(parents=True, exist_ok=True)
    steps = {
        "commands": record_commands,
        "study": record_study,
        "files": record_files,
        "paper": record_paper,
    }
    for name in parts or steps:
        path = folder / f"{name}.json"
        if not path.exists():
            print(f"record: {name}", flush=True)
            path.write_text(json.dumps(steps[name](folder, shared), indent=1))


def slices(shared: Path) -> dict[str, HandRecording]:
    """The frames of each recording that are retargeted."""
    clips = {}
    for clip, (name, start, rate) in CLIPS.items():
        recording = read_recording(shared / "recordings" / name, rate=rate)
        stop = start + FRAMES
        clips[clip] = HandRecording(
            recording.landmarks[start:stop], recording.stamps[start:stop], recording.side
        )
    return clips


def record_commands(folder: Path, shared: Path) -> dict[str, Any]:
    """Commands (in commands.npz) and their metrics, of each method, preset, hand and recording."""
    clips = slices(shared)
    arrays: dict[str, np.ndarray] = {}
    figures: dict[str, Any] = {}
    for hand in HANDS:
        for method, presets in PRESETS.items():
            for preset in presets:
                name = f"{hand} {method}:{preset}"
                print(f"  {name}", flush=True)
                retargeter = Retargeter(hand, side="right", method=method, preset=preset)
                for clip, frames in clips.items():
                    count = SLOW_FRAMES if preset in SLOW else FRAMES
                    arrays[f"{name} {clip}"] = walk(retargeter, frames, count)
        for method in ("smooth", "sbr"):
            retargeter = BatchRetargeter(hand, side="right", method=method)
            batch = list(retargeter.batch(list(clips.values()), lanes=2))
            for (clip, frames), (commands, _) in zip(clips.items(), batch, strict=True):
                arrays[f"{hand} {method} batch {clip}"] = np.asarray(commands.joint_positions)
                trace = assemble_trace(frames, commands, load_hand(hand, "right"))
                figures[f"{hand} {method} {clip}"] = evaluate(trace)
    np.savez_compressed(folder / "commands.npz", **arrays)
    return figures


def walk(retargeter: Retargeter, clip: HandRecording, count: int) -> np.ndarray:
    """Positions [rad] and status (T, n + 1) of the first `count` frames, from a fixed seed."""
    state = retargeter.init(0)
    rows = []
    for points, stamp in zip(clip.landmarks[:count], clip.stamps[:count], strict=True):
        state, result = retargeter.step(state, HandFrame(points, float(stamp), clip.side))
        rows.append([*np.asarray(result.command.joint_positions), float(result.status)])
    return np.array(rows)


def run(*words: object) -> None:
    """Runs a command of the program, and exits if it fails."""
    command = [sys.executable, "-m", "smooth_operator", *map(str, words)]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)


def record_study(folder: Path, shared: Path) -> dict[str, Any]:
    """Results of `study analyze` on the oracle's trials and ratings."""
    out, oracle = folder / "study", shared / "study_oracle"
    run("study", "analyze", oracle / "trials.csv", oracle / "tlx.csv", "--output", out, "--quiet")
    return {path.name: json.loads(path.read_text()) for path in sorted(out.glob("*.json"))}


def record_files(folder: Path, shared: Path) -> dict[str, str]:
    """Digests of converted files (as .npz again) and of a data set of 20 clips."""
    clips = folder / "clips"
    clips.mkdir(exist_ok=True)
    recording = read_recording(shared / "recordings" / GLOVE)
    for k in range(20):
        part = slice(240 * k, 240 * k + 120)
        np.savez(
            clips / f"clip_{k:02d}.npz",
            landmarks=recording.landmarks[part],
            stamps=recording.stamps[part],
            side=recording.side,
        )
    dataset = folder / "dataset"
    run("dataset", clips, "--output", dataset, "--workers", 1, "--quiet")
    run("retarget", clips / "clip_00.npz", "--output", folder / "out.npz", "--overwrite")
    for name in ("a.mcap", "a.h5", "a_lerobot"):
        source = ("convert", clips / "clip_00.npz", "--commands", folder / "out.npz")
        run(*source, "--output", folder / name, "--task", "pinch", "--overwrite")
        run("convert", folder / name, "--output", folder / f"{name}.npz", "--overwrite")
    digests = {
        f"{p.name} {key}": digest(array.tobytes())
        for p in sorted(folder.glob("a*.npz"))
        for key, array in np.load(p, allow_pickle=False).items()
    }
    files = sorted(p for p in (dataset / "dataset").rglob("*") if p.is_file())
    return digests | {str(p.relative_to(dataset)): digest(p.read_bytes()) for p in files}


def digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()[:16]


def record_paper(folder: Path, shared: Path) -> dict[str, Any]:
    """Results of the paper's experiments at their minimal size."""
    run("paper", "--quick", "--output", folder / "paper", "--quiet")
    paths = sorted((folder / "paper").rglob("results.json"))
    return {str(path.relative_to(folder)): json.loads(path.read_text()) for path in paths}


def leaves(tree: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """The values of a JSON tree, each with its path."""
    if isinstance(tree, dict | list):
        for key, value in tree.items() if isinstance(tree, dict) else enumerate(tree):
            yield from leaves(value, f"{name}/{key}")
    else:
        yield name, tree


def compare(before: Path, after: Path) -> int:
    """Prints each difference of two records; returns the number of differences beyond rounding."""
    differences = 0
    with np.load(before / "commands.npz") as first, np.load(after / "commands.npz") as second:
        for name in sorted({*first} | {*second}):
            if name not in first or name not in second or first[name].shape != second[name].shape:
                print(f"commands {name}: in one record only, or of another size")
                differences += 1
                continue
            largest = float(np.nanmax(np.abs(first[name] - second[name])))
            if largest > 0:
                differences += largest > SMALL_DIFFERENCE
                print(f"commands {name}: {largest:.2g} rad")
    for path in sorted(before.glob("*.json")):
        first_tree, second_tree = (
            dict(leaves(json.loads((folder / path.name).read_text()))) for folder in (before, after)
        )
        for name in sorted({*first_tree} | {*second_tree}):
            old, new = first_tree.get(name), second_tree.get(name)
            numbers = isinstance(old, int | float) and isinstance(new, int | float)
            near = numbers and np.isclose(old, new, rtol=1e-6, atol=1e-9, equal_nan=True)
            if old != new and not near:
                print(f"{path.stem}{name}: {old} -> {new}")
                differences += 1
    print(f"{differences} differences beyond rounding ({SMALL_DIFFERENCE:g} rad)")
    return differences


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    commands = parser.add_subparsers(dest="command", required=True)
    recorder = commands.add_parser("record", help="write a record of the installed program")
    recorder.add_argument("folder", type=Path)
    recorder.add_argument(
        "--shared", type=Path, required=True, help="folder with recordings/ and study_oracle/"
    )
    recorder.add_argument("--parts", nargs="*", default=[], help="commands, study, files, paper")
    comparison = commands.add_parser("compare", help="list the differences of two records")
    comparison.add_argument("before", type=Path)
    comparison.add_argument("after", type=Path)
    options = parser.parse_args()
    if options.command == "compare":
        return int(compare(options.before, options.after) > 0)
    record(options.folder, options.shared, options.parts)
    return 0


if __name__ == "__main__":
    sys.exit(main())
