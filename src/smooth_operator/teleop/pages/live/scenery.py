"""Scenery of a task for the page: shapes once, then the pose of the object."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, replace
from typing import Any

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import SinkError
from smooth_operator.simulation.arms.rigid import Matrix, inverse, pose_of, rigid
from smooth_operator.simulation.live import LiveSimulation
from smooth_operator.simulation.scenes import Scene, ScenePart, SceneState
from smooth_operator.simulation.scenes.mount import Mount
from smooth_operator.types import Side


class Scenery:
    """Looks at a simulation, as JSON has it; poses are in the palm frame, where pages draw hands.

    Args:
        simulation: with a task or without, which may change.
    """

    def __init__(self, simulation: LiveSimulation) -> None:
        self._simulation = simulation

    def look(self, sides: Sequence[Side], known: int) -> dict[str, Any]:
        """What to draw.

        Args:
            sides: the hands.
            known: the number of the scenes whose shapes the page has.

        Returns:
            ``number`` of the scenes; ``poses``: side -> position [m] and quaternion (w x y z) of
            the object; ``away``: sides where there is none now; ``fixtures``: side -> that of the
            frame that they are in, in the base of an arm that carries the hand; ``parts``: side ->
            shapes, if others than the known ones are
            there, and ``views``: side -> rows right, up, toward of who looks at the scene.
        """
        simulation, number = self._simulation, self._simulation.world_number
        shown: dict[str, Any] = {"number": number, "poses": {}, "away": [], "fixtures": {}}
        try:
            mounts = {side: simulation.scene_of(side).mount for side in sides}
            for side, mount in mounts.items():
                state = simulation.scene_state(side)
                if state is not None:
                    shown["poses"][side] = _pose(mount, state)
                    if state.away:
                        shown["away"].append(side)
                if (base := simulation.arm_base(side)) is not None:
                    shown["fixtures"][side] = _fixture(mount, base)
            if number != known:
                shown["parts"] = {
                    side: [_part(mount, part) for part in simulation.parts_of(side)]
                    for side, mount in mounts.items()
                }
                shown["views"] = {side: _view(simulation.scene_of(side), side) for side in sides}
        except SinkError:  # no task, or the scene is just being changed
            shown["poses"] = {}
            if number != known:
                shown["parts"], shown["views"] = {}, {}
        return shown


def _pose(mount: Mount, state: SceneState) -> list[float]:
    return _numbers(*mount.in_palm(state.position, state.quaternion))


def _fixture(mount: Mount, base: Matrix) -> list[float]:
    position, turn = mount.palm
    return _numbers(pose_of(inverse(base) @ rigid(turn, position)))


def _part(mount: Mount, part: ScenePart) -> dict[str, Any]:
    if not part.moves:
        at, turn = mount.in_palm(part.position, part.quaternion)
        part = replace(part, position=at, quaternion=turn)
    plain = asdict(part)
    return {**plain, "position": _numbers(part.position), "quaternion": _numbers(part.quaternion)}


def _view(scene: Scene, side: Side) -> list[list[float]]:
    """(3, 3) rows right, up and toward the viewer, in the palm frame."""
    azimuth, elevation = np.radians(scene.view)
    azimuth = azimuth if side == "right" else -azimuth
    ahead = np.array(
        [
            np.cos(azimuth) * np.cos(elevation),
            np.sin(azimuth) * np.cos(elevation),
            np.sin(elevation),
        ]
    )
    right = np.cross(ahead, (0.0, 0.0, 1.0))
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(right, ahead), -ahead])  # in the world
    _, turn = scene.mount.palm
    return [_numbers(row) for row in axes @ turn]


def _numbers(*arrays: Float[np.ndarray, " k"]) -> list[float]:
    return [round(float(value), 5) for array in arrays for value in array]
