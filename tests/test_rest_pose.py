"""``smooth`` is exact where it can be: the cost of fingertip positions."""

import jax.numpy as jnp
import numpy as np
from trees import float64

from smooth_operator import Retargeter, load_hand
from smooth_operator.retargeting.objective import FrameGoal
from smooth_operator.retargeting.smooth import SMOOTH_PRECISE, SmoothConfig
from smooth_operator.retargeting.smooth_terms import (
    FingertipPositionConfig,
    FingertipTracking,
)
from smooth_operator.retargeting.targets import KeyvectorLayout
from smooth_operator_research.physics.reachable_motion import reachable_motion


def test_the_cost_of_positions_is_stiff_near_and_bounded_far():
    hand = load_hand("mimic_p050")
    config = FingertipPositionConfig(weight=40.0, width=0.004)
    layout = KeyvectorLayout(hand.fingers)
    term = FingertipTracking(layout, config)
    with float64():
        tips = hand.tips(hand.full_configuration(hand.neutral))
        points = jnp.asarray(np.vstack([hand.wrist, tips]))
        exact = layout.among(points)
        no_joints, no_motion = jnp.zeros((len(points), 0, 3)), jnp.zeros(len(tips))

        def cost(error: float) -> tuple[float, np.ndarray]:
            goal = FrameGoal(
                exact.at[1, 0].add(-error), jnp.zeros(15), jnp.zeros(16), 0.0, tips, no_motion
            )
            found = term.expand(points, no_joints, goal)
            return float(found.cost), np.asarray(found.gradient)

        assert cost(0.0)[0] == 0.0
        small, large = cost(1e-4), cost(0.05)
        np.testing.assert_allclose(small[0], 0.5 * 40 / 0.02 * 1e-8, rtol=1e-2)
        assert large[0] < 0.5 * 40 / 0.02 * 0.004**2  # never more, however far
        assert abs(large[1]).max() < 0.05 * abs(cost(0.0023)[1]).max()
        for error in (1e-3, 5e-3):  # the gradient is that of the cost
            slope = (cost(error + 1e-7)[0] - cost(error - 1e-7)[0]) / 2e-7
            np.testing.assert_allclose(cost(error)[1][2, 0], slope, rtol=1e-5)


def reaching_error(config: SmoothConfig) -> float:
    """The robot's own landmarks play the human, for 3 s: mean distance of the fingertips [m]."""
    hand = load_hand("mimic_p050")
    motion = reachable_motion(hand, 77, duration=3.0)
    commands, _ = Retargeter(hand, config=config).run(motion.recording)
    off = np.linalg.norm(hand.tips(commands.joint_positions) - motion.tips, axis=-1)
    return float(off[100:].mean())


def test_what_the_hand_can_reach_is_reached():
    """Of ``precise``, whose targets are the human's fingertips; the default's differ from them by
    what a thumb's bones differ from their mean."""
    assert reaching_error(SMOOTH_PRECISE) < 0.7e-3
