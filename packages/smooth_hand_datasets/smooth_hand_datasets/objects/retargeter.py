"""Retargets whole recordings together with the objects that the hand touches.

All frames are solved jointly, as in ``TrajectoryRetargeter``, with the costs of
``smooth_hand_datasets.objects.terms`` added. The robot's palm is placed at the human's; the wrist
may move away from it within bounds, so that fingers of another length reach what the human touches.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Final, NamedTuple

import numpy as np
from jaxtyping import Float

from smooth_hand_datasets.objects.contacts import (
    Contacts,
    ContactSettings,
    clip_scene,
    find_contacts,
)
from smooth_hand_datasets.objects.interaction_metrics import interaction_figures, interaction_tracks
from smooth_hand_datasets.objects.placement import palm_in_world, wrist_in_palm
from smooth_hand_datasets.objects.signed_distance import Shape, Solid
from smooth_hand_datasets.objects.terms import (
    UNITS,
    ObjectCosts,
    ObjectFrame,
    ObjectSettings,
    object_frames,
)
from smooth_hand_datasets.pipeline.retargeting import whole_config
from smooth_operator import poses
from smooth_operator.errors import RecordingError
from smooth_operator.formats.clip import Clip
from smooth_operator.hands.hand import Hand, fingerprint
from smooth_operator.planning import Plan
from smooth_operator.retargeting.preset_files import method_config
from smooth_operator.retargeting.program_store import ProgramStore
from smooth_operator.retargeting.trajectory import TrajectoryMethodConfig
from smooth_operator.retargeting.trajectory_retargeter import TrajectoryRetargeter
from smooth_operator.retargeting.trajectory_solver import FrameBlocks
from smooth_operator.types import CommandTrajectory, Side

ITERATIONS: Final = 80
"""Largest number of Newton steps; contacts make the cost more nonlinear than landmarks do."""

_KEPT: Final = 4
_RETARGETERS: OrderedDict[tuple[str, TrajectoryMethodConfig, int], ObjectAwareRetargeter] = (
    OrderedDict()
)


class ObjectAware(NamedTuple):
    """Retargeted motion of a robot hand in a clip with objects.

    Attributes:
        commands: a command for each frame.
        loss: (T,) the method's tracking loss, NaN without a usable hand.
        figures: metrics of contacts and penetration by name (``interaction_figures``), compared
            with the human's contacts.
        tracks: the same metrics frame by frame (``interaction_tracks``).
        T_world_palm: (T, 7) pose of the robot's palm, NaN where unknown.
        T_world_wrist: (T, 7) pose of its wrist, with the same axes as every wrist.
        correction: (T, 6) correction of the wrist: translation [m] and rotation vector [rad] in
            the palm frame.
        contacts: the human's contacts.
    """

    commands: CommandTrajectory
    loss: Float[np.ndarray, " T"]
    figures: Mapping[str, float]
    tracks: Mapping[str, Float[np.ndarray, " T"]]
    T_world_palm: Float[np.ndarray, "T 7"]
    T_world_wrist: Float[np.ndarray, "T 7"]
    correction: Float[np.ndarray, "T 6"]
    contacts: Contacts


@dataclass(eq=False)
class _Terms:
    """The costs of one clip, as ``smooth_trajectory`` takes them; see ``ExtraTerms``."""

    costs_of: ObjectCosts
    shapes: tuple[Shape, ...]
    frames: ObjectFrame
    start: Float[np.ndarray, "T 6"]
    limits: Float[np.ndarray, "6 2"] = field(init=False)

    def __post_init__(self) -> None:
        self.limits = self.costs_of.limits
        self.found = self.start

    def costs(self, x: Float[np.ndarray, "t v"], part: slice) -> FrameBlocks:
        """Costs, gradients and Hessians of the frames of a part."""
        frames = ObjectFrame(*(values[part] for values in self.frames))
        return self.costs_of.all_costs(self.shapes, x, frames)

    def settle(self, pose: Float[np.ndarray, "T 6"]) -> None:
        self.found = pose


class ObjectAwareRetargeter:
    """Retargets clips with objects onto one robot hand.

    Args:
        hand: the robot hand.
        config: a configuration for whole recordings; None for ``smooth:offline``.
        settings: weights and bounds; None for the defaults.
        contacts: thresholds of human contacts; None for the defaults.
        seed: seed of the method's random numbers.

    Raises:
        ConfigError: the method can't be solved for a whole recording.
        HandModelError: a fingertip of the hand has no solid part.
    """

    def __init__(
        self,
        hand: Hand,
        config: TrajectoryMethodConfig | None = None,
        settings: ObjectSettings | None = None,
        contacts: ContactSettings | None = None,
        seed: int = 0,
    ) -> None:
        chosen = whole_config(method_config("smooth", "offline")) if config is None else config
        steps = max(chosen.future.iterations, ITERATIONS)
        chosen = replace(chosen, future=replace(chosen.future, iterations=steps))
        self.hand, self.config = hand, chosen
        self.contact_settings = ContactSettings() if contacts is None else contacts
        self.blind = TrajectoryRetargeter(hand, chosen, seed, cache=ProgramStore.of_user())
        self.costs = ObjectCosts(hand, ObjectSettings() if settings is None else settings)

    def run(self, clip: Clip, side: Side, solids: Mapping[str, Solid] | None = None) -> ObjectAware:
        """Retargets one hand of a clip.

        Args:
            clip: clip with wrist poses and objects.
            side: side of the hand.
            solids: shapes of objects by name, used in place of their meshes.

        Raises:
            RecordingError: the clip lacks the hand, its wrist, or an object with a shape.
        """
        if side not in clip.hands:
            raise RecordingError(f"{clip.name}: there is no {side} hand, only {list(clip.hands)}")
        recording, scene = clip.hands[side], clip_scene(clip, dict(solids or {}))
        contacts = find_contacts(clip, side, scene, self.contact_settings)
        palm = palm_in_world(recording, self.hand, self.config.alignment)
        settings = self.costs.settings
        terms = _Terms(
            self.costs,
            tuple(solid.shape for solid in scene.solids),
            object_frames(self.hand, palm, scene, contacts, clip.stamps, settings),
            np.zeros((len(clip), 6)),
        )
        commands, loss = self.blind.run(recording, extra=terms)
        correction = terms.found * UNITS
        moved = self.corrected(palm, correction)
        tracks = interaction_tracks(
            self.costs.surface, commands.joint_positions, moved, scene, contacts
        )
        figures = interaction_figures(tracks) | {
            "wrist_shift_max_mm": 1e3 * float(np.linalg.norm(correction[:, :3], axis=1).max()),
            "wrist_turn_max_deg": float(
                np.degrees(np.linalg.norm(correction[:, 3:], axis=1).max())
            ),
        }
        wrist = poses.compose(moved, wrist_in_palm(self.hand))
        return ObjectAware(commands, loss, figures, tracks, moved, wrist, correction, contacts)

    def corrected(
        self, palm: Float[np.ndarray, "T 7"], correction: Float[np.ndarray, "T 6"]
    ) -> Float[np.ndarray, "T 7"]:
        """``T_world_palm`` after the wrist's correction, which rotates about the palm's centre."""
        centre = self.hand.align_points.mean(axis=0)
        turn = poses.from_rotation_vectors(correction[:, 3:])
        place = correction[:, :3] + centre - poses.rotate(turn, np.broadcast_to(centre, (1, 3)))
        return poses.compose(palm, np.concatenate([place, turn], axis=-1))


def object_aware(clip: Clip, side: Side, plan: Plan) -> ObjectAware:
    """Retargets one hand of a clip with objects, as a plan specifies.

    Args:
        clip: clip with wrist poses and objects.
        side: side of the hand.
        plan: robot hand, method and preset, which must be for whole recordings.

    Raises:
        ConfigError: the preset solves frame by frame.
        RecordingError: the clip lacks wrist poses, or objects with a shape.
    """
    return _retargeter(plan.hand, whole_config(plan.config), plan.seed).run(clip, side)


def _retargeter(hand: Hand, config: TrajectoryMethodConfig, seed: int) -> ObjectAwareRetargeter:
    """Creates a retargeter; cached, so that programs are compiled once per hand and
    configuration."""
    key = (fingerprint(hand), config, seed)
    retargeter = _RETARGETERS.pop(key, None)
    if retargeter is None:
        retargeter = ObjectAwareRetargeter(hand, config, seed=seed)
    _RETARGETERS[key] = retargeter
    while len(_RETARGETERS) > _KEPT:
        _RETARGETERS.popitem(last=False)
    return retargeter
