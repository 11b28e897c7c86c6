"""Blind scores of pictures of robot hands: methods hidden, order shuffled, a written rubric.

    python research/benchmarks/blind.py draw FOLDER RECORDING... --methods smooth sbr ako
        --hands mimic_p050 shadow_hand [--poses flat fist] [--rows] [--rods]
    python research/benchmarks/blind.py judge FOLDER --judge NAME
    python research/benchmarks/blind.py tell FOLDER [--scores FILE.csv...]

``draw`` finds the poses of each recording and writes a numbered picture for each pose, hand and
method: the human hand left, the robot hand right; and sheets of twelve, for a judge who scores by
hand. With ``--rows`` a sheet shows a pose in a row, the human hand and then the methods in an order
of its own, so that a judge compares them; ``--rods`` draws all hands as rods of one style.
``FOLDER-key.csv``, outside the folder that a judge gets, says which is which. ``judge`` asks
for scores in an order of the judge's own, and may be stopped and continued. ``tell`` prints mean
scores by hand and method, with intervals over the pictures, and the judges' agreement; scores
written by hand are CSV files with the columns ``number`` and ``score``.
"""

from __future__ import annotations

import argparse
import csv
import sys
import zlib
from collections.abc import Sequence
from itertools import combinations
from pathlib import Path
from typing import Final, TypeAlias

import numpy as np
from looks import panel_of, run
from PIL import Image, ImageDraw, ImageFont

from smooth_operator.hands.registry import load_hand
from smooth_operator_benchmark.contact_sheet import (
    POSES,
    HandPicture,
    common_frame,
    find_poses,
    skeleton_shape,
)
from smooth_operator_benchmark.model_shape import ModelShape
from smooth_operator_benchmark.recordings import load_sources, parse_request
from smooth_operator_research.run_report import markdown

RUBRIC: Final = """Left the human hand, right the robot hand; each from the palm and from the thumb.
Does the robot hand show the human's pose?
  3  yes: each finger as straight or bent, thumb on its side, what touches touches
  2  one finger visibly off, or all a little
  1  the pose can be guessed: fingers hooked that should be straight, a fist that is open
  0  another pose, or parts of the hand cross each other
Judge only the pose, not the shape of the robot. Numbers 0 to 3; q stops."""
SIZE: Final = 220
"""Width of a view [px]."""
ON_SHEET: Final = (6, 2)
"""Rows and columns of pictures on a sheet."""
ROWS_ON_SHEET: Final = 4
"""Number of poses on a sheet of rows."""
RESAMPLES: Final = 10_000
"""Bootstrap resamples for an interval."""


Key: TypeAlias = tuple[str, str, int, str, str]
"""Recording, pose, frame, hand and method of a picture."""


def pictures_on(hand: str, options: argparse.Namespace) -> list[tuple[Key, np.ndarray, np.ndarray]]:
    """Pictures of the poses of all recordings by each method, on one hand: key, human, robot."""
    drawn: list[tuple[Key, np.ndarray, np.ndarray]] = []
    sources = load_sources([parse_request(text) for text in options.recordings])
    recordings = {s.name: s.recording for s in sources if s.recording is not None}
    shape = (skeleton_shape if options.rods else ModelShape)(load_hand(hand))
    traces = {method: run(method, hand, recordings) for method in options.methods}
    for name in recordings:
        panel = panel_of(name, hand, {m: own[name] for m, own in traces.items()})
        for pose in find_poses([panel]):
            if pose.name not in options.poses:
                continue
            human = HandPicture.of_human(panel.runs[0].human[pose.frame], "right")
            robots = [
                HandPicture.of_robot(shape, r.joints[pose.frame], "right") for r in panel.runs
            ]
            frame = common_frame(robots)  # the same for all methods
            left = human.draw(common_frame([human]), SIZE)
            for one, robot in zip(panel.runs, robots, strict=True):
                key = (name, pose.name, pose.frame, hand, one.method)
                drawn.append((key, left, robot.draw(frame, SIZE)))
    return drawn


