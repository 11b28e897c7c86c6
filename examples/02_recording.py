"""A recording: read a file of landmarks, retarget it, write the commands and read them again."""

import numpy as np

from smooth_operator import (
    Retargeter,
    SyntheticOperator,
    read_commands,
    read_recording,
    write_commands,
)

# Any .npz with landmarks (T, 21, 3) [m] and timestamps (T,) [s] is a recording. Also read are MANUS
# files, .npy, MCAP logs, HDF5 and, through `smooth-operator convert`, LeRobot datasets and videos.
source = SyntheticOperator(seed=2, rate_hz=60).record(duration=5.0)
np.savez("hand.npz", landmarks=source.landmarks, timestamps=source.stamps, side="right")

recording = read_recording("hand.npz")
print(recording)

retargeter = Retargeter("mimic_p050", side=recording.side, method="smooth")
commands, loss = retargeter.run(recording)
print(commands)
print(f"mean loss of the keyvectors {loss.mean():.2e}")

write_commands("out.npz", commands, {"hand": "mimic_p050", "method": "smooth"})
again = read_commands("out.npz")
assert np.array_equal(again.joint_positions, commands.joint_positions)

# Slices are recordings, items are frames.
assert len(recording[:60]) == 60
assert recording[0].stamp == recording.stamps[0]
