"""A loop of your own: explicit state, a fixed rate, a velocity limit, and a policy for lost frames.

``smooth_operator.teleop.TeleopLoop`` does all this and more. Take this where retargeting is a
part of another program, such as a controller or a simulation, that has its own clock.
"""

import numpy as np

from smooth_operator import HandFrame, Retargeter, Status, SyntheticOperator

RATE_HZ = 50.0
MAX_SPEED = 4.0  # rad/s
HOLD_FRAMES = 10  # so many bad frames are held, then the hand goes to its neutral pose

retargeter = Retargeter("mimic_p050", method="smooth")
retargeter.warm_up()  # compiles, so that the first frame is not late
hand = retargeter.hand
state = retargeter.init(seed=0)
neutral = hand.full_configuration(hand.neutral)
command, lost, held = neutral, 0, 0
fastest = 0.0

frames = SyntheticOperator(seed=6, rate_hz=RATE_HZ).frames(duration=4.0)
for number, frame in enumerate(frames):
    if 80 <= number < 110:  # the tracker loses the hand
        frame = HandFrame(np.full((21, 3), np.nan), frame.time, frame.side)

    # A step changes nothing but the state that it returns: keep the old one to go back.
    state, result = retargeter.step(state, frame)
    if result.status is Status.OK:
        lost, wanted = 0, result.command.joint_positions
    else:
        lost += 1
        held += lost <= HOLD_FRAMES
        wanted = command if lost <= HOLD_FRAMES else neutral

    step = np.clip(wanted - command, -MAX_SPEED / RATE_HZ, MAX_SPEED / RATE_HZ)
    command = np.clip(command + step, *hand.joint_limits.T)
    fastest = max(fastest, np.abs(step).max() * RATE_HZ)
    # Here the command would go to the robot, and the loop would sleep until the next frame.

print(f"{number + 1} commands, {held} held, fastest joint {fastest:.2f} rad/s")
assert held == HOLD_FRAMES
assert fastest <= MAX_SPEED * 1.001

# A run can be repeated to the bit: all that a retargeter remembers is in its state.
_, first = retargeter.step(retargeter.init(seed=0), frame)
_, second = retargeter.step(retargeter.init(seed=0), frame)
assert np.array_equal(first.command.joint_positions, second.command.joint_positions)
