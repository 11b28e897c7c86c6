"""``smooth-operator train``: trains a learning-based method on a recording."""

from __future__ import annotations

import contextlib
import shlex
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar, Final, Literal

from tyro.conf import Positional, arg

from smooth_operator.cli.common_options import Common, HandSide, Ordered, Quiet
from smooth_operator.errors import ConfigError

if TYPE_CHECKING:
    from smooth_operator.baselines.geort.training import TrainingState
    from smooth_operator.cli.console import Progressing
    from smooth_operator.types import HandRecording


@dataclass(frozen=True, kw_only=True)
class Train(Ordered, Common, Quiet):
    """Train a learning-based method (geort) for a robot hand."""

    work: ClassVar[str] = "smooth_operator.cli.train:train"
    details: ClassVar[str] = """Needs the training extra. Writes to DIR: model.npz (the model),
model.json (how it was trained), losses.csv and checkpoint.npz. Ctrl-C keeps all of them; the same
command with --resume continues and gives the same bytes as an uninterrupted training.

In a good recording, the hand opens, closes, spreads and pinches for at least a minute.

Examples:
  smooth-operator train geort glove.npz --hand mimic_p050 --output my-geort
  smooth-operator train geort glove.npz --hand mimic_p050 --output my-geort --resume
  smooth-operator train geort synthetic --hand mimic_p050 --output geort-synthetic
"""

    method: Annotated[Positional[Literal["geort"]], arg(metavar="geort")]
    """The method to train."""

    recordings: Annotated[Positional[tuple[str, ...]], arg(metavar="RECORDING...")]
    """MANUS .npz, (T, 21, 3) landmarks [m] as .npy or .npz, or this program's .mcap log. Several
    recordings must be of the same side. The word synthetic stands for recordings of twelve
    synthetic hands (for a file of that name, write ./synthetic)."""

    output: Annotated[Path, arg(metavar="DIR")]
    """Folder to write; created if missing."""

    hand: Annotated[str, arg(metavar="NAME")] = "mimic_p050"
    """Name of the robot hand; smooth-operator hands list prints the names."""

    side: Annotated[HandSide | None, arg(metavar="right|left")] = None
    """Hand side. Default: the side of the recording."""

    epochs: int = 120
    """Number of epochs (passes over the recorded points)."""

    seed: int = 0
    """Seed of all random numbers: the same seed and frames give the same model."""

    frames: Annotated[str | None, arg(metavar="A:B")] = None
    """Only these frames of each recording, as a Python slice: :500, 2600:3100, -500:"""

    rate: Annotated[float | None, arg(metavar="HZ")] = None
    """Frame rate of recordings without timestamps [Hz]."""

    coverage: Literal["operator", "reach"] = "operator"
    """Motion that the robot should cover: the operator's motion or, as published, the robot's whole
    workspace. For the whole workspace, the recording must show how far the operator's fingers
    reach."""

    checkpoint_every: Annotated[int, arg(metavar="EPOCHS")] = 10
    """Number of epochs between checkpoints."""

    resume: bool = False
    """Continue a training in DIR that was started with the same recording and options."""

    def extras(self) -> dict[str, tuple[str, ...]]:
        """The extra that the optimiser of the network needs."""
        return {"training": ("optax",)}


SYNTHETIC: Final = "synthetic"


def train(options: Train) -> None:
    """Reads the recordings, trains and writes the model."""
    from smooth_operator.baselines.geort.training import LOSSES, GeortTrainer, TrainingSession
    from smooth_operator.baselines.geort.training_data import GeortTraining, training_data
    from smooth_operator.cli.console import Progressing
    from smooth_operator.cli.outputs import folder_for
    from smooth_operator.hands.registry import load_hand

    if options.checkpoint_every < 1:
        raise ConfigError(f"--checkpoint-every must be 1 or more, not {options.checkpoint_every}")
    progress = Progressing(options.quiet)
    settings = GeortTraining(epochs=options.epochs, seed=options.seed)
    if options.coverage == "reach":
        settings = replace(settings, margin=None)
    recordings, held_out = _recordings(options, progress)
    hand = load_hand(options.hand, recordings[0].side)
    with folder_for(options.output):
        with progress.waiting("preparing the data"):
            trainer = GeortTrainer(
                hand, training_data(recordings, hand, settings, held_out), settings
            )
            session = TrainingSession(trainer, options.output, options.checkpoint_every)
        frames, points = trainer.data.frames, trainer.data.train
        progress.note(
            f"training on {frames['train']} frames, validating on {frames['validation']}; "
            f"{points.counts.min()} to {points.counts.max()} points per finger, "
            f"{points.pinched.shape[-1]} frames with a pinch"
        )
        if not points.pinched.any():
            progress.note(
                "the recordings contain no pinch (thumb tip and a fingertip within "
                f"{settings.pinch_distance * 1e3:g} mm): the model will not learn to close a "
                "pinch",
                matters=True,
            )
        try:
            with _bar(progress, settings.epochs) as watch:
                model = session.run(resume=options.resume, watch=watch)
        except KeyboardInterrupt:
            if not (options.output / "checkpoint.npz").exists():
                raise
            raise KeyboardInterrupt(f"to continue: {_resuming(options)}") from None
    losses = model.training["losses"]
    for kind in ("train", "validation"):
        shown = ", ".join(f"{name} {losses[kind][name]:.3g}" for name in LOSSES)
        progress.note(f"{kind}: {shown}")
    progress.note(f"wrote {options.output / 'model.npz'}")


def _recordings(
    options: Train, progress: Progressing
) -> tuple[list[HandRecording], list[HandRecording]]:
    """Recordings for training, and recordings used only for validation."""
    from smooth_operator.baselines.geort.training_data import synthetic_recordings
    from smooth_operator.cli.session import read_shown
    from smooth_operator.hands.registry import default_side

    if not options.recordings:
        raise ConfigError("name a recording to train on, or the word 'synthetic'")
    if SYNTHETIC in options.recordings:
        if len(options.recordings) > 1 or options.frames or options.rate:
            raise ConfigError(
                "'synthetic' can't be combined with other recordings, --frames or --rate "
                "(for a file of that name, write ./synthetic)"
            )
        with progress.waiting("recording the synthetic operators"):
            return synthetic_recordings(options.side or default_side(options.hand), options.seed)
    reading = {"rate": options.rate, "side": options.side, "layout": options.layout}
    return [read_shown(p, progress, options.frames, **reading) for p in options.recordings], []


@contextlib.contextmanager
def _bar(progress: Progressing, epochs: int) -> Iterator[Callable[[TrainingState], None]]:
    import numpy as np

    from smooth_operator.baselines.geort.training import LOSSES

    with progress.counter("epochs", extra="{task.fields[losses]}", in_files=True) as bar:
        task = bar.add_task("training", total=epochs, losses="")

        def watch(state: TrainingState) -> None:
            done = int(state.epoch)
            if done:
                direction = float(np.asarray(state.train)[done - 1, 1 + LOSSES.index("direction")])
                bar.update(task, completed=done, losses=f"direction {direction:.4f}")

        yield watch


def _resuming(options: Train) -> str:
    """Command that resumes the training."""
    words = ["smooth-operator", "train", options.method, *options.recordings]
    words += ["--hand", options.hand, "--output", str(options.output)]
    words += ["--epochs", str(options.epochs), "--seed", str(options.seed)]
    for name, value in (
        ("--side", options.side),
        ("--frames", options.frames),
        ("--rate", options.rate),
    ):
        words += [] if value is None else [name, str(value)]
    return shlex.join([*words, "--coverage", options.coverage, "--resume"])
