"""Chooses the model with which a page draws a robot hand."""

from __future__ import annotations

from smooth_operator.cli.common_options import Meshes
from smooth_operator.errors import HandModelError
from smooth_operator.hand_files.vendor_model import hand_with_meshes
from smooth_operator.hands.hand import Hand
from smooth_operator.terminal import print_note


def hand_to_draw(hand: Hand, options: Meshes) -> Hand | None:
    """Returns the hand's model with its meshes, or None if simple shapes should be drawn.

    If meshes that the user did not ask for can't be read, a note says so and simple shapes are
    drawn.

    Raises:
        HandModelError: the model that the user named can't be used.
        MissingExtraError: its package is not installed.
    """
    if options.no_meshes:
        return None
    try:
        return hand_with_meshes(hand, options.model)
    except HandModelError as error:
        if options.model is not None:
            raise
        print_note(f"the meshes can't be drawn, so simple shapes are shown: {error}")
        return None
