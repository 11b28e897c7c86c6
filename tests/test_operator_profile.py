"""The operator's profile: its file, its corrections, and that every method is given them."""

import json
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from smooth_operator import Retargeter, SyntheticOperator, load_hand, method_config, method_names
from smooth_operator.calibration.operator_file import read_operator, write_operator
from smooth_operator.errors import ConfigError, UnknownNameError
from smooth_operator.geometry import umeyama
from smooth_operator.hands.hand import Hand
from smooth_operator.human.aligned_recording import align_recording
from smooth_operator.human.alignment import AlignmentConfig, palm_alignment
from smooth_operator.human.flat_hand import human_palm_axes
from smooth_operator.human.operator import (
    COMPONENTS,
    Component,
    FingerProfile,
    OperatorProfile,
    tip_frames,
)
from smooth_operator.landmarks import BASES, TIPS
from smooth_operator.objective.targets import CloseTargets
from smooth_operator.types import HandRecording

PALM = (0, *BASES)
GAP = 0.006


def profile(hand: Hand, *apply: Component) -> OperatorProfile:
    return OperatorProfile(
        hand=hand.name,
        side=hand.spec.side,
        scale=0.8,
        palm_width=0.07,
        palm_length=0.1,
        fingers=tuple(
            FingerProfile(
                f.name, f.tip.body, (0.04, 0.03, 0.02), 0.09, 0.1, 1.1, 0.003, 0.005, GAP, 0.001
            )
            for f in hand.spec.fingers
        ),
        palm_rotation=(np.cos(0.1), 0.0, np.sin(0.1), 0.0),
        project=0.011,
        escape=0.017,
        apply=apply,
        source="here",
    )


@pytest.fixture(scope="module")
def recording() -> HandRecording:
    return SyntheticOperator(seed=4, gestures=("pinch_index", "spread")).record(4.0)


def corrected(
    hand: Hand, landmarks: np.ndarray, operator: OperatorProfile
) -> tuple[np.ndarray, np.ndarray]:
    """Aligned landmarks before and after."""
    fit = palm_alignment(landmarks, hand)
    aligned = fit.apply(landmarks)
    return aligned, operator.correct(aligned, fit.scale, hand, human_palm_axes(hand))


def thumb_to(points: np.ndarray, finger: int) -> np.ndarray:
    return np.asarray(np.linalg.norm(points[:, TIPS[finger]] - points[:, TIPS[0]], axis=-1))


def test_nothing_applied_changes_nothing(hand, recording):
    before, after = corrected(hand, recording.landmarks, profile(hand))
    np.testing.assert_array_equal(after, before)


def test_tips_move_by_their_offset_and_nothing_else_does(hand, recording):
    before, after = corrected(hand, recording.landmarks, profile(hand, "tips"))
    rest = [i for i in range(21) if i not in TIPS]
    np.testing.assert_array_equal(after[:, rest], before[:, rest])
    moved = np.linalg.norm(after - before, axis=-1)[:, TIPS]
    scale = np.asarray(palm_alignment(recording.landmarks, hand).scale)[:, None]
    np.testing.assert_allclose(moved, np.hypot(0.003, 0.005) * scale * np.ones(5), rtol=1e-9)


def test_the_pad_is_on_the_side_that_a_finger_flexes_to(hand, recording):
    points, _ = corrected(hand, recording.landmarks, profile(hand))
    _, pad = tip_frames(points, [0, 1, 2, 3, 4], human_palm_axes(hand))
    pinching = thumb_to(points, 1) < 0.006
    assert pinching.sum() > 20
    # In a pinch pads face each other: to the pad is towards the other finger's last bone.
    index = points[pinching, TIPS[1] - 1] - points[pinching, TIPS[0]]
    thumb = points[pinching, TIPS[0] - 1] - points[pinching, TIPS[1]]
    assert ((pad[pinching, 0] * index).sum(axis=-1) > 0).all()
    assert ((pad[pinching, 1] * thumb).sum(axis=-1) > 0).all()


