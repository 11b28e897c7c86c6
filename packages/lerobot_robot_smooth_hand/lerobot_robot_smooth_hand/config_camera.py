"""Settings of the simulated camera, as LeRobot's command line shows them."""

from dataclasses import dataclass

from lerobot.cameras import CameraConfig


# LeRobot finds the class by the name without "Config", in this package.
@CameraConfig.register_subclass("smooth_hand")
@dataclass(kw_only=True)
class SmoothHandCameraConfig(CameraConfig):
    """Settings of a camera that looks at the hand in the sink ``mujoco``.

    Attributes:
        fps: pictures a second, at most [Hz].
        width: width of a picture [px].
        height: height of a picture [px].
        side: ``right`` or ``left``; None for the robot's, of both hands the right one.
        azimuth: azimuth of the view in MuJoCo's convention [degrees]; None for one that shows
            the hand's task, or its palm where there is none.
        elevation: likewise [degrees].
        distance: to what is looked at [m]; None likewise.
        stale_s: largest age of a picture in an observation [s]. While the newest is older, an
            observation waits for the next one, for up to 5 s; then it is an error.
    """

    fps: int | None = 30
    width: int | None = 320
    height: int | None = 240
    side: str | None = None
    azimuth: float | None = None
    elevation: float | None = None
    distance: float | None = None
    stale_s: float = 1.0
