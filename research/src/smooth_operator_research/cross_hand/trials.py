"""Trials of the cross-hand matrix: record, retarget, replay in physics, score."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final, TypeAlias

from smooth_operator.errors import SmoothOperatorError
from smooth_operator.hands.hand import Hand
from smooth_operator.hands.registry import load_hand
from smooth_operator.retargeting.batching import BatchRetargeter
from smooth_operator.retargeting.known_gaps import known_gaps
from smooth_operator.retargeting.method import MethodConfig
from smooth_operator.retargeting.program_store import ProgramStore
from smooth_operator.simulation.tasks import FIXED_WRIST
from smooth_operator.simulation.tasks.task import PRESSES_N
from smooth_operator.types import CommandTrajectory
from smooth_operator_benchmark.cells import select_methods
from smooth_operator_research.cross_hand import fixed_wrist, human, replay
from smooth_operator_research.cross_hand.fixed_wrist import FixedWristDemonstration, Watch
from smooth_operator_research.cross_hand.human import HumanDemonstration
from smooth_operator_research.cross_hand.results import Cell, Row, Trial
from smooth_operator_research.cross_hand.scenes import SCALED, scene_of
from smooth_operator_research.demonstrations.trial_loop import Moment

CEILING: Final = "own demonstration"
"""Method of a ceiling: the joint positions of the hand's own demonstration, searched in physics."""


@dataclass(frozen=True)
class Block:
    """Trials of one hand in one task with one method, as work for one process.

    Attributes:
        task: name of the task, perhaps with ``SCALED``.
        hand: name of the right hand.
        method: method as ``METHOD:PRESET``, or ``CEILING``.
        worlds: world number and tracker of each trial; tracker "" for the ceiling.
    """

    task: str
    hand: str
    method: str
    worlds: tuple[tuple[int, str], ...]

    def cell(self, tracker: str) -> Cell:
        """Cell of the trials with a tracker."""
        return Cell(self.task, self.hand, self.method, tracker)


def run_block(block: Block) -> dict[str, Row]:
    """Does the trials of a block; returns a row for each tracker."""
    rows = {tracker: Row() for _, tracker in block.worlds}
    try:
        hand = load_hand(block.hand, "right")
        scene_of(block.task, hand)  # before the long work
        trials = [judge(moments) for moments in play_block(hand, block)]
    except SmoothOperatorError as error:  # the hand, its scene, or the method with this hand
        return {tracker: Row(obstacle=str(error)) for tracker in rows}
    for (world, tracker), trial in zip(block.worlds, trials, strict=True):
        rows[tracker].trials[world] = trial
    return rows


def play_block(
    hand: Hand, block: Block, watch: Watch = lambda physics: None
) -> Iterator[Iterator[Moment]]:
    """Yields the moments of each trial of a block, in its order.

    Args:
        watch: receives the physics of each trial before its first moment.
    """
    if block.method == CEILING:
        for world, _ in block.worlds:
            yield fixed_wrist.play_own(hand, block.task, world, watch)
        return
    task, scaled = block.task.removesuffix(SCALED), block.task.endswith(SCALED)
    demonstrations = [record(task, *world) for world in block.worlds]
    joints = {}
    for chosen in dict.fromkeys(tracker for _, tracker in block.worlds):
        places = [k for k, (_, tracker) in enumerate(block.worlds) if tracker == chosen]
        own = [demonstrations[k] for k in places]
        for k, commands in zip(places, retarget(hand, block.method, own, chosen), strict=True):
            joints[k] = commands.joint_positions
    for k, demonstration in enumerate(demonstrations):
        if isinstance(demonstration, HumanDemonstration):
            yield replay.play(hand, demonstration, joints[k], watch, scaled=scaled)
        else:
            yield fixed_wrist.play(hand, demonstration, joints[k], watch)


Demonstration: TypeAlias = HumanDemonstration | FixedWristDemonstration


def record(task: str, world: int, tracker: str) -> Demonstration:
    """Records the human of a world with a tracker."""
    if task in FIXED_WRIST:
        return fixed_wrist.record(task, world, tracker)
    return human.record(task, world, tracker)


def retarget(
    hand: Hand, method: str, demonstrations: Sequence[Demonstration], tracker: str
) -> list[CommandTrajectory]:
    """Retargets demonstrations that one kind of tracker recorded.

    Args:
        method: method and preset, such as ``sbr:paper``.
    """
    retargeter = BatchRetargeter(
        hand,
        config=method_of(method),
        pinch_gaps=known_gaps(tracker),
        cache=ProgramStore.of_user(),
    )
    # With one lane no work is wasted on lanes without a recording.
    batch = retargeter.batch([each.recording for each in demonstrations], lanes=1)
    return [commands for commands, _ in batch]


def judge(moments: Iterable[Moment]) -> Trial:
    """Result of a trial, from its moments until it is done or its commands end."""
    thumb = finger = both = False
    mechanism = 0.0
    for moment in moments:
        presses = moment.state.force > PRESSES_N
        thumb |= bool(presses[0])
        finger |= bool(presses[1:].any())
        both |= bool(presses[0] and presses[1:].any())
        mechanism = max(mechanism, moment.state.mechanism)
    run = moment.run
    outcome = run.outcome or run.finish(moment.state.time).outcome
    assert outcome is not None
    contact = "b" if both else "s" if thumb and finger else "t" if thumb else "f" if finger else "n"
    reason = re.sub(r"-?\d+(?=°| c?m)", "#", f"{outcome.line}: {outcome.reason}")
    return Trial(outcome.score, reason, outcome.ended[0], contact, outcome.seconds, mechanism)


def method_of(name: str) -> MethodConfig:
    """Configuration of a method, such as ``sbr:paper``."""
    (choice,) = select_methods((name,))
    return choice.config
