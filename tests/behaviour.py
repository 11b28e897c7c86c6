"""What the package computes, written down, so that a redesign can be held against it.

    python tests/behaviour.py write BEFORE        # with the code as it was
    python tests/behaviour.py write AFTER         # with the code as it is
    python tests/behaviour.py compare BEFORE AFTER

Each case is a recording, a hand, a method and its preset: the commands of the first frames and
their metrics. Each file format is written and read, too. The recordings are the built-in operator
and those of the shared folder, where that is present.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

import smooth_operator as so
from smooth_operator.cli import main

SHARED = Path(__file__).resolve().parents[2] / "shared" / "recordings"
FRAMES = 200
WINDOWS = (
    ("manus_right", 0),
    ("manus_right", 2600),
    ("human_alex", 0),
    ("wilor_test_long", 0),
    ("wilor_workspace", 300),
)
METHODS = (
    ("smooth", None),
    ("smooth", "offline"),
    ("sbr", None),
    ("sbr", "paper"),
    ("sbr", "offline"),
    ("joint_angle", None),
    ("keyvector", None),
    ("keyvector", "vector"),
    ("keyvector", "position"),
    ("keyvector", "slsqp"),
    ("keyvector", "published"),
    ("hybrid", None),
    ("hybrid", "published"),
    ("dexpilot", None),
    ("dexpilot", "slsqp"),
    ("dexpilot", "published"),
    ("ako", None),
    ("ako", "published"),
    ("geort", None),
)
HANDS = ("allegro_hand", "leap_hand", "shadow_hand", "inspire_hand", "wuji_hand", "orca_v2")


def recordings() -> dict[str, so.HandRecording]:
    """Name -> recording of at most FRAMES frames."""
    found = {"synthetic": so.SyntheticOperator(seed=3).record(4.0)}
    for stem, start in WINDOWS:
        for path in SHARED.glob(f"{stem}*.np[yz]"):
            try:
                recording = so.read_recording(path)
            except so.SmoothOperatorError:
                recording = so.read_recording(path, rate=30.0)
            found[f"{stem}-{start}"] = recording[start : start + FRAMES]
    return found


def command(*words: object) -> str:
    """Standard output of one command."""
    text = io.StringIO()
    with contextlib.redirect_stdout(text):
        status = main([str(word) for word in words])
    if status:
        raise SystemExit(f"{words}: status {status}")
    return text.getvalue()


def write(output: Path) -> None:
    """Write all cases into a folder; those that are there are kept."""
    output.mkdir(parents=True, exist_ok=True)
    inputs = recordings()
    cases = [(name, "mimic_p050", *method) for name in inputs for method in METHODS]
    cases += [("synthetic", hand, m, None) for hand in HANDS for m in ("smooth", "sbr", "dexpilot")]
    with tempfile.TemporaryDirectory() as folder:
        files = {}
        for name, recording in inputs.items():
            files[name] = Path(folder) / f"{name}.npz"
            np.savez(
                files[name],
                landmarks=recording.landmarks,
                timestamps=recording.stamps,
                handedness=np.array(str(recording.side)),
            )
        for name, hand, method, preset in cases:
            stem = output / f"{name}.{hand}.{method}.{preset or 'default'}"
            if stem.with_name(stem.name + ".npy").exists():
                continue
            out = Path(folder) / "out.npz"
            words = ["retarget", files[name], "--output", out, "--hand", hand, "--method", method]
            words += ["--quiet", "--json", *(["--preset", preset] if preset else [])]
            metrics = json.loads(command(*words))
            with np.load(out) as made:
                values = np.column_stack([made["joint_positions"], made["status"]])
            stem.with_name(stem.name + ".json").write_text(json.dumps(metrics, indent=1))
            np.save(stem.with_name(stem.name + ".npy"), values)
            print(stem.name, flush=True)
        out = Path(folder) / "converted.out.npz"
        words = ["retarget", files["synthetic"], "--output", out, "--method", "sbr", "--quiet"]
        command(*words)
        for ending in ("mcap", "hdf5", "lerobot", "npz"):
            suffix = "" if ending == "lerobot" else f".{ending}"  # a folder
            converted = Path(folder) / f"converted-{ending}{suffix}"
            command("convert", files["synthetic"], "--commands", out, "--output", converted)
            plain = Path(folder) / f"from.{ending}.npz"
            command("convert", converted, "--output", plain)
            with np.load(plain) as back:
                for key in ("landmarks", "joint_positions"):
                    values = back[key].reshape(len(back[key]), -1)
                    np.save(output / f"converted.{ending}.{key}.npy", values)
            print(converted.name, flush=True)


def compare(before: Path, after: Path) -> int:
    """Print every difference; 0 if commands are within 1e-6 rad and metrics within 1e-5 of each."""
    names = {path.name for path in before.glob("*.npy")}
    missing = sorted(names - {path.name for path in after.glob("*.npy")})
    print(f"{len(names)} cases, missing: {missing or 'none'}")
    worst, equal = 0.0, 0
    for name in sorted(names - set(missing)):
        old, new = np.load(before / name), np.load(after / name)
        gap = np.inf if old.shape != new.shape else float(np.nanmax(np.abs(old - new)))
        worst, equal = max(worst, gap), equal + (gap == 0)
        if gap:
            print(f"{name}: {gap:.3g}")
        if (before / name).with_suffix(".json").exists():
            texts = [
                json.loads((f / name).with_suffix(".json").read_text()) for f in (before, after)
            ]
            for key, value, other in _differences(*texts):
                print(f"  {name}: {key}: {value} -> {other}")
    print(f"{equal} of {len(names)} equal bit for bit, worst {worst:.3g}")
    return int(bool(missing) or worst > 1e-6)


def _differences(old: Any, new: Any, key: str = "") -> Iterator[tuple[str, Any, Any]]:
    if isinstance(old, dict) and isinstance(new, dict):
        for name in sorted({*old, *new}):
            if name != "latency":
                yield from _differences(old.get(name), new.get(name), f"{key}.{name}")
    elif isinstance(old, float) and isinstance(new, float):
        if abs(old - new) > 1e-5 * max(1e-3, abs(old)):
            yield key, old, new
    elif old != new:
        yield key, old, new


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("work", choices=("write", "compare"))
    parser.add_argument("folders", nargs="+", type=Path)
    chosen = parser.parse_args()
    sys.exit(compare(*chosen.folders) if chosen.work == "compare" else write(*chosen.folders))
