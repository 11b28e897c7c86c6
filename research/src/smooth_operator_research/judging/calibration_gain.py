r"""Gain of a calibration: fitted on one half of a recording, judged on the other.

    python -m smooth_operator_research.judging.calibration_gain manus.npz other.npy@30hz --output \
        calibration.json

Each recording is cut in two. The operator is calibrated on the first half; methods then retarget
the second with and without the calibration, as a whole and component by component. Judged is
against the human as tracked and aligned with no operator, a scale for each frame, which is the same
reference for all rows: a correction that moves the human's landmarks can't move what it is measured
against.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np

from smooth_operator import Retargeter, load_hand
from smooth_operator.calibration.estimate import calibrate
from smooth_operator.formats.environment import environment
from smooth_operator.formats.jsonable import to_json
from smooth_operator.hands.hand import Hand
from smooth_operator.human.operator import COMPONENTS, DEFAULT_COMPONENTS, OperatorProfile
from smooth_operator.lab.benchmark.recordings import load_sources, parse_request
from smooth_operator.methods.presets import method_config
from smooth_operator.metrics import evaluate
from smooth_operator.metrics.assemble import assemble_trace
from smooth_operator.types import HandRecording

OPEN = 0.03
"""Human thumb-to-tip distance from which a ratio of lengths has nothing to do with pinches [m]."""

CASES: dict[str, tuple[str, ...] | None] = {
    "none": None,
    "default": DEFAULT_COMPONENTS,
    **{name: (name,) for name in COMPONENTS},
    "all": COMPONENTS,
}


def judge(
    recording: HandRecording, hand: Hand, method: str, operator: OperatorProfile | None
) -> dict[str, Any]:
    """Retargets a recording, and measures against the human as tracked."""
    config = method_config(method)
    if operator is not None:
        config = config.with_operator(operator)
    commands, _ = Retargeter(hand, config=config).run(recording)
    trace = assemble_trace(recording, commands, hand, reach_samples=0)
    metrics = evaluate(trace)
    human = np.linalg.norm(trace.human_keyvectors[:, trace.thumb_vectors], axis=-1)
    robot = np.linalg.norm(trace.robot_keyvectors[:, trace.thumb_vectors], axis=-1)
    ratio = metrics["scale_ratio"]
    latency: Any = metrics["latency_ms"]
    collision: Any = metrics["self_collision"]
    return {
        "pinch_error_mm": metrics["pinch_error_mm"],
        "pinch_error_strict_mm": metrics["pinch_error_strict_mm"],
        "scale_error": None if not isinstance(ratio, float) else abs(ratio - 1),
        "scale_ratio": ratio,
        "scale_error_open": float(np.abs(robot / human - 1)[human > OPEN].mean()),
        "cosine_similarity": metrics["cosine_similarity"],
        "cosine_similarity_all": metrics["cosine_similarity_all"],
        "motion_preservation": metrics["motion_preservation"],
        "flatness": metrics["flatness"],
        "self_collision": collision["share"],
        "latency_p50_ms": latency["p50"],
    }


def main() -> None:
    """Calibrates, retargets, prints a line for each case."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("recordings", nargs="+")
    parser.add_argument("--hand", default="mimic_p050")
    parser.add_argument("--methods", default="sbr,dexpilot,keyvector")
    parser.add_argument("--cases", default=",".join(CASES))
    parser.add_argument("--both-ways", action="store_true")
    parser.add_argument("--output", type=Path)
    options = parser.parse_args()
    rows = []
    for source in load_sources(parse_request(text) for text in options.recordings):
        if source.recording is None:
            raise SystemExit(source.error)
        whole = source.recording
        hand = load_hand(options.hand, whole.side)
        half = len(whole) // 2
        ways = {"second": (whole[:half], whole[half:]), "first": (whole[half:], whole[:half])}
        for judged, (fitted, part) in list(ways.items())[: 2 if options.both_ways else 1]:
            operator = calibrate(fitted, hand).operator
            for method in options.methods.split(","):
                for case in options.cases.split(","):
                    components: Any = CASES[case]
                    used = None if components is None else operator.using(components)
                    row = {
                        "recording": source.name,
                        "method": method,
                        "case": case,
                        "judged": judged,
                    }
                    row |= judge(part, hand, method, used)
                    rows.append(row)
                    print(
                        f"{source.name[:12]:12s} {method:10s} {case:8s} "
                        f"pinch {row['pinch_error_mm'] or float('nan'):6.2f} mm  "
                        f"scale error {row['scale_error']:.3f}, "
                        f"open {row['scale_error_open']:.3f}  "
                        f"cosine {row['cosine_similarity']:.3f}, "
                        f"{row['cosine_similarity_all']:.3f}  "
                        f"motion {row['motion_preservation']:.3f}  flatness {row['flatness']:.2e}  "
                        f"collision {row['self_collision']:.2f} {row['latency_p50_ms']:.2f} ms",
                        flush=True,
                    )
    if options.output is not None:
        options.output.write_text(
            json.dumps({"rows": rows, **json.loads(to_json(environment()))}, indent=1) + "\n"
        )


if __name__ == "__main__":
    main()
