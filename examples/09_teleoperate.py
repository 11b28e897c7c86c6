"""A live run in one call: tracker, method, limits, simulated robot, and an MCAP log of all of it.

On a real robot the source is a tracker (``webcam``, ``webxr``, ``manus``) and a sink your driver.
``smooth-operator teleop`` is the same with a page in the browser.
"""

from smooth_operator.teleop import (
    LimitsConfig,
    TeleopLoop,
    TeleopRequest,
    Tick,
    read_log,
    teleoperate,
)


def pause_for_a_moment(loop: TeleopLoop) -> None:
    """A foot pedal could do this: the controls may be used from any thread."""
    controls, commands = loop.controls, 0
    presses = {100: controls.pause, 150: controls.resume, 300: controls.quit}

    def watch(tick: Tick) -> None:
        nonlocal commands
        if commands or tick.status is not None:  # counted from the first frame that was answered
            commands += 1
            if commands in presses:
                presses[commands]()

    loop.watch = watch


request = TeleopRequest(
    source="synthetic",
    sink=("mujoco", "record:take.mcap"),
    hand="mimic_p050",
    rate=100.0,
    limits=LimitsConfig(velocity=8.0, acceleration=400.0),
)
summary = teleoperate(request, started=pause_for_a_moment)
print(f"{summary['frames_answered']} frames answered, {summary['rate_hz']:.0f} commands a second")

# The log has what the tracker saw, what the robot was commanded, and what happened when.
log = read_log("take.mcap")
print(log.recording)
print(log.commands)
events = [event for happened in log.loop.events.values() for event in happened]
print(", ".join(events))
assert any("-> paused" in event for event in events)
