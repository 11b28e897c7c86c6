"""Figures of posture and motion of the robot hand compared with the operator's, and contact sheets.

    python research/benchmarks/looks.py RECORDING... [--methods smooth smooth:precise sbr]
        [--hands mimic_p050 shadow_hand] [--sheets FOLDER] [--faults | --fingers]

A recording is named as for ``smooth-operator bench``: ``glove.npz@:500``, ``video.npz@30hz``. The
mean of a method is over recordings, each one unit; settling is pooled over all openings of all
fingers as well. ``--faults``: how far are two runs apart, one to
five seconds after a fault that one of them had? Each fault comes at six places of a recording.
``--fingers``: does each long finger, index to pinky, close and open as the human's, and can it?
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from smooth_operator.hands.hand import Hand
from smooth_operator.hands.registry import load_hand
from smooth_operator.landmarks import BASES, FINGERS, LANDMARKS, NUM_LANDMARKS
from smooth_operator.metrics import Trace, evaluate, posture
from smooth_operator.metrics.assemble import assemble_trace
from smooth_operator.reporting.run_plots import Panel, Run
from smooth_operator.retargeting.batching import BatchRetargeter
from smooth_operator.retargeting.retargeter import Retargeter
from smooth_operator.types import HandRecording
from smooth_operator_benchmark.contact_sheet import contact_sheet
from smooth_operator_benchmark.model_shape import ModelShape
from smooth_operator_benchmark.recordings import load_sources, parse_request

COLUMNS: Final = {
    "finger_extension_error": "extension",
    "flat_extension_lack": "flat",
    "fist_extension_excess": "fist",
    "finger_direction_error_deg": "fingers °",
    "thumb_direction_error_deg": "thumb °",
    "curl_error_deg": "curl °",
    "spread_error_deg": "spread °",
    "common_shift_mm": "shift mm",
    "cosine_similarity": "thumb cos",
    "motion_preservation": "motion",
    "jumps_per_1000": "jumps",
    "stalled_share": "stalled",
    "step_gain": "gain",
    "settling_s": "settling s",
    "shake_at_rest": "shake",
    "pinch_touch_share": "touch",
    "pinch_deep_share": "deep",
    "self_collision.share": "collision",
    "flatness": "flatness",
    "latency_ms.p50": "p50 ms",
}
"""Metric -> heading."""
AGREEMENT_MM: Final = {"leap_hand": 5.0}
"""Hand -> mean distance of the fingertips up to which two runs agree [mm]; 3 for others."""
PLACES: Final = 6
"""Number of evenly spaced places in a recording at which each fault occurs."""
SETTLES: Final = (1.0, 5.0)
"""Interval after a fault in which two runs are compared [s]."""
SOON: Final = 0.12
"""Time in which a finger should settle after a fast opening [s]."""
FINGER_COLUMNS: Final = (
    "correlation",
    "folded: human",
    "robot",
    "least",
    "open: human °",
    "robot °",
    "straight °",
)
"""Headings of ``print_fingers``; each cell has all long fingers."""
OPEN: Final = 0.975
"""Smallest extension of all long fingers of an open hand."""
SWAPPED: Final = np.r_[0:5, 17:21, 13:17, 9:13, 5:9]
"""Order of landmarks in which index and little finger are exchanged, and so on."""


def figures(trace: Trace) -> list[float]:
    """The columns of a run; NaN where one could not be measured."""
    result, row = evaluate(trace), []
    for name in COLUMNS:
        key, _, part = name.partition(".")
        value = result[key]
        value = value[part] if part and isinstance(value, dict) else value
        row.append(float(value) if isinstance(value, (int, float)) else np.nan)
    return row


def settling(traces: Iterable[Trace]) -> str:
    """Median settling time of all openings of all fingers, and share of openings that settle
    soon."""
    parts = []
    for trace in traces:
        assert trace.straight_lengths is not None  # `assemble_trace` fills them in
        human = posture.human_extensions(trace.human_fingers[:, 1:])
        robot = posture.robot_extensions(trace.robot_fingers[:, 1:], trace.straight_lengths[1:])
        parts.append(posture.settling_times(human, robot, trace.stamps))
    times = np.concatenate(parts)
    if not len(times):
        return "no fast opening"
    share = (times <= SOON).mean()
    return f"{len(times)} openings settle in {np.median(times):.2f} s, {share:.0%} in {SOON} s"


def run(method: str, hand_name: str, recordings: dict[str, HandRecording]) -> dict[str, Trace]:
    """Traces of a method, ``name`` or ``name:preset``, by recording."""
    name, _, preset = method.partition(":")
    hand = load_hand(hand_name)
    retargeter = Retargeter(hand, method=name, preset=preset or None)
    return {
        key: assemble_trace(recording, retargeter.run(recording)[0], hand, reach_samples=0)
        for key, recording in recordings.items()
    }


def panel_of(recording: str, hand: str, traces: Mapping[str, Trace]) -> Panel:
    """Panel of one recording on a hand, with the run of each method."""
    first = next(iter(traces.values()))
    runs = []
    for method, trace in traces.items():
        assert trace.robot_landmarks is not None  # `assemble_trace` fills them in
        runs.append(Run(method, trace.human, trace.robot_landmarks, trace.joint_positions))
    return Panel((recording, hand, "right"), load_hand(hand), first.stamps, tuple(runs))


def faulty(recording: HandRecording, fault: str, at: int) -> tuple[HandRecording, int]:
    """The recording with a fault that starts at a frame, and the first frame after the fault."""
    landmarks, valid = recording.landmarks.copy(), np.array(recording.valid)
    end = at + {"begins later": 0, "one mirrored frame": 1, "20 frames of the other hand": 20}.get(
        fault, 5
    )
    if fault == "2 s without a hand":
        end = int(np.searchsorted(recording.stamps, recording.stamps[at] + 2.0))
        valid[at:end] = False
    elif fault == "fingers swapped in 5 frames":
        landmarks[at:end] = landmarks[at:end][:, SWAPPED]
    else:
        landmarks[at:end] *= (-1, 1, 1)
    return HandRecording(landmarks, recording.stamps, recording.side, valid=valid), end


FAULTS: Final = (
    "2 s without a hand",
    "one mirrored frame",
    "20 frames of the other hand",
    "fingers swapped in 5 frames",
    "begins later",
)


def fault_rows(method: str, hand_name: str, recording: HandRecording) -> dict[str, list[float]]:
    """Fault -> mean distance of the fingertips from those of the run without it [mm], some seconds
    after (``SETTLES``): the largest, and the share of frames within ``AGREEMENT_MM``."""
    name, _, preset = method.partition(":")
    retargeter = BatchRetargeter(load_hand(hand_name), method=name, preset=preset or None)
    stamps, agree = recording.stamps, AGREEMENT_MM.get(hand_name, 3.0)
    runs: list[tuple[str, int, int, HandRecording]] = [("none", 0, 0, recording)]
    for place in range(1, PLACES + 1):
        at = place * len(recording) // (PLACES + 1)
        for fault in FAULTS:
            wrong, end = faulty(recording, fault, at)
            if end < len(recording) and stamps[-1] >= stamps[end] + 2 * SETTLES[0]:
                first = at if fault == "begins later" else 0
                last = int(np.searchsorted(stamps, stamps[end] + SETTLES[1]))
                runs.append((fault, first, end, wrong[first:last]))
    answers = retargeter.batch([run for *_, run in runs])
    tips = [retargeter.hand.tips(commands.joint_positions) for commands, _ in answers]
    apart: dict[str, list[np.ndarray]] = {}
    for (fault, first, end, _), own in zip(runs[1:], tips[1:], strict=True):
        distance = 1e3 * np.linalg.norm(own - tips[0][first:][: len(own)], axis=-1).mean(axis=1)
        settled = stamps[first:][: len(own)] >= stamps[end] + SETTLES[0]
        apart.setdefault(fault, []).append(distance[settled])
    every = {fault: np.concatenate(parts) for fault, parts in apart.items()}
    return {fault: [float(d.max()), float((d <= agree).mean())] for fault, d in every.items()}


def print_faults(
    hand: str, methods: Sequence[str], recordings: Mapping[str, HandRecording]
) -> None:
    """Prints the distance between runs with and without a fault, and the mean over recordings."""
    print(f"\n## {hand}\n\n| method | recording | fault | largest mm | share that agrees |")
    print("|---|---|---|---:|---:|")
    for method in methods:
        rows = {name: fault_rows(method, hand, one) for name, one in recordings.items()}
        for name, faults in rows.items():
            for fault, (most, share) in faults.items():
                print(f"| {method} | {name} | {fault} | {most:.1f} | {share:.3f} |")
        for fault in FAULTS:
            every = [faults[fault] for faults in rows.values() if fault in faults]
            if every:
                largest, mean = max(m for m, _ in every), np.mean([s for _, s in every])
                print(f"| {method} | **all {len(every)}** | {fault} | {largest:.1f} | {mean:.3f} |")


def finger_limits(hand: Hand) -> tuple[np.ndarray, np.ndarray]:
    """(L,) least extension of each long finger in 4,000 random poses, half of whose joints are at
    their limits, and (L,) its bend in the straight pose [degrees]; NaN without its four points."""
    low, high = hand.limits.T
    shares = np.random.default_rng(0).uniform(-0.5, 1.5, (4000, len(low))).clip(0, 1)
    q = np.vstack([low + shares * (high - low), hand.straight_pose.q])
    points = np.full((len(q), NUM_LANDMARKS, 3), np.nan)
    points[:, [LANDMARKS.index(name) for name in hand.tree.names]] = hand.landmark_positions(q)
    bases = np.array([BASES[FINGERS.index(name)] for name in hand.fingers[1:]])
    fingers = points[:, bases[:, None] + range(4)]
    extensions = posture.robot_extensions(fingers, hand.straight_pose.reach[1:])
    return extensions.min(axis=0), posture.curls(fingers)[-1]


def print_fingers(
    hand_name: str, methods: Sequence[str], recordings: Mapping[str, HandRecording]
) -> None:
    """Prints for each long finger how its extension follows the human's, its extension while the
    human's is under ``posture.CLOSED``, and its bend while the human hand is open; medians."""
    least, straight = finger_limits(load_hand(hand_name))
    for method in methods:
        for name, trace in run(method, hand_name, dict(recordings)).items():
            assert trace.straight_lengths is not None  # `assemble_trace` fills them in
            people, robots = trace.human_fingers[:, 1:], trace.robot_fingers[:, 1:]
            human = posture.human_extensions(people)
            robot = posture.robot_extensions(robots, trace.straight_lengths[1:])
            seen = np.isfinite(human).all(axis=1)
            both = zip(human[seen].T, robot[seen].T, strict=True)
            folded, opened = human < posture.CLOSED, (human > OPEN).all(axis=1)
            both_folded = np.ma.array([human, robot], mask=[~folded] * 2)
            medians = np.ma.median(both_folded, axis=1)  # type: ignore[no-untyped-call]
            cells = (
                [np.corrcoef(one)[0, 1] for one in both],
                *medians.filled(np.nan),
                least,
                *(np.median(posture.curls(points[opened]), axis=0) for points in (people, robots)),
                straight,
            )
            texts = [
                ", ".join(f"{x:.{2 if k < 4 else 0}f}" for x in c) for k, c in enumerate(cells)
            ]
            print(f"| {hand_name} | {method} | {name} | " + " | ".join(texts) + " |", flush=True)


