"""Blind scores of pictures of robot hands: methods hidden, order shuffled, a written rubric.

    python research/benchmarks/blind.py draw FOLDER RECORDING... --methods smooth sbr ako
        --hands mimic_p050 shadow_hand
    python research/benchmarks/blind.py judge FOLDER --judge NAME
    python research/benchmarks/blind.py tell FOLDER

``draw`` finds the poses of each recording and writes a numbered picture for each pose, hand and
method: the human hand left, the robot hand right. ``FOLDER-key.csv``, outside the folder that a
judge gets, says which is which. ``judge`` asks for scores in an order of the judge's own, and may
be stopped and continued. ``tell`` prints mean scores by hand and method, and the judges' agreement.
"""

from __future__ import annotations

import argparse
import csv
import sys
import zlib
from collections.abc import Sequence
from itertools import combinations
from pathlib import Path
from typing import Final

import numpy as np
from looks import panel_of, run
from PIL import Image

from smooth_operator.cli.hand_shape import ModelShape
from smooth_operator.hands.registry import load_hand
from smooth_operator.lab.benchmark.contact_sheet import HandPicture, common_frame, find_poses
from smooth_operator.lab.benchmark.recordings import load_sources, parse_request

RUBRIC: Final = """Left the human hand, right the robot hand; each from the palm and from the thumb.
Does the robot hand show the human's pose?
  3  yes: each finger as straight or bent, thumb on its side, what touches touches
  2  one finger visibly off, or all a little
  1  the pose can be guessed: fingers hooked that should be straight, a fist that is open
  0  another pose, or parts of the hand cross each other
Judge only the pose, not the shape of the robot. Numbers 0 to 3; q stops."""
SIZE: Final = 220
"""Width of a view [px]."""


def draw(options: argparse.Namespace) -> None:
    """Writes numbered pictures, shuffled, and their key."""
    drawn: list[tuple[tuple[object, ...], np.ndarray]] = []
    sources = load_sources([parse_request(text) for text in options.recordings])
    recordings = {s.name: s.recording for s in sources if s.recording is not None}
    for hand in options.hands:
        shape = ModelShape(load_hand(hand))
        traces = {method: run(method, hand, recordings) for method in options.methods}
        for name in recordings:
            panel = panel_of(name, hand, {m: own[name] for m, own in traces.items()})
            for pose in find_poses([panel]):
                human = HandPicture.of_human(panel.runs[0].human[pose.frame], "right")
                robots = [
                    HandPicture.of_robot(shape, r.joints[pose.frame], "right") for r in panel.runs
                ]
                frame = common_frame(robots)  # the same for all methods
                left = human.draw(common_frame([human]), SIZE)
                for one, robot in zip(panel.runs, robots, strict=True):
                    key = (name, pose.name, pose.frame, hand, one.method)
                    drawn.append((key, np.concatenate([left, robot.draw(frame, SIZE)], axis=1)))
    options.folder.mkdir(parents=True, exist_ok=True)
    with _key_of(options.folder).open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(("number", "recording", "pose", "frame", "hand", "method"))
        for number, i in enumerate(np.random.default_rng().permutation(len(drawn))):
            key, picture = drawn[i]
            Image.fromarray(picture).save(options.folder / f"{number:04d}.png")
            writer.writerow((number, *key))
    (options.folder / "rubric.txt").write_text(RUBRIC + "\n")
    print(f"wrote {len(drawn)} pictures to {options.folder}; the rubric is in rubric.txt")


def judge(options: argparse.Namespace) -> None:
    """Collects a judge's scores, one a line of standard input."""
    path = options.folder / f"scores-{options.judge}.csv"
    done = {int(row["number"]) for row in _rows(path)} if path.exists() else set()
    every = sorted(int(file.stem) for file in options.folder.glob("[0-9]*.png"))
    order = np.random.default_rng(zlib.crc32(options.judge.encode())).permutation(every)
    print(RUBRIC)
    with path.open("a", newline="") as file:
        if not done:
            file.write("number,score\n")
        for number in (int(n) for n in order if n not in done):
            while True:
                print(f"{options.folder / f'{number:04d}.png'}: ", end="", flush=True)
                word = sys.stdin.readline().strip()
                if word in ("0", "1", "2", "3"):
                    file.write(f"{number},{word}\n")
                    file.flush()
                    break
                if word in ("", "q"):
                    return
                print("0, 1, 2 or 3")


def tell(options: argparse.Namespace) -> None:
    """Prints mean scores by hand and method, and how far two judges differ."""
    key = {int(row["number"]): row for row in _rows(_key_of(options.folder))}
    scores = {
        path.stem.removeprefix("scores-"): {int(r["number"]): int(r["score"]) for r in _rows(path)}
        for path in sorted(options.folder.glob("scores-*.csv"))
    }
    if not any(scores.values()):
        raise SystemExit(f"{options.folder}: no scores yet; run judge")
    hands, methods = (list(dict.fromkeys(r[k] for r in key.values())) for k in ("hand", "method"))
    print("| method | " + " | ".join(hands) + " | mean | pictures |")
    print("|---|" + "---:|" * (len(hands) + 2))
    for method in sorted(methods):
        by_hand = []
        for hand in hands:
            own = [n for n, row in key.items() if (row["hand"], row["method"]) == (hand, method)]
            by_hand.append([judged[n] for judged in scores.values() for n in own if n in judged])
        means = [float(np.mean(own)) if own else np.nan for own in by_hand]
        cells = [*means, float(np.nanmean(means))]
        print(f"| `{method}` | " + " | ".join(f"{x:.2f}" for x in cells), end="")
        print(f" | {sum(map(len, by_hand))} |")
    for (one, first), (other, second) in combinations(scores.items(), 2):
        both = first.keys() & second.keys()
        apart = np.mean([abs(first[n] - second[n]) for n in both]) if both else np.nan
        print(f"{one} and {other}: {len(both)} pictures in common, {apart:.2f} apart in the mean")


def _rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def _key_of(folder: Path) -> Path:
    return folder.with_name(f"{folder.name}-key.csv")


def main(arguments: Sequence[str] | None = None) -> None:
    """Runs one of the three steps."""
    parser = argparse.ArgumentParser(description=__doc__)
    steps = parser.add_subparsers(required=True)
    for step in (draw, judge, tell):
        one = steps.add_parser(step.__name__)
        one.add_argument("folder", type=Path)
        one.set_defaults(step=step)
        if step is draw:
            one.add_argument("recordings", nargs="+")
            one.add_argument("--methods", nargs="+", required=True)
            one.add_argument("--hands", nargs="+", default=["mimic_p050"])
        elif step is judge:
            one.add_argument("--judge", required=True, metavar="NAME")
    options = parser.parse_args(arguments)
    options.step(options)


if __name__ == "__main__":
    main()
