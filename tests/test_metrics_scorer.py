"""The sound definition against an independent scorer, on real recordings and real commands."""

import functools
import importlib.util
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from smooth_operator.landmarks import FINGERS, FROM_MANUS_25
from smooth_operator.metrics import Trace, evaluate

pytestmark = pytest.mark.shared

RECORDING = "recordings/manus_right_subject-000_run-010.npz"
FRAMES = 500
NAMES = {  # the scorer's -> ours
    "cosine_thumb": "cosine_similarity",
    "cosine_all": "cosine_similarity_all",
    **{name: name for name in ("scale_ratio", "motion_preservation", "flatness", "joint_jitter")},
    **{name: name for name in ("velocity_correlation", "lag_ms", "limit_violation_rad")},
}


@pytest.fixture(scope="module")
def scorer(shared) -> ModuleType:
    spec = importlib.util.spec_from_file_location("scorer", shared / "tools" / "score.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    module.load_hand = functools.cache(module.load_hand)
    return module


@pytest.fixture(scope="module")
def recording(shared) -> tuple[np.ndarray, np.ndarray]:
    with np.load(shared / RECORDING, allow_pickle=False) as archive:
        return archive["data"], archive["timestamps"]


def trace_of(scorer: ModuleType, nodes: np.ndarray, stamps: np.ndarray, output: Path) -> Trace:
    """A trace from the scorer's own alignment and kinematics."""
    import mujoco

    with np.load(output, allow_pickle=False) as archive:
        q = archive["joint_positions"].astype(float)
        column = {str(name): i for i, name in enumerate(archive["joint_names"])}
        latency = archive["latency_ms"] if "latency_ms" in archive else np.full(len(q), np.nan)
    model, data, base, wrist, tip_ids = scorer.load_hand()
    driver = {
        model.joint(slave).name: model.joint(master).name
        for slave, master in zip(model.eq_obj1id, model.eq_obj2id, strict=True)
    }
    names = [model.joint(i).name for i in range(model.njnt)]
    q = q[:, [column[n] if n in column else column[driver[n]] for n in names]]
    tips = np.empty((len(q), 5, 3))
    for t, pose in enumerate(q):
        data.qpos[:] = pose
        mujoco.mj_kinematics(model, data)
        tips[t] = data.xpos[tip_ids]
    aligned = np.array([scorer.align(p, base) for p in nodes[..., :3].astype(float)])
    return Trace(
        human=aligned[:, FROM_MANUS_25],
        robot_tips=tips,
        robot_wrist=wrist,
        fingers=FINGERS,
        joint_positions=q,
        joint_limits=model.jnt_range,
        stamps=stamps,
        status=np.zeros(len(q), int),
        latency_ms=latency,
    )


@pytest.mark.parametrize(
    ("method", "start"),
    # of keyvector the robot often rests while the human moves
    [("ako", 0), ("joint_angle", 0), ("keyvector", 0), ("sampling_based", 2600), ("late", 2600)],
)
def test_agrees_with_the_independent_scorer(method, start, shared, scorer, recording, tmp_path):
    nodes, stamps = (array[start : start + FRAMES] for array in recording)
    source = tmp_path / "recording.npz"
    np.savez(source, data=nodes, timestamps=stamps)
    peer = "sampling_based" if method == "late" else method
    output = shared / "peers" / f"{peer}_subject-000_frames-{start}-{start + FRAMES}.npz"
    if method == "late":  # three frames late, and with latencies
        with np.load(output, allow_pickle=False) as archive:
            q, names = archive["joint_positions"], archive["joint_names"]
        q = np.concatenate([q[:1]] * 3 + [q])[:FRAMES]
        output = tmp_path / "late.npz"
        latency = np.random.default_rng(0).gamma(2.0, size=FRAMES)
        np.savez(output, joint_positions=q, joint_names=names, latency_ms=latency)

    theirs = scorer.score(source, output)
    ours = evaluate(trace_of(scorer, nodes, stamps, output))

    found = {their_name: ours[name] for their_name, name in NAMES.items()}
    assert found == pytest.approx({name: theirs[name] for name in found}, rel=1e-9, abs=1e-9)
    assert round(ours["rate_hz"], 1) == theirs["rate_hz"]
    assert ours["flatness"] == pytest.approx(theirs["flatness"], rel=1e-9, abs=0)
    if method == "late":
        assert 20 < ours["lag_ms"] < 45
        assert ours["latency_ms"]["p50"] == pytest.approx(theirs["latency_p50"], rel=1e-12)
        assert ours["latency_ms"]["p99"] == pytest.approx(theirs["latency_p99"], rel=1e-12)
