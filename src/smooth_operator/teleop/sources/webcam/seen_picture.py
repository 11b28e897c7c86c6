"""A camera's picture with the hands that a tracker found in it, for people to look at."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from jaxtyping import Float, UInt8
from numpy import ndarray

from smooth_operator.errors import SourceError
from smooth_operator.teleop.sources.webcam.camera import opencv
from smooth_operator.types import Side

_QUALITY: Final = 70  # of JPEG, 0 to 100


@dataclass(frozen=True, eq=False)
class SeenPicture:
    """The newest picture of a camera or a video.

    Attributes:
        number: of the picture, which goes up with each.
        pixels: red, green, blue; as the tracker looked at it, so not mirrored.
        hands: side -> (21, 2) landmarks, to the right and down from the upper left corner, as
            shares of the width; empty if no hand was found.
    """

    number: int
    pixels: UInt8[ndarray, "h w 3"]
    hands: Mapping[Side, Float[ndarray, "21 2"]]

    def jpeg(self, width: int) -> bytes:
        """The picture as a JPEG file, made smaller where it is wider than so many pixels.

        Raises:
            SourceError: OpenCV can't write it.
        """
        cv2 = opencv()
        height, own = self.pixels.shape[:2]
        pixels = self.pixels
        if own > width:
            size = width, max(1, round(height * width / own))
            pixels = cv2.resize(pixels, size, interpolation=cv2.INTER_AREA)
        there, data = cv2.imencode(
            ".jpg", cv2.cvtColor(pixels, cv2.COLOR_RGB2BGR), (cv2.IMWRITE_JPEG_QUALITY, _QUALITY)
        )
        if not there:
            raise SourceError("OpenCV can't write a picture as JPEG")
        encoded: bytes = data.tobytes()
        return encoded
