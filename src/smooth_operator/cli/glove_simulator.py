"""``smooth-operator glove-simulator``: a glove for people without one."""

from __future__ import annotations

from smooth_operator.cli.glove_simulator_options import GloveSimulate
from smooth_operator.teleop.sources.manus.glove_simulator import LATE_S, GloveFaults, GloveSimulator
from smooth_operator.terminal import printable


def simulate(options: GloveSimulate) -> None:
    """Publishes until the time is over or Ctrl-C, then says how punctual it was.

    Raises:
        SmoothOperatorError: a setting, the recording or the address can't be used.
    """
    glove = GloveSimulator(
        address=options.address,
        rate=options.rate,
        side=options.side,
        recording=options.recording,
        duration=options.duration,
        noise=options.noise,
        seed=options.seed,
        faults=GloveFaults(
            drop=options.drop,
            silence_every=options.silence_every,
            silence=options.silence,
            missing=options.missing,
            duplicate=options.duplicate,
            reorder=options.reorder,
            swap=options.swap,
            garbage=options.garbage,
            restart_every=options.restart_every,
        ),
    ).open()
    try:
        if not options.quiet:
            hands = "both hands" if options.side == "both" else f"the {options.side} hand"
            # Flushed, for a script that waits for the address.
            print(
                printable(f"publishing {hands} at {glove.rate:.4g} Hz on {glove.address}"),
                flush=True,
            )
        glove.run()
    finally:
        glove.close()
        sent = glove.sent
        if not options.quiet:
            print(
                f"sent {sent.messages} messages in {sent.seconds:.1f} s, {sent.late} later than "
                f"{LATE_S * 1e3:g} ms, the latest {sent.worst_s * 1e3:.1f} ms"
            )
