"""The built-in operator that a command's options ask for."""

from __future__ import annotations

from smooth_operator.cli.common_options import Synthetic
from smooth_operator.synthetic import SyntheticOperator, TrackerModel
from smooth_operator.types import Side


def synthetic_operator(options: Synthetic, seed: int, side: Side = "right") -> SyntheticOperator:
    """The operator with the side, rate and tracker of the options.

    Args:
        options: the command's options.
        seed: random seed of its movements and its tracker's errors.
        side: where the options name none.

    Raises:
        ConfigError: a setting is outside its range.
    """
    return SyntheticOperator(
        seed=seed,
        side=options.side or side,
        rate_hz=options.rate,
        tracker=TrackerModel(
            noise=options.noise * 1e-3,
            frame_loss=options.frame_loss,
            landmark_loss=options.landmark_loss,
            seed=seed,
        ),
    )
