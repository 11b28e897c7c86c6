"""The source ``webxr``: hands from the browser of a headset."""

from __future__ import annotations

import asyncio
import math
import shutil
import ssl
from dataclasses import dataclass, field

from smooth_operator.errors import MissingExtraError
from smooth_operator.synthetic.tracker import check_range
from smooth_operator.teleop.sources.live import Running, SourceHealth, ThreadedSource
from smooth_operator.teleop.sources.webxr.link import Link, LinkState, Pairing, check_code
from smooth_operator.teleop.sources.webxr.server import (
    Certificate,
    certificate_folder,
    get_certificate,
    listen,
    secure_context,
    serve,
)
from smooth_operator.web.addresses import names_of, page_addresses
from smooth_operator.web.listening import LimitedListener


@dataclass(frozen=True)
class WebXr(ThreadedSource):
    """Both hands from a headset's browser: Quest, Vision Pro, PICO.

    Serves a page over HTTPS that streams the 25 joints of each hand back. Nobody gets past the
    page without the pairing code. Stamps are by the headset's clock; ``link`` has the offset
    to this machine's. A new connection is a new session, and the newest one is listened to.

    Attributes:
        host: address to listen on; ``127.0.0.1`` is this machine only (a headset on a cable),
            ``0.0.0.0`` all its networks.
        port: TCP port; 0 for any free one.
        code: pairing code, six letters and digits or more; a random one for each start if None.

    Raises:
        ConfigError: a setting is outside its range.
    """

    host: str = "127.0.0.1"
    port: int = 8443
    code: str | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        check_range("webxr port", self.port, 0, 65535)
        if self.code is not None:
            check_code(self.code)

    @property
    def label(self) -> str:
        """Host and port that it listens on."""
        return f"webxr {self.host}:{self.port}"

    @property
    def addresses(self) -> tuple[str, ...]:
        """Addresses of the page, the one to type first; empty before ``start``."""
        opened: _Opened | None = getattr(self, "_opened", None)
        return () if opened is None else opened.addresses

    @property
    def link(self) -> LinkState:
        """State of the link, at any time, from any thread."""
        link: Link | None = getattr(self, "_link", None)
        return LinkState() if link is None else link.state

    def open(self) -> None:
        """Make the certificate and take the port."""
        try:
            import websockets.asyncio.server  # noqa: F401
        except ImportError as error:
            raise MissingExtraError("a headset's browser as source", "webxr") from error
        folder = certificate_folder()
        certificate = get_certificate(names_of(self.host), folder)
        try:
            context = secure_context(certificate)
        finally:
            if folder is None:
                shutil.rmtree(certificate.file.parent, ignore_errors=True)
        listening = listen(self.host, self.port)
        addresses = page_addresses(self.host, listening.getsockname()[1])
        opened = _Opened(listening, certificate, context, Pairing(self.code), addresses)
        object.__setattr__(self, "_opened", opened)

    def run(self, running: Running) -> None:
        """Serve until it is to end."""
        opened: _Opened = getattr(self, "_opened")  # noqa: B009  (set by open)
        link = Link(running.mailbox, opened.pairing)
        object.__setattr__(self, "_link", link)

        def watch() -> bool:
            running.health = describe(link.state, opened.addresses, opened.pairing)
            return not running.stopping.is_set()

        with opened.listening:
            asyncio.run(serve(opened.listening, opened.certificate, opened.context, link, watch))


@dataclass(frozen=True)
class _Opened:
    """Resources of a started source."""

    listening: LimitedListener
    certificate: Certificate
    context: ssl.SSLContext
    pairing: Pairing
    addresses: tuple[str, ...]


def describe(link: LinkState, addresses: tuple[str, ...], pairing: Pairing) -> SourceHealth:
    """Health in a sentence."""
    faults = [
        text
        for count, text in (
            (link.bad, f"messages that can't be read: {link.bad}"),
            (link.refused, f"wrong pairing codes: {link.refused}"),
        )
        if count
    ]
    also = f" ({', '.join(faults)})" if faults else ""
    if link.address is None:
        where = " or ".join(addresses)
        if all("//localhost:" in address for address in addresses):
            also = (
                "; only this machine reaches that, or a headset on a cable with adb reverse: "
                f"write webxr:0.0.0.0 for a headset on its network{also}"
            )
        back = "the headset is gone; " if link.session else ""
        return SourceHealth(
            "waiting",
            f"{back}open {where} in the headset's browser, pairing code {pairing.spoken}{also}",
        )
    if not link.rate_hz:
        what = "no hands come" if link.tracking else "press Start on its page"
        return SourceHealth("waiting", f"headset {link.address} is paired: {what}{also}")
    trip = link.round_trip_s
    pace = "" if math.isnan(trip) else f", round trip {1e3 * trip:.0f} ms"
    return SourceHealth("running", f"headset {link.address}, {link.rate_hz:.0f} Hz{pace}{also}")