def draw(options: argparse.Namespace) -> None:
    """Writes numbered pictures, shuffled, and their key."""
    drawn = [picture for hand in options.hands for picture in pictures_on(hand, options)]
    options.folder.mkdir(parents=True, exist_ok=True)
    rng, count = np.random.default_rng(), len(options.methods)
    order = rng.permutation(len(drawn))
    if options.rows:  # the methods of a pose stay together
        poses = rng.permutation(len(drawn) // count)
        order = np.concatenate([pose * count + rng.permutation(count) for pose in poses])
    shuffled = [drawn[i] for i in order]
    with _key_of(options.folder).open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(("number", "recording", "pose", "frame", "hand", "method"))
        for number, (key, *pair) in enumerate(shuffled):
            Image.fromarray(np.hstack(pair)).save(options.folder / f"{number:04d}.png")
            writer.writerow((number, *key))
    rows, columns = (ROWS_ON_SHEET, count) if options.rows else ON_SHEET
    pictures = [
        robot if options.rows else np.hstack((human, robot)) for _, human, robot in shuffled
    ]
    humans = [human for _, human, _ in shuffled[::count]] if options.rows else None
    _write_sheets(options.folder, pictures, rows, columns, humans)
    (options.folder / "rubric.txt").write_text(RUBRIC + "\n")
    print(f"wrote {len(drawn)} pictures to {options.folder}; the rubric is in rubric.txt")


def _write_sheets(
    folder: Path,
    pictures: Sequence[np.ndarray],
    rows: int,
    columns: int,
    humans: Sequence[np.ndarray] | None,
) -> None:
    """Writes the sheets ``sheet-00.png`` …: numbered pictures in order, with the human hand at the
    left of each row if given."""
    height, width = pictures[0].shape[:2]
    height, width = height + 4, width + 44
    for first in range(0, len(pictures), rows * columns):
        start = 0 if humans is None else width
        sheet = Image.new("RGB", (start + columns * width, rows * height), "white")
        pen = ImageDraw.Draw(sheet)
        for row, human in enumerate((humans or ())[first // columns :][:rows]):
            sheet.paste(Image.fromarray(human), (40, row * height))
            pen.text((4, row * height + 4), "human", "black")
        for i, picture in enumerate(pictures[first : first + rows * columns]):
            top, left = i // columns * height, start + i % columns * width
            sheet.paste(Image.fromarray(picture), (left + 40, top))
            pen.text((left + 4, top + 4), str(first + i), "black", ImageFont.load_default(20))
            pen.rectangle((left, top, left + width - 2, top + height - 2), outline="gray")
        sheet.save(folder / f"sheet-{first // (rows * columns):02d}.png")


def judge(options: argparse.Namespace) -> None:
    """Collects a judge's scores from standard input, one per line."""
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
    """Prints mean scores by hand and method, and the agreement of the judges."""
    key = {int(row["number"]): row for row in _rows(_key_of(options.folder))}
    scores = {
        path.stem.removeprefix("scores-"): {int(r["number"]): int(r["score"]) for r in _rows(path)}
        for path in options.scores or sorted(options.folder.glob("scores-*.csv"))
    }
    if not any(scores.values()):
        raise SystemExit(f"{options.folder}: no scores yet; run judge")
    means = {  # a picture's score is the mean of its judges'
        number: float(np.mean([judged[number] for judged in scores.values() if number in judged]))
        for number in key
        if any(number in judged for judged in scores.values())
    }
    hands, methods = (list(dict.fromkeys(r[k] for r in key.values())) for k in ("hand", "method"))
    rows: list[list[object]] = []
    for method in sorted(methods):
        by_hand = [
            [
                score
                for number, score in means.items()
                if (key[number]["hand"], key[number]["method"]) == (hand, method)
            ]
            for hand in hands
        ]
        cells = [f"{np.mean(own):.2f}" if own else "" for own in by_hand]
        own = np.concatenate(by_hand)
        samples = np.random.default_rng(0).choice(own, (RESAMPLES, len(own))).mean(axis=1)
        low, high = np.percentile(samples, (2.5, 97.5))
        means_of = [f"{own.mean():.2f}", f"{low:.2f} to {high:.2f}", str(len(own))]
        rows.append([f"`{method}`", *cells, *means_of])
    print(markdown(("method", *hands, "mean", "interval", "pictures"), rows))
    for (one, first), (other, second) in combinations(scores.items(), 2):
        both = sorted(first.keys() & second.keys())
        a, b = (np.array([judged[n] for n in both], float) for judged in (first, second))
        if len(both) > 1:
            equal, apart = (a == b).mean(), abs(a - b).mean()
            print(
                f"{one} and {other}: {len(both)} pictures in common, {equal:.0%} equal, "
                f"{apart:.2f} apart in the mean, correlation {np.corrcoef(a, b)[0, 1]:.2f}"
            )


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
            one.add_argument("--poses", nargs="+", default=POSES)
            one.add_argument("--rows", action="store_true", help="a pose in a row")
            one.add_argument("--rods", action="store_true", help="all hands as rods")
        elif step is judge:
            one.add_argument("--judge", required=True, metavar="NAME")
        else:
            one.add_argument("--scores", type=Path, nargs="+", help="default: FOLDER/scores-*.csv")
    options = parser.parse_args(arguments)
    options.step(options)


if __name__ == "__main__":
    main()
