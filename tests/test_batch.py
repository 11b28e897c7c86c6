"""Recordings side by side: what `run` gives for each, whatever else is in the batch."""

from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest

from smooth_operator import method_config
from smooth_operator.errors import ConfigError
from smooth_operator.retargeting.batching import BatchRetargeter
from smooth_operator.retargeting.sbr.method import SbrConfig
from smooth_operator.retargeting.sbr.sampling import SamplingConfig
from smooth_operator.retargeting.smooth import SmoothConfig
from smooth_operator.retargeting.smooth_terms import SelfCollisionConfig
from smooth_operator.retargeting.trajectory import TrajectoryConfig, TrajectoryMethodConfig
from smooth_operator.retargeting.trajectory_retargeter import TrajectoryRetargeter
from smooth_operator.synthetic import SyntheticOperator
from smooth_operator.types import HandRecording, Side, Status

# Quick to compile; the programs are those of test_retarget_folder.py, and compiled once for both.
SBR = SbrConfig(sampling=SamplingConfig(samples=256, elites=8, cycles=2, draws="quasi"))
_PAPER = SamplingConfig(samples=512, elites=8, cycles=2)
PAPER = replace(cast(SbrConfig, method_config("sbr", "paper")), sampling=_PAPER)
"""A loop of known length, with the search for elites in a table: see ``selection.largest``."""

SMOOTH = replace(
    cast(SmoothConfig, method_config("smooth")), self_collision=SelfCollisionConfig(weight=0.0)
)
"""It compiles in half the time of ``smooth`` with capsules."""

LENGTHS = (60, 1, 71, 12, 52, 3, 5, 8, 20, 7)
"""More than there are lanes."""


def hand(frames: int, seed: int, side: Side = "right") -> HandRecording:
    return SyntheticOperator(seed=seed, side=side).record((frames + 0.5) / 100)[:frames]


def damaged(side: Side = "right") -> list[HandRecording]:
    """Of several lengths, at uneven times, with lost frames, a gap of a second and a flat palm."""
    rng = np.random.default_rng(0)
    recordings = []
    for seed, frames in enumerate(LENGTHS):
        whole = hand(frames, seed, side)
        landmarks = whole.landmarks.copy()
        stamps = np.cumsum(rng.uniform(0.005, 0.015, frames)) + 1e4 * seed
        if frames > 50:
            landmarks[:2] = np.nan
            landmarks[20:24] = np.nan
            landmarks[30, 8] = np.nan
            landmarks[33, :] = landmarks[33, 0]
            stamps[45:] += 1.0
        recordings.append(replace(whole, landmarks=landmarks, stamps=stamps, valid=None))
    return recordings


def close(retargeter: BatchRetargeter, recordings: list[HandRecording], batch: Any) -> None:
    """As `run` but for rounding, until a gap makes `smooth` search for a basin again: which one its
    sampler then finds depends on the last bits. Noise of 1e-7 m in the landmarks changes the summed
    loss of `run` by a factor of up to 2 here; and without a gap it turns one joint of `smooth` by
    0.044 rad in three frames, where the fingertips differ by 0.16 mm."""
    smooth = isinstance(retargeter.config, SmoothConfig)
    until, most = (45, 0.05) if smooth else (None, 0.02)
    for recording, (commands, loss) in zip(recordings, batch, strict=True):
        single, single_loss = retargeter.run(recording)
        np.testing.assert_array_equal(commands.status, single.status)
        np.testing.assert_array_equal(commands.stamps, single.stamps)
        assert commands.joint_names == single.joint_names
        assert np.isnan(commands.latency_ms).all()
        one, other = (c.joint_positions[:until] for c in (commands, single))
        np.testing.assert_allclose(one, other, atol=most)
        tips = retargeter.hand.tips
        np.testing.assert_allclose(tips(one), tips(other), atol=5e-4)
        np.testing.assert_array_equal(np.isnan(loss), np.isnan(single_loss))
        np.testing.assert_allclose(loss[:until], single_loss[:until], rtol=0.02, atol=1e-3)
        if until is None:
            np.testing.assert_allclose(np.nansum(loss), np.nansum(single_loss), rtol=0.02)
        else:
            assert np.nansum(loss) < 3.0 * np.nansum(single_loss) + 1.0


