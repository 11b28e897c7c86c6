"""The live page of a run: its settings, its process, and what it shows."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from smooth_operator.hand_files.spec_writer import temporary_spec
from smooth_operator.planning import RetargetRequest
from smooth_operator.teleop.arm.settings import ArmSettings
from smooth_operator.teleop.control.method_switcher import MethodSwitcher
from smooth_operator.teleop.control.reporter import Reporter
from smooth_operator.teleop.runtime.loop import TeleopLoop
from smooth_operator.teleop.sinks.sink import Sink
from smooth_operator.types import Side
from smooth_operator.web.browser import open_page

if TYPE_CHECKING:
    from smooth_operator.teleop.pages.live.live_page import LivePage


@dataclass(frozen=True)
class PageSettings:
    """Where the live page is served. Needs the extra ``teleop``.

    Attributes:
        host: address to listen at; other than this machine's, a token in the page's address is
            needed to open it.
        port: first port to try; 0 for any free one.
        open_browser: open it in the browser.
        model: the vendor's MJCF or URDF to draw in place of simple shapes, or ``menagerie``.
        meshes: draw meshes, where there are some; otherwise simple shapes.
    """

    host: str = "127.0.0.1"
    port: int = 8080
    open_browser: bool = True
    model: Path | None = None
    meshes: bool = True


@contextlib.contextmanager
def begun_page(
    page: PageSettings | None,
    asked: RetargetRequest,
    sides: tuple[Side, ...],
    acting: Sequence[Sink],
    blind: bool,
    arm: ArmSettings | None = None,
) -> Iterator[LivePage | None]:
    """The page's process, which gets ready while the method is compiled; None if it is left out."""
    if page is None:
        yield None
        return
    from smooth_operator.teleop.pages.live.live_page import LivePage, PageSetup

    with temporary_spec(asked.hand) as hand:
        setup = PageSetup(
            hand,
            sides,
            asked.fingers,
            page.host,
            page.port,
            any(sink.measures for sink in acting),
            blind,
            None if page.model is None else str(page.model),
            page.meshes,
            arm=arm,
        )
        with LivePage(setup) as begun:
            yield begun


def show_page(
    begun: LivePage,
    page: PageSettings,
    loop: TeleopLoop,
    asked: RetargetRequest,
    acting: Sequence[Sink],
    switcher: MethodSwitcher,
    blind: bool,
    said: Reporter,
    trial: Callable[[], Mapping[str, Any] | None] = lambda: None,
) -> None:
    """Have the page show a loop that is about to run, and open it.

    Raises:
        ConfigError: it can't be served there.
    """
    from smooth_operator.teleop.pages.live.live_session import LiveSession

    session = LiveSession(loop, asked, acting, switcher=switcher, blind=blind, trial=trial)
    loop.watch = session.watch
    url = begun.serve(session)
    said.note(f"page: {url}", matters=True)
    if page.open_browser:
        open_page(url)
