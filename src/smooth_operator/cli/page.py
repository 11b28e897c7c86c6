"""The model that a robot hand is drawn on."""

from __future__ import annotations

from smooth_operator.cli.common_options import Meshes
from smooth_operator.errors import HandModelError
from smooth_operator.hand_files.vendor_model import hand_with_meshes
from smooth_operator.hands.hand import Hand
from smooth_operator.terminal import print_note


def hand_to_draw(hand: Hand, options: Meshes) -> Hand | None:
    """The hand on a model with its meshes; None where simple shapes are to be drawn.

    Meshes that nobody named and that can't be read are no reason to stop: a line says so.

    Raises:
        HandModelError: the model that was named can't be used.
        MissingExtraError: its package is not installed.
    """
    if options.no_meshes:
        return None
    try:
        return hand_with_meshes(hand, options.model)
    except HandModelError as error:
        if options.model is not None:
            raise
        print_note(f"simple shapes are drawn: {error}")
        return None
