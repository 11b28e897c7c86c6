"""Recordings side by side: what `run` gives for each, whatever else is in the batch."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax
from queued import QueuedSmooth

from smooth_operator import Retargeter
from smooth_operator.compilation.lanes import over_lanes
from smooth_operator.errors import ConfigError
from smooth_operator.lab.offline.trajectory_retargeter import TrajectoryRetargeter
from smooth_operator.methods.method import TrajectoryMethodConfig
from smooth_operator.methods.presets import method_config
from smooth_operator.methods.sbr import SbrConfig
from smooth_operator.methods.smooth import SmoothConfig
from smooth_operator.solvers.sampling import SamplingConfig
from smooth_operator.solvers.trajectory import TrajectoryConfig
from smooth_operator.synthetic import SyntheticOperator
from smooth_operator.types import HandRecording, Side, Status

# Quick to compile; the programs are those of test_retarget_folder.py, and compiled once for both.
SBR = SbrConfig(sampling=SamplingConfig(samples=256, elites=8, cycles=2, draws="quasi"))
LENGTHS = (70, 1, 131, 40, 64, 3, 5, 60, 20, 7)
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


def close(retargeter: Retargeter, recordings: list[HandRecording], batch: Any) -> None:
    """As `run` but for rounding, until a gap makes `smooth` search for a basin again: which one its
    sampler then finds depends on the last bits. Noise of 1e-7 m in the landmarks changes the summed
    loss of `run` by a factor of up to 2 here."""
    until = 45 if isinstance(retargeter.config, SmoothConfig) else None
    for recording, (commands, loss) in zip(recordings, batch, strict=True):
        single, single_loss = retargeter.run(recording)
        np.testing.assert_array_equal(commands.status, single.status)
        np.testing.assert_array_equal(commands.stamps, single.stamps)
        assert commands.joint_names == single.joint_names
        assert np.isnan(commands.latency_ms).all()
        one, other = (c.joint_positions[:until] for c in (commands, single))
        np.testing.assert_allclose(one, other, atol=0.02)
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


@pytest.fixture(scope="module", params=["sbr", "smooth", "geort", "joint_angle"])
def retargeter(request: pytest.FixtureRequest) -> Retargeter:
    # Other kernels round otherwise, and noise of 1e-7 m turns a joint here by 0.04 rad.
    own = {"sbr": SBR, "smooth": QueuedSmooth.default()}
    config = own.get(request.param) or method_config(request.param)
    return Retargeter(config=config, seed=3)


def test_a_batch_is_each_recording_alone(retargeter: Retargeter) -> None:
    recordings = damaged()
    seen: list[int] = []
    batch = retargeter.batch(recordings, track=lambda steps: (seen.append(i) or i for i in steps))
    assert seen == list(range(sum(LENGTHS)))
    close(retargeter, recordings, batch)
    statuses = np.concatenate([commands.status for commands, _ in batch])
    assert {Status.OK, Status.INVALID_LANDMARKS, Status.DEGENERATE_PALM} <= set(statuses)
    # to the last bit it does not matter what else there is, in which order, or in which lane
    other = hand(90, 17)
    again = retargeter.batch([recordings[2], other, *recordings[::-1]])
    assert bits(again[0]) == bits(batch[2])
    assert [bits(result) for result in again[2:]] == [bits(result) for result in batch[::-1]]
    assert bits(retargeter.batch(recordings[:1])[0]) == bits(batch[0])


def test_left_hands_as_right_ones() -> None:
    left, right = Retargeter(side="left", config=SBR), Retargeter(config=SBR)
    recordings = damaged("left")
    mirrored = [replace(r, side="right", landmarks=r.landmarks * [-1, 1, 1]) for r in recordings]
    pairs = zip(left.batch(recordings), right.batch(mirrored), strict=True)
    for (one, _), (other, _) in pairs:
        assert one.joint_positions.tobytes() == other.joint_positions.tobytes()
    with pytest.raises(ConfigError, match="a right human hand can't drive the left hand"):
        left.batch([*recordings, hand(3, 0)])
    assert left.batch([]) == []


def test_a_solver_on_the_host_takes_recordings_in_turn() -> None:
    retargeter = Retargeter(method="keyvector")
    recordings = damaged()[:2]
    for recording, (commands, loss) in zip(recordings, retargeter.batch(recordings), strict=True):
        single, single_loss = retargeter.run(recording)
        assert commands.joint_positions.tobytes() == single.joint_positions.tobytes()
        np.testing.assert_array_equal(loss, single_loss)
        assert np.isnan(commands.latency_ms).all()


def test_whole_recordings_in_a_batch_are_each_alone() -> None:
    future = TrajectoryConfig(acceleration_weight=2e-8, iterations=3)
    whole = TrajectoryRetargeter(
        Retargeter(config=SBR).hand, TrajectoryMethodConfig(SBR, future, jump=0.03)
    )
    recordings = damaged()
    batch = whole.batch(recordings)
    assert [bits(whole.run(recording)) for recording in recordings] == list(map(bits, batch))


def settled(x: Any, count: Any) -> tuple[Any, Any]:
    """Halves numbers until they are small; a branch holds a loop, and a loop a branch."""
    calls = jnp.float32(0)

    def step(now: tuple[Any, Any, Any]) -> tuple[Any, Any, Any]:
        left, value, calls = now
        value = lax.cond(left % 2 == 0, lambda v: v * 0.5, lambda v: jnp.sort(v) * 0.7, value)
        return left - 1, value, calls + 1

    _, value, calls = lax.while_loop(
        lambda now: (now[0] > 0) & (jnp.abs(now[1]).max() > 0.1), step, (count, x, calls)
    )
    total, rows = lax.scan(
        lambda sum, row: lax.cond(row > 0, lambda: (sum + row, row), lambda: (sum, -row)),
        jnp.float32(0),
        value,
    )
    return (value, jnp.take(rows, jnp.array([2, 0]))), total + calls


def test_loops_and_branches_over_lanes_are_those_of_each_lane() -> None:
    rng = np.random.default_rng(1)
    x = rng.normal(size=(5, 4)).astype(np.float32)
    count = np.array([0, 3, 9, 1, 40], np.int32)
    many = jax.jit(over_lanes(settled, x[0], count[0]))
    active = np.array([True, True, False, True, True])
    found, total = many(active, x, count)
    for lane in np.flatnonzero(active):
        one, alone = jax.jit(settled)(x[lane], count[lane])
        np.testing.assert_allclose(found[0][lane], one[0], rtol=1e-6)
        np.testing.assert_allclose(found[1][lane], one[1], rtol=1e-6)
        np.testing.assert_allclose(total[lane], alone, rtol=1e-6)


@pytest.mark.parametrize("wanted", [False, True])
def test_a_branch_that_no_lane_needs_is_left_out(wanted: bool) -> None:
    calls: list[int] = []

    def counted(x: Any) -> Any:
        jax.debug.callback(lambda: calls.append(1))
        return x + 1

    def function(x: Any) -> Any:
        return lax.cond(x > 0, counted, lambda x: x, x)

    many: Callable[..., Any] = jax.jit(over_lanes(function, np.float32(0)))
    x = np.array([-1.0, 2.0, -3.0], np.float32)
    # the lane whose number is positive counts, or does not
    found = many(np.array([True, wanted, True]), x)
    jax.effects_barrier()
    assert bool(calls) == wanted
    np.testing.assert_array_equal(np.asarray(found)[[0, 2]], [-1.0, -3.0])