def test_pinches_close_and_an_open_hand_stays(hand, recording):
    before, after = corrected(hand, recording.landmarks, profile(hand, "pinch"))
    gap, left = thumb_to(before, 1), thumb_to(after, 1)
    assert (left <= gap + 1e-12).all()
    near = gap < 0.008
    scale = np.asarray(palm_alignment(recording.landmarks, hand).scale)
    closed = np.maximum(gap - GAP * scale, 0.0)
    assert near.any()  # other fingers come near too, and the thumb can't go to all of them
    np.testing.assert_allclose(left[near], closed[near], atol=0.001)
    far = np.all([thumb_to(before, i) > 0.05 for i in range(1, 5)], axis=0)
    assert far.any()
    np.testing.assert_array_equal(after[far], before[far])
    # A distance that grows is never seen to shrink.
    fit = np.linspace(0, 0.06, 400)
    pair = np.repeat(before[:1], len(fit), axis=0)
    pair[:, TIPS[1]] = pair[:, TIPS[0]] + fit[:, None] * np.array([0.0, 0.0, 1.0])
    pair[:, TIPS[2:]] += 0.2
    operator = profile(hand, "pinch")
    seen = thumb_to(operator.correct(pair, np.full(400, 0.8), hand, human_palm_axes(hand)), 1)
    assert (np.diff(seen) >= -1e-9).all()


def test_a_thumb_that_two_fingers_meet_goes_to_them_once(hand, recording):
    points = corrected(hand, recording.landmarks[:1], profile(hand))[0]
    points[:, TIPS[1:]] = points[:, TIPS[0], None] + 0.2
    points[:, TIPS[1:3]] = points[:, TIPS[0], None] + np.array([0.0, 0.0, 0.007])
    after = profile(hand, "pinch").correct(points, np.full(1, 0.8), hand, human_palm_axes(hand))
    for finger in (1, 2):
        assert thumb_to(after, finger) == pytest.approx(max(0.007 - GAP * 0.8, 0.0), abs=1e-6)


def test_fingers_reach_further_and_keep_their_pinch(hand, recording):
    operator = profile(hand, "fingers")
    before, after = corrected(hand, recording.landmarks, operator)
    open_hand = int(np.argmax(thumb_to(before, 1)))
    reach = [
        np.linalg.norm(p[open_hand, TIPS[2]] - p[open_hand, BASES[2]]) for p in (before, after)
    ]
    assert reach[1] / reach[0] == pytest.approx(1.1 / 0.8, rel=1e-6)
    closest = int(np.argmin(thumb_to(before, 1)))
    assert thumb_to(after, 1)[closest] == pytest.approx(thumb_to(before, 1)[closest], abs=5e-4)
    np.testing.assert_array_equal(after[:, PALM], before[:, PALM])


def test_the_palm_turns_as_a_whole(hand, recording):
    before, after = corrected(hand, recording.landmarks[:5], profile(hand, "palm"))
    fit = umeyama(before, after, scale=1.0)
    np.testing.assert_allclose(fit.apply(before), after, atol=1e-12)
    angle = np.arccos((np.trace(fit.rotation[0]) - 1) / 2)
    assert angle == pytest.approx(0.2, abs=1e-9)


def test_one_scale_instead_of_one_a_frame(hand, recording):
    operator = profile(hand, "scale")
    assert AlignmentConfig(operator=operator).fixed_scale == 0.8
    assert AlignmentConfig(scale=0.5, operator=operator).fixed_scale == 0.5
    assert AlignmentConfig(operator=operator.without("scale")).fixed_scale is None
    fit = palm_alignment(recording.landmarks, hand, AlignmentConfig(operator=operator))
    assert (np.asarray(fit.scale) == 0.8).all()


def test_what_is_measured_against_is_the_hand_as_tracked(hand, recording):
    with_operator = AlignmentConfig(operator=profile(hand, *COMPONENTS))
    np.testing.assert_array_equal(
        align_recording(recording, hand, with_operator), align_recording(recording, hand)
    )


def test_a_left_hand_is_corrected_as_its_mirror_image(hand, recording):
    left, mirror = load_hand(side="left"), np.array([-1.0, 1.0, 1.0])
    right = profile(hand, *COMPONENTS)
    w, x, y, z = right.palm_rotation
    other = replace(right, side="left", palm_rotation=(w, x, -y, -z))
    _, a = corrected(hand, recording.landmarks, right)
    _, b = corrected(left, recording.landmarks * mirror, other)
    np.testing.assert_allclose(b, a * mirror, atol=1e-9)


def test_the_correction_is_the_same_when_it_is_compiled(hand, recording):
    operator, axes = profile(hand, *COMPONENTS), human_palm_axes(hand)
    fit = palm_alignment(recording.landmarks[::40], hand)
    aligned = fit.apply(recording.landmarks[::40])
    compiled = jax.jit(lambda points, scale: operator.correct(points, scale, hand, axes))
    got = compiled(jnp.asarray(aligned, jnp.float32), jnp.asarray(fit.scale, jnp.float32))
    want = operator.correct(aligned, fit.scale, hand, axes)
    np.testing.assert_allclose(np.asarray(got), want, atol=2e-6)


