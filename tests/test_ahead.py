"""Frames of both hands answered side by side: the same commands, whatever comes in between."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from smooth_operator import HandFrame, Retargeter, load_hand
from smooth_operator.synthetic import SyntheticOperator
from smooth_operator.teleop.runtime.ahead import Ahead, Helper
from smooth_operator.teleop.runtime.loop import TeleopLoop
from smooth_operator.teleop.runtime.pipeline import HandPipeline
from smooth_operator.teleop.runtime.settings import LoopConfig
from smooth_operator.teleop.sinks.runner import SinkRunner
from smooth_operator.teleop.sources.live import Arrival, Running, ThreadedSource
from smooth_operator.types import Side

RATE = 50.0


@pytest.fixture(scope="module")
def retargeter() -> Retargeter:
    return Retargeter(load_hand("mimic_p050"), method="joint_angle")


@pytest.fixture(scope="module")
def frames() -> list[HandFrame]:
    return list(SyntheticOperator(seed=6, rate_hz=RATE).record(1.0))


@pytest.fixture
def helper() -> Iterator[Helper]:
    with Helper() as running:
        yield running


def pipeline(retargeter: Retargeter) -> tuple[HandPipeline, list[float]]:
    time = [0.0]
    return HandPipeline(retargeter, LoopConfig(rate=RATE), clock=lambda: time[0]), time


def arrival(frame: HandFrame, now: float) -> Arrival:
    return Arrival(frame, now)


def commands(
    retargeter: Retargeter, frames: list[HandFrame], helper: Helper | None
) -> list[np.ndarray]:
    """With everything that can come between a frame and its turn."""
    hand, time = pipeline(retargeter)
    sent = []
    for i, frame in enumerate(frames):
        time[0] = i / RATE
        now = arrival(frame, time[0])
        if helper is not None:
            seen = arrival(frames[i - 1], time[0]) if i % 7 == 3 else now  # a newer one came
            hand.work_ahead(seen, helper)
            if i % 11 == 5:
                hand.work_ahead(now, helper)
        if i == 20:
            hand.switch(retargeter)  # which begins with another state
        if i == 30:
            hand.supervisor.pause()
        if i == 35:
            hand.supervisor.resume()
        sent.append(hand.step(time[0], None if i % 13 == 8 else now).command.positions)
    return sent


def test_commands_are_the_same(
    retargeter: Retargeter, frames: list[HandFrame], helper: Helper
) -> None:
    alone, helped = (commands(retargeter, frames, one) for one in (None, helper))
    np.testing.assert_array_equal(helped, alone)
    assert np.ptp(np.stack(alone), axis=0).max() > 0.1


def test_the_other_thread_does_the_work(
    retargeter: Retargeter,
    frames: list[HandFrame],
    helper: Helper,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    hand, time = pipeline(retargeter)
    hand.step(0.0, arrival(frames[0], 0.0))
    own, called, done = retargeter.step, [], threading.Event()

    def step(*given: object) -> object:
        called.append(threading.current_thread().name)
        try:
            return own(*given)  # type: ignore[arg-type]
        finally:
            done.set()

    monkeypatch.setattr(retargeter, "step", step)
    time[0] = 1 / RATE
    now = arrival(frames[1], time[0])
    hand.work_ahead(now, helper)
    assert done.wait(30)
    hand.step(time[0], now)
    assert called == ["ahead"]


def test_a_call_that_no_thread_begins_is_made_where_its_value_is_wanted() -> None:
    call = Ahead(threading.current_thread)
    assert call.value() is threading.current_thread()
    assert call.value() is threading.current_thread()
    withdrawn = Ahead(pytest.fail, "it was withdrawn")
    assert withdrawn.withdraw()
    withdrawn.work()


def test_what_a_call_raises_is_raised_where_its_value_is_wanted(helper: Helper) -> None:
    call = helper.begin(int, "no number")
    with pytest.raises(ValueError, match="no number"):
        call.value()
    assert helper.begin(int, "7").value() == 7  # the thread goes on
    assert not call.withdraw()


@dataclass
class Together(ThreadedSource):
    """Frames of both hands, posted together."""

    frames: list[HandFrame]
    label: str = "together"

    def run(self, running: Running) -> None:
        for frame in self.frames:
            if running.stopping.wait(0.1):
                return
            with running.mailbox._arrived:  # as one message: the loop wakes to both
                running.mailbox.post(frame)
                mirrored = frame.landmarks * np.array([-1, 1, 1])
                running.mailbox.post(replace(frame, landmarks=mirrored, side="left"))


def test_the_loop_answers_both_hands_side_by_side(
    retargeter: Retargeter, frames: list[HandFrame], monkeypatch: pytest.MonkeyPatch
) -> None:
    left = Retargeter(load_hand("mimic_p050", "left"), method="joint_angle")
    began = threading.Event()
    answer_right, answer_left = retargeter.step, left.step

    def of_right(*given: Any) -> Any:
        began.wait(0.05)  # the first frame of the left hand is not worked out ahead
        return answer_right(*given)

    def of_left(*given: Any) -> Any:
        if threading.current_thread().name == "ahead":
            began.set()
        return answer_left(*given)

    monkeypatch.setattr(retargeter, "step", of_right)
    monkeypatch.setattr(left, "step", of_left)
    config = LoopConfig(rate=10.0)
    pipelines: dict[Side, HandPipeline] = {
        "right": HandPipeline(retargeter, config),
        "left": HandPipeline(left, config),
    }
    loop = TeleopLoop(pipelines, Together(frames[:10]), SinkRunner([]), config)
    loop.helped = True  # also where there is one core
    loop.run()
    assert began.is_set()
    assert all(thread.name != "ahead" for thread in threading.enumerate())
