"""The delay from command to motion is found where there is one, and nowhere else."""

import sys
import threading
from dataclasses import replace

import numpy as np
import pytest
from ticks import make_tick

from smooth_operator.hands.hand import Hand
from smooth_operator.teleop.runtime.statistics import LoopStatistics, MotionDelay, _Track
from smooth_operator.teleop.sinks.tick import HandState
from smooth_operator.types import JointCommand


def motion(at: float, count: int, seed: int = 0) -> np.ndarray:
    """Joint positions [rad] at a time, of several slow waves."""
    random = np.random.default_rng(seed)
    rates, phases = random.uniform(0.2, 1.5, (3, count)), random.uniform(0, 6, (3, count))
    return 0.2 * np.sin(2 * np.pi * rates * at + phases).sum(axis=0)


def driven(
    hand: Hand,
    delay: float,
    *,
    rate: float = 100.0,
    seed: int = 0,
    seconds: float = 6.0,
    noise: float = 0.0,
    moving: float = 1.0,
) -> MotionDelay:
    """Measured delay of a hand that is read 60 times a second."""
    found, count = MotionDelay(), len(hand.joint_names)
    random, base, state = np.random.default_rng(1), make_tick(hand), None
    for k in range(int(seconds * rate)):
        now = 1000.0 + k / rate
        stamp = np.floor(now * 60) / 60
        if state is None or state.stamp != stamp:
            q = moving * motion(stamp - delay, count, seed) + noise * random.normal(size=count)
            q[4] = np.nan  # a joint that nothing measures
            state = HandState("right", hand.name, stamp, hand.joint_names, q)
        command = JointCommand(moving * motion(now, count), hand.joint_names)
        found.add(replace(base, command=command, time=now, state=state))
    return found


@pytest.mark.parametrize("delay", [0.0, 0.037, 0.12, 0.31])
def test_a_delay_is_found_to_a_few_milliseconds(hand, delay):
    found = driven(hand, delay, noise=0.002).now()
    assert found == pytest.approx(delay, abs=0.004)


def test_at_a_thousand_commands_a_second_and_over_hours(hand):
    found = driven(hand, 0.05, rate=1000.0, seconds=12.0).now()
    assert found == pytest.approx(0.05, abs=0.004)


def test_none_without_motion_resemblance_or_time(hand):
    assert MotionDelay().now() is None
    assert driven(hand, 0.05, moving=0.0, noise=1e-4).now() is None
    assert driven(hand, 0.05, seed=5).now() is None
    assert driven(hand, 0.05, seconds=1.0).now() is None


def test_it_is_in_the_summary_of_a_run(hand):
    statistics = LoopStatistics(0.01)
    statistics.add(make_tick(hand), 0.0, 0.0)
    assert statistics.summary()["motion_delay_ms"] == {}
    state = HandState("right", hand.name, 0.0, hand.joint_names, np.zeros(len(hand.joint_names)))
    statistics.add(replace(make_tick(hand), state=state), 0.0, 0.0)
    assert statistics.summary()["motion_delay_ms"] == {"right": None}


def test_a_reader_never_sees_a_time_that_is_not_written_yet():
    """The page reads while the loop writes."""
    tracks = [_Track(1)]
    ended = threading.Event()

    def write() -> None:
        while not ended.is_set():
            track = tracks[0] = _Track(1)
            for number in range(60):
                track.add(0.01 * number, np.zeros(1))

    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    writer = threading.Thread(target=write)
    writer.start()
    try:
        for _ in range(150):
            times, positions = tracks[0].newest()
            assert np.isfinite(times).all()
            assert len(times) == len(positions)
    finally:
        sys.setswitchinterval(before)
        ended.set()
        writer.join()
