"""Opens the browser page of a trace."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import mujoco
import numpy as np

from smooth_operator.hands.hand import Hand
from smooth_operator.landmarks import FINGERS, TIPS
from smooth_operator.metrics import Trace
from smooth_operator.teleop.pages import Playback


def playback(
    title: str,
    hand: Hand,
    trace: Trace,
    metrics: Mapping[str, Any],
    drawn: Hand | None = None,
    label: str = "robot",
) -> Playback:
    """What the page plays.

    Args:
        title: above the page.
        hand: the robot hand.
        trace: the run, in the palm frame.
        metrics: for the page's table.
        drawn: the same hand on the model to draw, with the same joints by name, in any order; see
            ``on_model``. The hand itself if left out.
        label: what stands above the robot.
    """
    drawn = drawn or hand
    model = drawn.model
    poses = np.tile(drawn.full_configuration(drawn.neutral), (len(trace), 1))
    poses[:, [drawn.joint_names.index(name) for name in hand.joint_names]] = trace.joint_positions
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    palm = data.body(drawn.spec.palm)  # it does not move: fingers hang from it
    rotation, origin = palm.xmat.reshape(3, 3), palm.xpos.copy()
    return Playback(
        title=title,
        model=model,
        qpos=drawn.qpos(poses),
        stamps=trace.stamps,
        human=trace.human @ rotation.T + origin,
        status=trace.status,
        robot_tips=trace.robot_tips @ rotation.T + origin,
        robot_wrist=rotation @ trace.robot_wrist + origin,
        latency_ms=trace.latency_ms,
        human_tips=tuple(TIPS[FINGERS.index(name)] for name in trace.fingers),
        fingers=trace.fingers,
        metrics=metrics,
        bodies=drawn.bodies,
        label=label,
    )
