"""Presets ``published``: the paper's baselines, against the commands of their authors' code."""

import functools
import importlib.util
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from smooth_operator import Hand, Retargeter, load_hand, method_config, read_recording
from smooth_operator.baselines.joint_angle import JointAngleMap, PublishedAngles
from smooth_operator.landmarks import FINGERS
from smooth_operator.synthetic.hand_anatomy import JOINTS, NUM_JOINTS, draw_anatomy, pose_hand

GLOVE = "recordings/manus_right_subject-000_run-010.npz"
WEEKLY = pytest.mark.weekly
METHODS = ("keyvector", "hybrid", "dexpilot", "ako")
PINCHING = (2600, 3100)

Scorer = Callable[[np.ndarray, tuple[str, ...], tuple[int, int]], dict[str, Any]]
"""Commands, their joint names and the frames of the glove that they answer, to figures."""


@pytest.fixture(scope="module")
def score(shared, tmp_path_factory) -> Scorer:
    """The independent scorer, on frames of the glove recording."""
    spec = importlib.util.spec_from_file_location("scorer", shared / "tools" / "score.py")
    module: ModuleType = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    module.load_hand = functools.cache(module.load_hand)
    folder = tmp_path_factory.mktemp("scored")

    def score(q: np.ndarray, names: tuple[str, ...], frames: tuple[int, int]) -> dict[str, Any]:
        with np.load(shared / GLOVE) as archive:
            cut = {key: archive[key][slice(*frames)] for key in ("data", "timestamps")}
        np.savez(folder / "frames.npz", **cut)
        np.savez(folder / "commands.npz", joint_positions=q, joint_names=np.array(names))
        found: dict[str, Any] = module.score(folder / "frames.npz", folder / "commands.npz")
        found["frozen"] = float((np.abs(np.diff(q, axis=0)).max(axis=1) < 1e-6).mean())
        return found

    return score


@functools.lru_cache(maxsize=8)
def published(hand: Hand, method: str) -> Retargeter:
    return Retargeter(hand, method=method, preset="published")


def commands(shared: Path, retargeter: Retargeter, frames: tuple[int, int]) -> np.ndarray:
    retargeter.reset()
    found, _ = retargeter.run(read_recording(shared / GLOVE)[slice(*frames)])
    return np.asarray(found.joint_positions)


@pytest.mark.shared
@pytest.mark.parametrize(
    "method", [METHODS[0], *(pytest.param(m, marks=WEEKLY) for m in METHODS[1:])]
)
def test_on_a_glove_each_has_the_figures_of_its_authors_code(shared, hand, score, method):
    with np.load(shared / f"peers/{method}_subject-000_frames-0-500.npz") as archive:
        names = tuple(str(name) for name in archive["joint_names"])
        q = archive["joint_positions"].astype(float)
    theirs = score(q, names, (0, 500))
    mine = commands(shared, published(hand, method), (0, 500))
    ours = score(mine, hand.joint_names, (0, 500))
    for figure in ("cosine_thumb", "cosine_all", "scale_ratio", "motion_preservation"):
        assert ours[figure] == pytest.approx(theirs[figure], abs=2e-3), figure
    assert ours["flatness"] == pytest.approx(theirs["flatness"], rel=0.1)
    assert ours["frozen"] == pytest.approx(theirs["frozen"], abs=0.02)
    columns = [names.index(name) for name in hand.joint_names]
    assert np.median(np.abs(mine - q[:, columns])) < 1e-4  # [rad]


@pytest.mark.shared
@pytest.mark.parametrize(
    ("method", "cosine", "gap"),
    [
        ("dexpilot", None, 10.0),
        pytest.param("keyvector", 0.7877, 12.4, marks=WEEKLY),
        pytest.param("hybrid", 0.7289, 17.6, marks=WEEKLY),
        pytest.param("ako", None, 5.35, marks=WEEKLY),
    ],
)
def test_where_the_operator_pinches(shared, hand, score, method, cosine, gap):
    """Figures of the authors' code on these frames, as in docs/reference/benchmarks.md."""
    found = score(commands(shared, published(hand, method), PINCHING), hand.joint_names, PINCHING)
    if cosine is not None:
        assert found["cosine_thumb"] == pytest.approx(cosine, abs=2e-3)
    assert found["pinch_gap_mm"] == pytest.approx(gap, abs=0.1)


@pytest.mark.shared
def test_hybrid_begins_where_the_authors_does(shared, hand):
    with np.load(shared / "peers/joint_angle_subject-000_frames-0-500.npz") as archive:
        names = [str(name) for name in archive["joint_names"]]
        theirs = archive["joint_positions"][:, [names.index(n) for n in hand.actuated_names]]
    human = jnp.asarray(read_recording(shared / GLOVE)[:500].landmarks, jnp.float32)
    ours = jax.jit(jax.vmap(PublishedAngles(hand).positions))(human)
    np.testing.assert_allclose(ours, np.clip(theirs, *hand.limits.T), atol=1e-5)


def test_a_bend_is_shared_among_the_joints_that_make_it(hand):
    """A human PIP joint that bends by an angle: half of it, the driven joint makes the other."""
    poses = np.zeros((2, NUM_JOINTS))
    names = [joint.name for joint in JOINTS]
    for finger in FINGERS[1:]:
        poses[1, names.index(f"{finger}_pip")] = 0.6
    human = jnp.asarray(pose_hand(draw_anatomy(0.19, 0), poses).landmarks, jnp.float32)
    flat, bent = jax.vmap(PublishedAngles(hand).positions)(human)
    moved = dict(zip(hand.actuated_names, np.asarray(bent - flat), strict=True))
    for finger in FINGERS[1:]:
        assert moved[f"{finger}_pp2mp"] == pytest.approx(0.3, abs=0.01)
        assert moved[f"{finger}_mcp2pp"] == pytest.approx(0.0, abs=1e-4)


def test_another_hand_begins_at_our_joint_angles(hand):
    config = method_config("hybrid", "published")
    ours, other = config.build(hand), config.build(load_hand("shadow_hand"))
    assert isinstance(ours.joint_angles, PublishedAngles)
    assert isinstance(other.joint_angles, JointAngleMap)
