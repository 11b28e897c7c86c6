"""Tasks with a tool and a moving wrist: drive in a nail; lift tongs, then close and open them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final, Self

from smooth_operator.simulation.scenes.scene import SceneState
from smooth_operator.simulation.scenes.tools import HammerScene, TongsScene
from smooth_operator.simulation.tasks.task import (
    COMMON_ENDS,
    NOT_DONE,
    Assessment,
    RubricLine,
    Task,
    held_by_hand,
    held_since,
    lasted,
    outside,
)

DRIVEN: Final = (0.015, 0.040)
"""Depths of the nail that score 0.5 and 1 [m]; DexJoCo's ``hammer_nail`` asks for the second."""

SQUEEZES: Final = 3
"""Number of times that the tongs are to be shut and opened, as in DexJoCo's ``pinch_tongs``."""

SHUT_BELOW, OPEN_ABOVE = 0.020, 0.030
"""Gaps between the ends of shut tongs, and of tongs that were opened again [m]."""

HAMMER: Final = Task(
    "hammer",
    title="Hammer",
    instruction="Take the hammer, drive the nail in, and keep the hammer in the hand.",
    rubric=(
        RubricLine("done", 1.0, "nail driven in by 40 mm, then the hammer held for half a second"),
        RubricLine("partly", 0.5, "nail driven in by at least 15 mm"),
        *COMMON_ENDS,
    ),
)

TONGS: Final = Task(
    "tongs",
    title="Tongs",
    instruction="Lift the tongs by 10 cm, and shut and open them three times.",
    rubric=(
        RubricLine("done", 1.0, "10 cm up, shut and opened three times, and still held"),
        RubricLine("partly", 0.5, "10 cm up, and shut once"),
        *COMMON_ENDS,
    ),
)


def _unfinished(partly: bool, gone: bool, progress: str) -> Assessment:
    reason = f"{progress}, then the tool fell" if gone else progress
    if partly:
        return Assessment(0.5, "partly", reason, dropped=gone)
    return Assessment(0.0, "dropped" if gone else NOT_DONE, reason, dropped=gone)


@dataclass(frozen=True, eq=False)
class HammerScorer:
    """Scores the task ``hammer``.

    Attributes:
        scene: the scene of the trial.
        depth: depth of the nail [m].
        held: time since which the hand alone has held the hammer with the nail in [s].
        gone: True once the hammer has left the workspace.
        done: True once it was held for ``HOLD_S`` with the nail in.
    """

    scene: HammerScene
    depth: float = 0.0
    held: float | None = None
    gone: bool = False
    done: bool = False

    @property
    def assessment(self) -> Assessment:
        """Score of the trial if it ended now."""
        if self.done:
            return Assessment(1.0, "done", "nail in, hammer held", complete=True)
        partly = self.depth >= DRIVEN[0] * self.scene.scale
        return _unfinished(partly, self.gone, f"nail in by {1e3 * self.depth:.0f} mm")

    def observe(self, state: SceneState) -> Self:
        """Returns the scorer, updated with a later state of the scene."""
        holds = held_by_hand(state) and state.mechanism >= DRIVEN[1] * self.scene.scale
        held = held_since(self.held, holds, state.time)
        return replace(
            self,
            depth=state.mechanism,
            held=held,
            gone=self.gone or outside(self.scene, state),
            done=self.done or lasted(held, state.time),
        )


@dataclass(frozen=True, eq=False)
class TongsScorer:
    """Scores the task ``tongs``.

    Attributes:
        scene: the scene of the trial.
        shut: number of times that the lifted tongs were shut.
        opened: number of times that they were opened after that.
        gone: True once they have left the workspace.
    """

    scene: TongsScene
    shut: int = 0
    opened: int = 0
    gone: bool = False

    @property
    def assessment(self) -> Assessment:
        """Score of the trial if it ended now."""
        if self.opened >= SQUEEZES:
            return Assessment(1.0, "done", "shut and opened three times", complete=True)
        return _unfinished(self.shut > 0, self.gone, f"shut {self.shut} times in the air")

    def observe(self, state: SceneState) -> Self:
        """Returns the scorer, updated with a later state of the scene."""
        lifted = held_by_hand(state) and float(state.position[2]) >= self.scene.target[2]
        gap = self.scene.gap(state.mechanism) / self.scene.scale
        shuts = lifted and self.shut == self.opened and gap <= SHUT_BELOW
        opens = lifted and self.shut > self.opened and gap >= OPEN_ABOVE
        return replace(
            self,
            shut=self.shut + shuts,
            opened=self.opened + opens,
            gone=self.gone or outside(self.scene, state),
        )