def bits(result: Any) -> tuple[bytes, bytes, bytes]:
    commands, loss = result
    return commands.joint_positions.tobytes(), commands.status.tobytes(), loss.tobytes()


@pytest.fixture(
    scope="module",
    params=[
        "sbr",
        pytest.param("sbr:paper", marks=pytest.mark.weekly),
        "smooth",
        pytest.param("geort", marks=pytest.mark.weekly),
        "joint_angle",
    ],
)
def retargeter(request) -> BatchRetargeter:
    configs = {"sbr": SBR, "sbr:paper": PAPER, "smooth": SMOOTH}
    config = configs.get(request.param) or method_config(request.param)
    return BatchRetargeter(config=config, seed=3)


def test_a_batch_is_each_recording_alone(retargeter):
    recordings = damaged()
    seen: list[int] = []
    batch = retargeter.batch(recordings, track=lambda steps: (seen.append(i) or i for i in steps))
    assert seen == list(range(sum(LENGTHS)))
    close(retargeter, recordings, batch)
    statuses = np.concatenate([commands.status for commands, _ in batch])
    assert {Status.OK, Status.INVALID_LANDMARKS, Status.DEGENERATE_PALM} <= set(statuses)
    # it does not matter what else there is, in which order, or in which lane: to the last bit, but
    # for methods without Newton steps, whose lanes a processor without AVX-512 rounds differently
    other = hand(90, 17)
    again = retargeter.batch([recordings[2], other, *recordings[::-1]])
    first = retargeter.batch(recordings[:1])[0]
    pairs = [(again[0], batch[2]), *zip(again[2:], batch[::-1], strict=True), (first, batch[0])]
    if isinstance(retargeter.config, SmoothConfig | SbrConfig):
        assert all(bits(one) == bits(two) for one, two in pairs)
    for (one, loss), (two, its_loss) in pairs:
        np.testing.assert_array_equal(one.status, two.status)
        np.testing.assert_allclose(one.joint_positions, two.joint_positions, rtol=0, atol=1e-5)
        np.testing.assert_allclose(loss, its_loss, rtol=1e-4, atol=1e-6)


def test_left_hands_as_right_ones():
    left, right = BatchRetargeter(side="left", config=SBR), BatchRetargeter(config=SBR)
    recordings = damaged("left")
    mirrored = [replace(r, side="right", landmarks=r.landmarks * [-1, 1, 1]) for r in recordings]
    pairs = zip(left.batch(recordings), right.batch(mirrored), strict=True)
    for (one, _), (other, _) in pairs:
        assert one.joint_positions.tobytes() == other.joint_positions.tobytes()
    with pytest.raises(ConfigError, match="a right human hand can't drive the left hand"):
        left.batch([*recordings, hand(3, 0)])
    assert left.batch([]) == []


def test_a_solver_on_the_host_takes_recordings_in_turn():
    retargeter = BatchRetargeter(method="keyvector")
    recordings = [hand(8, 0), hand(3, 1)]
    for recording, (commands, loss) in zip(recordings, retargeter.batch(recordings), strict=True):
        single, single_loss = retargeter.run(recording)
        assert commands.joint_positions.tobytes() == single.joint_positions.tobytes()
        np.testing.assert_array_equal(loss, single_loss)
        assert np.isnan(commands.latency_ms).all()


def test_whole_recordings_in_a_batch_are_each_alone():
    future = TrajectoryConfig(acceleration_weight=2e-8, iterations=3)
    whole = TrajectoryRetargeter(
        BatchRetargeter(config=SBR).hand, TrajectoryMethodConfig(SBR, future, jump=0.03)
    )
    recordings = damaged()[:3]
    batch = whole.batch(recordings)
    assert [bits(whole.run(recording)) for recording in recordings] == list(map(bits, batch))
