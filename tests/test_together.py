"""Frames of both hands in one program: the answers of single frames, taken only where they fit."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from smooth_operator import HandFrame, Result, Retargeter, load_hand
from smooth_operator.compilation.pair import PairProgram, shares_program
from smooth_operator.synthetic import SyntheticOperator
from smooth_operator.teleop.runtime.loop import TeleopLoop
from smooth_operator.teleop.runtime.pipeline import HandPipeline
from smooth_operator.teleop.runtime.settings import LoopConfig
from smooth_operator.teleop.runtime.together import Together
from smooth_operator.teleop.sinks.runner import SinkRunner
from smooth_operator.teleop.sources.live import Arrival, Running, ThreadedSource
from smooth_operator.types import Side, Status

RATE = 50.0
BOTH: tuple[Side, ...] = ("right", "left")


@pytest.fixture(scope="module")
def made() -> dict[Side, Retargeter]:
    return {side: Retargeter(load_hand("mimic_p050", side), method="joint_angle") for side in BOTH}


@pytest.fixture(scope="module")
def frames() -> dict[Side, list[HandFrame]]:
    return {
        side: list(SyntheticOperator(seed=seed, rate_hz=RATE, side=side).record(1.0))
        for seed, side in enumerate(BOTH)
    }


@pytest.fixture(scope="module")
def pair(made: dict[Side, Retargeter]) -> PairProgram:
    return PairProgram([made[side] for side in BOTH])


def test_answers_are_those_of_single_frames(
    made: dict[Side, Retargeter], frames: dict[Side, list[HandFrame]], pair: PairProgram
) -> None:
    alone = {side: made[side].init() for side in BOTH}
    together = [made[side].init() for side in BOTH]
    lost = np.full((21, 3), np.nan)
    for i in range(30):
        now = [frames[side][i] for side in BOTH]
        if i == 12:
            now[1] = replace(now[1], landmarks=lost)  # it concerns the left hand alone
        answers = pair.step(together, now)
        together = [state for state, _ in answers]
        for side, frame, (_, found) in zip(BOTH, now, answers, strict=True):
            alone[side], expected = made[side].step(alone[side], frame)
            assert found.status == expected.status
            assert found.command.stamp == expected.command.stamp
            np.testing.assert_allclose(
                found.command.positions, expected.command.positions, atol=1e-5
            )
        if i == 12:
            assert [found.status for _, found in answers] == [Status.OK, Status.INVALID_LANDMARKS]


def test_hands_of_two_programs_are_not_answered_together(made: dict[Side, Retargeter]) -> None:
    assert shares_program(made["right"], made["left"])
    other = Retargeter(load_hand("mimic_p050", "left"), method="keyvector")
    assert not shares_program(made["right"], other)
    published = [Retargeter(load_hand("shadow_hand", side), method="joint_angle") for side in BOTH]
    assert not shares_program(published[0], published[1])


def test_an_answer_is_used_only_for_its_state_and_frame(
    made: dict[Side, Retargeter], frames: dict[Side, list[HandFrame]]
) -> None:
    hand = HandPipeline(made["right"], LoopConfig(rate=RATE), clock=lambda: 0.0)
    first, second, third = (Arrival(frame, 0.0) for frame in frames["right"][:3])
    assert hand.expects(first) is None  # the operator is new: a step begins with a new state
    hand.step(0.0, first)

    def offered(arrival: Arrival, loss: float) -> None:
        expected = hand.expects(arrival)
        assert expected is not None
        state, result = made["right"].step(*expected)
        hand.take(*expected, (state, replace(result, tracking_loss=loss)))

    offered(second, 123.0)
    assert hand.step(0.02, second).tracking_loss == 123.0
    offered(second, 123.0)
    assert hand.step(0.04, third).tracking_loss != 123.0  # a newer frame came
    offered(second, 123.0)
    hand.switch(made["right"])
    assert hand.step(0.06, second).tracking_loss != 123.0  # another state
    hand.supervisor.pause()
    assert hand.expects(third) is None


@dataclass
class Message(ThreadedSource):
    """Frames of both hands, posted together."""

    frames: dict[Side, list[HandFrame]]
    label: str = "message"

    def run(self, running: Running) -> None:
        for pair in zip(*self.frames.values(), strict=True):
            if running.stopping.wait(1 / RATE):
                return
            with running.mailbox._arrived:  # as one message: the loop wakes to both
                for frame in pair:
                    running.mailbox.post(frame)


def test_the_loop_answers_both_hands_together(
    made: dict[Side, Retargeter],
    frames: dict[Side, list[HandFrame]],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    config = LoopConfig(rate=RATE)
    loop = TeleopLoop(
        {side: HandPipeline(made[side], config) for side in BOTH},
        Message(frames),
        SinkRunner([]),
        config,
    )
    assert isinstance(loop.together, Together)
    loop.together.prepare([made[side] for side in BOTH], wait=True)
    answered: list[list[Result]] = []
    step = PairProgram.step

    def counted(program: PairProgram, states: object, given: object) -> object:
        found = step(program, states, given)  # type: ignore[arg-type]
        answered.append([result for _, result in found])
        return found

    monkeypatch.setattr(PairProgram, "step", counted)
    loop.run()
    assert len(answered) >= 10  # of 50; a busy machine wakes the loop late
    assert {result.status for pair in answered for result in pair} == {Status.OK}
    assert loop.statistics.summary()["frames_answered"] >= 2 * len(answered)


def test_one_hand_has_nothing_to_be_answered_with(made: dict[Side, Retargeter]) -> None:
    config = LoopConfig(rate=RATE)
    pipelines: dict[Side, HandPipeline] = {"right": HandPipeline(made["right"], config)}
    source = Message({"right": []})
    assert TeleopLoop(pipelines, source, SinkRunner([]), config).together is None
