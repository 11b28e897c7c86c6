"""What ``smooth-operator teleop`` finds out before it compiles anything or opens a page."""

from __future__ import annotations

from collections.abc import Sequence

from smooth_operator.cli.teleop_options import Teleop
from smooth_operator.errors import ConfigError
from smooth_operator.hands.hand import Hand
from smooth_operator.hands.menagerie import drawn_on
from smooth_operator.methods.method import MethodConfig
from smooth_operator.planning import RetargetRequest, resolve
from smooth_operator.teleop.runtime.limiter import Limiter
from smooth_operator.teleop.runtime.settings import LoopConfig
from smooth_operator.teleop.sinks.runner import SinkRunner
from smooth_operator.teleop.sources.live import LiveSource
from smooth_operator.types import Side


def checked(
    options: Teleop,
    asked: RetargetRequest,
    config: LoopConfig,
    sides: Sequence[Side],
    source: LiveSource,
    sinks: SinkRunner,
) -> dict[Side, tuple[Hand, MethodConfig]]:
    """The hands and their methods' settings, once all that a run needs is there.

    Whatever is missing, taken or wrong is found here, in a second, and not after a compilation:
    extras, files, models, addresses, ports. The source is open afterwards.

    Raises:
        SmoothOperatorError: what is wrong.
    """
    settled = {side: resolve(asked, side) for side in sides}
    hands = {side: hand for side, (hand, _) in settled.items()}
    for hand in hands.values():
        Limiter(hand, config.limits)
    sinks.check(hands)
    if options.control is not None:
        from smooth_operator.teleop.runtime.remote import check_address

        check_address(options.control)
    if not options.no_view:
        from smooth_operator.teleop.pages.ports import free_port

        free_port(options.host, options.port)
        if options.model is not None:
            for hand in hands.values():
                drawn_on(hand, options.model)  # the page's own process does it again
    elif options.model is not None:
        raise ConfigError(
            "--model says what the page draws, and --no-view leaves the page out; leave out one"
        )
    source.prepare()
    return settled