def test_it_stays_finite_where_tips_coincide(hand, recording):
    points = recording.landmarks[:1].copy()
    points[:, TIPS[1]] = points[:, TIPS[0]]
    points[:, TIPS[2]] = points[:, TIPS[2] - 1]
    assert np.isfinite(corrected(hand, points, profile(hand, *COMPONENTS))[1]).all()


@pytest.mark.parametrize(
    "method",
    # the hand is corrected before a method has it: each run has one of each way to solve
    [pytest.param(name, marks=[pytest.mark.weekly] * (name not in ("joint_angle", "keyvector")))
     for name in method_names()],
)  # fmt: skip
def test_every_method_is_driven_by_the_corrected_hand(method, hand, recording):
    frames = recording[100:104]
    operator = profile(hand, "tips", "fingers")
    _, seen = corrected(hand, frames.landmarks, operator)
    plain = Retargeter(hand, method=method)
    config = method_config(method).with_operator(operator)
    driven = Retargeter(hand, config=config)
    # The palm's landmarks are the robot's frame already, so this hand is not aligned any further.
    by_hand = list(replace(frames, landmarks=seen))
    # Both go on from one state: in a first frame `smooth` searches for a basin, and which of two it
    # takes may depend on the last bits of the landmarks, and on the release of JAX.
    start, _ = plain.step(plain.init(), by_hand[0])
    states = [start, start, start]
    apart = []
    for frame, same in zip(list(frames)[1:], by_hand[1:], strict=True):
        pairs = zip((driven, plain, plain), states, (frame, same, frame), strict=True)
        steps = [retargeter.step(state, seen) for retargeter, state, seen in pairs]
        states = [state for state, _ in steps]
        ours, theirs, uncorrected = (result.command.joint_positions for _, result in steps)
        np.testing.assert_allclose(ours, theirs, atol=0.02)
        apart.append(np.abs(ours - uncorrected).max())
    assert max(apart) > 1e-3


def test_latches_close_at_the_operators_distances(hand):
    operator = profile(hand, "pinch")
    for method in ("sbr", "dexpilot"):
        config: Any = method_config(method).with_operator(operator)
        targets = config.objective.targets
        assert (targets.project, targets.escape) == (0.011, 0.017)
        without: Any = method_config(method).with_operator(operator.without("pinch"))
        original: Any = method_config(method)
        assert without.objective == original.objective
    unseen = replace(operator, project=None, escape=None)
    config = method_config("dexpilot").with_operator(unseen)
    assert config.objective == method_config("dexpilot").objective


def test_a_frame_without_what_the_correction_needs_is_held(hand, recording):
    config = method_config("geort").with_operator(profile(hand, "tips"))
    retargeter = Retargeter(hand, config=config)
    landmarks = recording.landmarks[0].copy()
    landmarks[TIPS[3] - 1] = np.nan  # GeoRT itself asks for no such landmark
    assert retargeter(landmarks).status.name == "INVALID_LANDMARKS"
    assert Retargeter(hand, method="geort")(landmarks).status.name == "OK"


def test_a_profile_serves_the_hand_it_was_made_for(hand):
    operator = profile(hand, "tips")
    operator.check(load_hand(fingers=("thumb", "index")))  # fewer of the same fingers
    config = AlignmentConfig(operator=operator)
    cases = {
        "for the right hand 'mimic_p050', not for the left": load_hand(side="left"),
        "--hand leap_hand": load_hand("leap_hand"),
        "ring driving ring_dp, not pinky_dp": load_hand(
            fingers={"thumb": "thumb", "index": "index", "pinky": "ring"}
        ),
    }
    for message, other in cases.items():
        with pytest.raises(ConfigError, match=message):
            Retargeter(other, config=replace(method_config("keyvector"), alignment=config))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"scale": float("nan")}, "scale must be from"),
        ({"palm_width": 7.0}, "palm_width must be from"),
        ({"palm_rotation": (1.0, 1.0, 0.0, 0.0)}, "unit quaternion"),
        ({"escape": None}, "belong together"),
        ({"escape": 0.001}, "escape must be from"),
        ({"fingers": ()}, "2 to 5 different"),
    ],
)
def test_figures_that_are_no_hands_are_refused(change, message, hand):
    with pytest.raises(ConfigError, match=message):
        replace(profile(hand), **change)


def test_an_unknown_component_is_named(hand):
    with pytest.raises(UnknownNameError, match=r"'tip'.*tips"):
        profile(hand, "tip")


