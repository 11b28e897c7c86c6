"""One frame: 21 landmarks of a human hand in, joint positions of a robot hand out."""

import numpy as np

from smooth_operator import HandFrame, Retargeter, Status, SyntheticOperator

# A tracker gives (21, 3) landmarks [m] in any right-handed frame. Here a built-in operator does.
frame = SyntheticOperator(seed=1).record(duration=1.0)[50]

retargeter = Retargeter("mimic_p050", side="right", method="smooth")
result = retargeter(frame)  # the first call compiles; a bare (21, 3) array works as well

assert result.status is Status.OK, result.status.reason
for name, position in zip(result.command.joint_names, result.command.joint_positions, strict=True):
    print(f"{name:24} {position:+.3f} rad")
print(result)

# A frame that is no use never moves the hand: the last good command comes with a status.
lost = retargeter(HandFrame(np.full((21, 3), np.nan), stamp=frame.time + 0.01))
assert lost.status is Status.INVALID_LANDMARKS
assert np.array_equal(lost.command.joint_positions, result.command.joint_positions)
print(lost.status.reason)