def main(arguments: Sequence[str] | None = None) -> None:
    """Prints a table for each hand, and draws its sheets if a folder is named."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("recordings", nargs="+")
    parser.add_argument("--methods", nargs="+", default=["smooth"])
    parser.add_argument("--hands", nargs="+", default=["mimic_p050"])
    parser.add_argument("--sheets", type=Path)
    parser.add_argument("--faults", action="store_true")
    parser.add_argument("--fingers", action="store_true")
    options = parser.parse_args(arguments)
    sources = load_sources([parse_request(text) for text in options.recordings])
    recordings = {s.name: s.recording for s in sources if s.recording is not None}
    if options.fingers:
        print("| hand | method | recording | " + " | ".join(FINGER_COLUMNS) + " |")
        print("|---|---|---|" + "---:|" * len(FINGER_COLUMNS))
    for hand in options.hands:
        if options.fingers:
            print_fingers(hand, options.methods, recordings)
            continue
        if options.faults:
            print_faults(hand, options.methods, recordings)
            continue
        traces = {method: run(method, hand, recordings) for method in options.methods}
        print(f"\n## {hand}, {len(recordings)} recordings\n")
        print("| method | recording | " + " | ".join(COLUMNS.values()) + " |")
        print("|---|---|" + "---:|" * len(COLUMNS))
        for method, by_recording in traces.items():
            rows = {name: figures(trace) for name, trace in by_recording.items()}
            for name, row in rows.items():
                print(f"| {method} | {name} | " + " | ".join(f"{x:.3g}" for x in row) + " |")
            means = np.ma.masked_invalid(list(rows.values())).mean(axis=0).filled(np.nan)
            print(f"| {method} | **mean** | " + " | ".join(f"{x:.3g}" for x in means) + " |")
        for method, by_recording in traces.items():
            print(f"\n{method}: {settling(by_recording.values())}")
        if options.sheets is not None:
            options.sheets.mkdir(parents=True, exist_ok=True)
            for name in recordings:
                one = {method: by_recording[name] for method, by_recording in traces.items()}
                stem = f"{hand}_{Path(name).stem}".replace(":", "-")
                sheet = contact_sheet([panel_of(name, hand, one)], ModelShape)
                if sheet is not None:
                    sheet.save(options.sheets / f"{stem}.png")


if __name__ == "__main__":
    main()