@pytest.mark.parametrize("side", ["right", "left"])
def test_the_file_brings_back_every_figure(side, tmp_path):
    operator = profile(load_hand(side=side), "tips", "pinch")
    none = replace(operator, project=None, escape=None, apply=())
    none = replace(none, fingers=tuple(replace(f, pinch_gap=None) for f in none.fingers))
    for each in (operator, none):
        write_operator(tmp_path / "operator.json", each)
        assert read_operator(tmp_path / "operator.json") == each


def test_a_bad_file_says_what_is_wrong_with_it(hand, tmp_path):
    path = tmp_path / "operator.json"
    with pytest.raises(ConfigError, match=r"no such file; expected the OPERATOR\.json"):
        read_operator(path)
    write_operator(path, profile(hand))
    good = json.loads(path.read_text(encoding="utf-8"))

    def refused(message: str, content: object) -> None:
        text = content if isinstance(content, str) else json.dumps(content)
        path.write_text(text, encoding="utf-8")
        with pytest.raises(ConfigError, match=message):
            read_operator(path)

    refused("damaged, or no JSON", '{"format": ')
    refused("describes no operator", [1, 2])
    refused("describes no operator", {"program": "smooth-operator"})
    refused("version 2 of the format.*upgrade", good | {"version": 2})
    refused("scale: is missing; expected a number", {k: v for k, v in good.items() if k != "scale"})
    refused(r"sclae: no such entry. Did you mean 'scale'\?", good | {"sclae": 1})
    refused("scale: expected a finite number, not 'big'", good | {"scale": "big"})
    refused("scale: expected a finite number, not True", good | {"scale": True})
    refused("scale must be from", good | {"scale": 1000})
    refused("side must be", good | {"side": "both"})
    refused("unknown component", good | {"apply": ["everything"]})
    refused("apply: expected a list", good | {"apply": "tips"})
    refused("palm_rotation: expected 4 numbers", good | {"palm_rotation": [1, 0, 0]})
    refused("fingers: expected a table", good | {"fingers": []})
    refused("unknown finger 'toe'", good | {"fingers": {"toe": good["fingers"]["thumb"]}})
    thumb = {k: v for k, v in good["fingers"]["thumb"].items() if k != "bones"}
    refused(
        "fingers.thumb.bones: is missing", good | {"fingers": good["fingers"] | {"thumb": thumb}}
    )


def test_smooth_takes_the_gap_off_lengths_and_leaves_landmarks_alone(hand):
    operator = profile(hand, "scale", "pinch")
    config: Any = method_config("smooth").with_operator(operator)
    used = config.alignment.operator
    assert used.apply == ()  # neither does a scale for all frames
    assert config.unused_components(operator) == ("scale",)
    assert method_config("sbr").unused_components(operator) == ()
    targets = config.objective.targets
    gaps = dict(targets.pinch_gaps)
    assert gaps == pytest.approx({f: g * operator.scale for f, g in operator.pinch_gaps.items()})
    layout = targets.layout(hand.fingers)
    human = np.random.default_rng(0).normal(0, 0.05, (len(layout.vectors), 3))
    human[layout.thumb] *= (
        np.array([0.004, 0.012, 0.03, 0.06]) / np.linalg.norm(human[layout.thumb], axis=1)
    )[:, None]
    plain, closed = (
        np.asarray(policy(policy.init(layout), layout, jnp.asarray(human))[0].vectors)
        for policy in (CloseTargets(), targets)
    )
    others = np.ones(len(human), bool)
    others[layout.thumb] = False
    np.testing.assert_array_equal(closed[others], plain[others])
    before, after = plain[layout.thumb], closed[layout.thumb]
    lengths = [np.linalg.norm(v, axis=1) for v in (before, after)]
    np.testing.assert_allclose(
        before / lengths[0][:, None], after / lengths[1][:, None], atol=1e-5
    )  # directions stay
    assert (lengths[1][:3] < lengths[0][:3]).all()
    assert lengths[1][3] == pytest.approx(lengths[0][3])  # no pinch


def test_gaps_go_by_the_fingers_names():
    targets = CloseTargets(pinch_gaps=(("index", 0.0), ("ring", 0.008)))
    layout = targets.layout(("thumb", "ring"))
    human = jnp.asarray([[0.0, 0.1, 0], [0, 0.1, 0.01], [0, 0, 0.01]])
    closed = targets((), layout, human)[0].vectors[layout.thumb]
    plain = CloseTargets()((), layout, human)[0].vectors[layout.thumb]
    assert float(jnp.linalg.norm(closed)) < float(jnp.linalg.norm(plain)) - 0.004
    with pytest.raises(ConfigError, match="pinch_gaps: ring"):
        CloseTargets(pinch_gaps=(("ring", -0.001),))
