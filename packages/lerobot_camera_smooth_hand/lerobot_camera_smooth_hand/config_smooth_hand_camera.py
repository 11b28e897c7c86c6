"""Settings of the simulated camera, as LeRobot's command line shows them."""

from dataclasses import dataclass

from lerobot.cameras import CameraConfig


# LeRobot finds the class by the name without "Config", in this package.
@CameraConfig.register_subclass("smooth_hand")
@dataclass(kw_only=True)
class SmoothHandCameraConfig(CameraConfig):
    """Settings of a camera that shows the hand in the sink ``mujoco``.

    Attributes:
        fps: maximum number of pictures per second [Hz].
        width: width of a picture [px].
        height: height of a picture [px].
        side: side of the hand to show, ``right`` or ``left``; None for the robot's hand, or its
            right hand if it has two.
        azimuth: azimuth of the view in MuJoCo's convention [degrees]; None for a view of the
            hand's task, or of its palm if there is no task.
        elevation: elevation of the view [degrees]; None as for ``azimuth``.
        distance: distance from the camera to the point it looks at [m]; None as for ``azimuth``.
        stale_s: largest age of a picture in an observation [s]. If the newest picture is older,
            the observation waits up to 5 s for the next one, and then raises an error.
    """

    fps: int | None = 30
    width: int | None = 320
    height: int | None = 240
    side: str | None = None
    azimuth: float | None = None
    elevation: float | None = None
    distance: float | None = None
    stale_s: float = 1.0
