"""A trace as a page in the browser, and the model that a robot hand is drawn on."""

from __future__ import annotations

from typing import TYPE_CHECKING

import mujoco
import numpy as np
from jaxtyping import Float

from smooth_operator.cli.common_options import Meshes
from smooth_operator.errors import HandModelError
from smooth_operator.hand_files.vendor_model import hand_with_meshes, has_meshes
from smooth_operator.hands.hand import Hand
from smooth_operator.landmarks import FINGERS, TIPS
from smooth_operator.metrics import Trace
from smooth_operator.terminal import print_note

if TYPE_CHECKING:
    from smooth_operator.teleop.pages.playback import Playback


def hand_to_draw(hand: Hand, options: Meshes) -> Hand | None:
    """The hand on a model with its meshes; None where simple shapes are to be drawn.

    Meshes that nobody named and that can't be read are no reason to stop: a line says so.

    Raises:
        HandModelError: the model that was named can't be used.
        MissingExtraError: its package is not installed.
    """
    if options.no_meshes:
        return None
    try:
        return hand_with_meshes(hand, options.model)
    except HandModelError as error:
        if options.model is not None:
            raise
        print_note(f"simple shapes are drawn: {error}")
        return None


def playback(
    title: str,
    hand: Hand,
    trace: Trace,
    drawn: Hand | None = None,
    label: str = "robot",
) -> Playback:
    """A run as the page plays it.

    Args:
        title: title of the page.
        hand: the robot hand.
        trace: the run, in the palm frame.
        drawn: the same hand on the model to draw, with the same joints by name, in any order; see
            ``on_model``. Simple shapes if left out; with it, they are there for a switch.
        label: text above the robot.
    """
    from smooth_operator.teleop.pages.hand_view import simple_meshes
    from smooth_operator.teleop.pages.playback import Playback, SimpleShapes

    simple = None
    model = drawn or hand
    rotation, origin = _palm(model)
    if drawn is not None or has_meshes(hand):
        own, at = _palm(hand)
        turn, wxyz = rotation @ own.T, np.empty(4)
        mujoco.mju_mat2Quat(wxyz, turn.ravel())
        poses = hand.qpos(trace.joint_positions)
        simple = SimpleShapes(hand.model, poses, simple_meshes(hand), wxyz, origin - turn @ at)
    poses = np.tile(model.full_configuration(model.neutral), (len(trace), 1))
    poses[:, [model.joint_names.index(name) for name in hand.joint_names]] = trace.joint_positions
    return Playback(
        title=title,
        model=model.model,
        qpos=model.qpos(poses),
        stamps=trace.stamps,
        human=trace.human @ rotation.T + origin,
        status=trace.status,
        robot_tips=trace.robot_tips @ rotation.T + origin,
        robot_wrist=rotation @ trace.robot_wrist + origin,
        latency_ms=trace.latency_ms,
        human_tips=tuple(TIPS[FINGERS.index(name)] for name in trace.fingers),
        fingers=trace.fingers,
        bodies=model.bodies,
        label=label,
        simple=simple,
        show_meshes=drawn is not None,
    )


def _palm(hand: Hand) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "3"]]:
    """Rotation and origin of the palm in its model's world, where fingers hang from it."""
    data = mujoco.MjData(hand.model)
    mujoco.mj_kinematics(hand.model, data)
    palm = data.body(hand.spec.palm)
    return palm.xmat.reshape(3, 3).copy(), palm.xpos.copy()
