"""The page of ``smooth-operator teleop``: begun early, shown when there is something to show."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from smooth_operator.cli.console import Progressing
from smooth_operator.cli.teleop_options import Teleop
from smooth_operator.planning import RetargetRequest
from smooth_operator.teleop.control.workshop import Workshop
from smooth_operator.teleop.runtime.loop import TeleopLoop
from smooth_operator.teleop.sinks.sink import Sink, simulated_hands
from smooth_operator.types import Side
from smooth_operator.web.browser import open_page

if TYPE_CHECKING:
    from smooth_operator.teleop.pages.live.page import LivePage


@contextlib.contextmanager
def begun_page(
    options: Teleop, asked: RetargetRequest, sides: tuple[Side, ...], acting: Sequence[Sink]
) -> Iterator[LivePage | None]:
    """The page's process, which gets ready while the method is compiled; None if it is left out."""
    if options.no_view:
        yield None
        return
    from smooth_operator.teleop.pages.live.page import LivePage, PageSetup

    simulated = simulated_hands(acting) is not None
    setup = PageSetup(
        asked.hand,
        sides,
        asked.fingers,
        options.host,
        options.port,
        simulated,
        options.blind,
        None if options.model is None else str(options.model),
    )
    with LivePage(setup) as page:
        yield page


def show_page(
    page: LivePage | None,
    loop: TeleopLoop,
    asked: RetargetRequest,
    acting: Sequence[Sink],
    workshop: Workshop,
    options: Teleop,
    progress: Progressing,
) -> None:
    """Have the page show a loop that is about to run, and open it.

    Raises:
        ConfigError: it can't be served there.
    """
    if page is None:
        return
    from smooth_operator.teleop.pages.live.session import LiveSession

    session = LiveSession(loop, asked, acting, workshop=workshop, blind=options.blind)
    loop.watch = session.watch
    url = page.serve(session)
    progress.note(f"page: {url}", matters=True)
    if not options.no_browser:
        open_page(url)
