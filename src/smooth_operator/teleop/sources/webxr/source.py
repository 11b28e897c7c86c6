"""The source ``webxr``, which receives hands from the browser of a headset.

The page and its WebSocket share one port.
"""

from __future__ import annotations

import asyncio
import datetime
import hashlib
import http
import ipaddress
import json
import math
import os
import shutil
import ssl
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final
from urllib.parse import urlsplit

from smooth_operator.errors import MissingExtraError, SourceError
from smooth_operator.landmarks import FINGER_COLORS
from smooth_operator.own_files import make_private, read_own_file
from smooth_operator.settings import check_range
from smooth_operator.teleop.sources.live import (
    Running,
    SourceHealth,
    ThreadedSource,
)
from smooth_operator.teleop.sources.webxr.controller_poses import controller_poses
from smooth_operator.teleop.sources.webxr.link import (
    MAX_BYTES,
    Link,
    LinkState,
    Pairing,
    View,
    check_code,
)
from smooth_operator.types import Side
from smooth_operator.user_folders import SWITCH, is_off, user_cache
from smooth_operator.web.addresses import names_of, page_addresses
from smooth_operator.web.auth import same_origin
from smooth_operator.web.files import answer_with, page_files, shielded
from smooth_operator.web.listening import LimitedListener, listen, quiet_options

if TYPE_CHECKING:
    from cryptography import x509
    from websockets.asyncio.server import ServerConnection
    from websockets.http11 import Request, Response


SOCKET_PATH: Final = "/link"
MOST_CONNECTIONS: Final = 64
MOST_OF_ONE_ADDRESS: Final = 24
MOST_WAITING: Final = 12
"""Largest number of connections that have not finished their TLS handshake. A page needs seven at
most; each takes 0.3 MB."""
_HANDSHAKE_S: Final = 5.0
"""Time limit for each of the TLS handshake, the request and the greeting [s]."""
_LOOK_EVERY: Final = 0.05  # [s]


async def serve(
    listening: LimitedListener,
    certificate: Certificate,
    context: ssl.SSLContext,
    link: Link,
    watch: Callable[[], bool],
) -> None:
    """Serves the page and the link until ``watch``, which is called 20 times a second, returns
    False."""
    from websockets.asyncio.server import serve as serve_sockets

    site = page_files("smooth_operator.web") | page_files(__package__)
    site["/"] = site["/index.html"]
    colors = [list(bytes.fromhex(code.removeprefix("#"))) for code in FINGER_COLORS]
    module = f"export const FINGER_COLORS = {json.dumps(colors)};\n"  # 0 to 255
    site["/colors.js"] = (module.encode(), "text/javascript; charset=utf-8")
    module = f"export const POSES = {json.dumps(controller_poses())};\n"
    site["/poses.js"] = (module.encode(), "text/javascript; charset=utf-8")
    site["/certificate.crt"] = (certificate.public, "application/x-x509-ca-cert")

    def answer(connection: ServerConnection, request: Request) -> Response | None:
        listening.served(connection.remote_address)
        path = urlsplit(request.path).path
        if path == SOCKET_PATH:
            if not same_origin(request):
                return connection.respond(http.HTTPStatus.FORBIDDEN, "not from this page\n")
            return None
        if path not in site:
            return connection.respond(http.HTTPStatus.NOT_FOUND, "no such page\n")
        return answer_with(connection, *site[path])

    async with serve_sockets(
        link.serve,
        sock=listening,
        ssl=context,
        process_request=shielded(answer),
        compression=None,  # it takes more time than it saves
        max_size=MAX_BYTES + 64,
        ssl_handshake_timeout=_HANDSHAKE_S,
        open_timeout=_HANDSHAKE_S,
        close_timeout=1.0,
        ping_interval=2.0,
        ping_timeout=5.0,
        **quiet_options("smooth_operator.webxr"),  # browsers give up, or try plain HTTP
    ):
        while watch():
            await asyncio.sleep(_LOOK_EVERY)


VALID: Final = datetime.timedelta(days=365)  # Apple allows 825 days at most
_MOST_BYTES: Final = 100_000
_SPARE: Final = datetime.timedelta(days=1)  # shortest validity of a stored certificate


@dataclass(frozen=True)
class Certificate:
    """A stored certificate.

    Attributes:
        file: PEM file with key and certificate; only this user can read it.
        public: the certificate alone, in PEM.
        expires: time at which it expires.
        fingerprint: SHA-256 in the notation of browsers.
    """

    file: Path
    public: bytes
    expires: datetime.datetime
    fingerprint: str


def certificate_folder() -> Path | None:
    """Folder in which certificates are stored; None if ``SWITCH`` disables storing them."""
    if is_off():
        return None
    return user_cache() / "webxr"


def get_certificate(
    names: Sequence[str], folder: Path | None, now: datetime.datetime | None = None
) -> Certificate:
    """Returns a certificate for some host names: the stored one, or a new one.

    Each set of names has its own file, so that a laptop can alternate between two networks.

    Args:
        folder: folder of the certificates; None for a temporary folder.
        now: time with time zone; None for the current time.

    Raises:
        MissingExtraError: cryptography is not installed.
        SourceError: the folder can't be written, or belongs to another user.
    """
    try:
        import cryptography  # noqa: F401
    except ImportError as error:
        raise MissingExtraError("a headset's browser as source", "webxr") from error
    now = datetime.datetime.now(datetime.UTC) if now is None else now
    key = hashlib.sha256("\n".join(sorted(names)).encode()).hexdigest()[:12]
    place = Path(tempfile.mkdtemp(prefix="smooth-operator-")) if folder is None else folder
    file = place / f"certificate-{key}.pem"
    try:
        _make_private(place)
        stored = _read(file, now)
        if stored is not None:
            return stored
        _write(file, _make(names, now))
    except OSError as error:
        raise SourceError(
            f"can't store the certificate of the headset's page in {str(place)!r}: "
            f"{error.strerror or error}; set {SWITCH} to a folder of your own, or to 'off'"
        ) from error
    created = _read(file, now)
    if created is None:
        raise SourceError(
            f"can't store a certificate in {str(place)!r}: other users could read it; set "
            f"{SWITCH} to a folder of your own"
        )
    return created


def _make_private(folder: Path) -> None:
    make_private(folder)
    if hasattr(os, "getuid"):
        if folder.stat().st_uid != os.getuid():
            raise SourceError(
                f"{str(folder)!r} belongs to another user; set {SWITCH} to a different folder"
            )
        folder.chmod(0o700)


def _read(file: Path, now: datetime.datetime) -> Certificate | None:
    """Reads a stored certificate; None if it is missing, damaged, readable by others or about to
    expire."""
    from cryptography import x509
    from cryptography.hazmat.primitives import hashes, serialization

    try:
        text = read_own_file(file, _MOST_BYTES, secret=True)
        serialization.load_pem_private_key(text, None)
        certificate = x509.load_pem_x509_certificate(text)
    except (FileNotFoundError, ValueError, TypeError):
        return None
    if not certificate.not_valid_before_utc <= now < certificate.not_valid_after_utc - _SPARE:
        return None
    return Certificate(
        file,
        certificate.public_bytes(serialization.Encoding.PEM),
        certificate.not_valid_after_utc,
        certificate.fingerprint(hashes.SHA256()).hex(":").upper(),
    )


def _write(file: Path, text: bytes) -> None:
    # Private from its first byte on; replaces an older file in one step.
    with tempfile.TemporaryDirectory(dir=file.parent) as folder:
        temporary = Path(folder, file.name)
        handle = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        with os.fdopen(handle, "wb") as out:
            out.write(text)
        os.replace(temporary, file)


def _make(names: Sequence[str], now: datetime.datetime) -> bytes:
    """Makes a key and its certificate, in PEM."""
    from cryptography import x509
    from cryptography.hazmat.primitives import hashes, serialization
    from cryptography.hazmat.primitives.asymmetric import ec
    from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

    key = ec.generate_private_key(ec.SECP256R1())
    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "smooth-operator headset page")])
    public = key.public_key()
    subtrees = [_name(name, ipaddress.ip_network) for name in names]
    unused = (
        *("content_commitment", "key_encipherment", "data_encipherment", "key_agreement"),
        *("crl_sign", "encipher_only", "decipher_only"),
    )
    usage = dict.fromkeys(unused, False) | {"digital_signature": True, "key_cert_sign": True}
    certificate = (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(subject)
        .public_key(public)
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - datetime.timedelta(days=1))  # clocks of headsets may be late
        .not_valid_after(now + VALID)
        .add_extension(x509.SubjectAlternativeName([_name(n) for n in names]), critical=False)
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .add_extension(x509.KeyUsage(**usage), critical=True)
        .add_extension(x509.ExtendedKeyUsage([ExtendedKeyUsageOID.SERVER_AUTH]), critical=False)
        .add_extension(x509.NameConstraints(subtrees, None), critical=True)
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(public), critical=False)
        .sign(key, hashes.SHA256())
    )
    private = key.private_bytes(
        serialization.Encoding.PEM,
        serialization.PrivateFormat.PKCS8,
        serialization.NoEncryption(),
    )
    return private + certificate.public_bytes(serialization.Encoding.PEM)


def _name(name: str, parse: Callable[[str], Any] = ipaddress.ip_address) -> x509.GeneralName:
    from cryptography import x509

    try:
        return x509.IPAddress(parse(name))
    except ValueError:
        return x509.DNSName(name)


@dataclass(frozen=True)
class WebXr(ThreadedSource):
    """Source of both hands from a headset's browser: Quest, Vision Pro, PICO.

    Serves a page over HTTPS, which sends the 25 joints of each hand after pairing with a code.
    Stamps are by the headset's clock; ``link`` contains the offset to this machine's clock. A new
    connection is a new session and replaces the previous one.

    Attributes:
        host: address to listen on; ``127.0.0.1`` for this machine only (a headset on a cable),
            ``0.0.0.0`` for all its networks.
        port: TCP port; 0 for any free one.
        code: pairing code of at least six letters and digits; None for a random one at each start.

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
        """Name of the source, with its host and port."""
        return f"webxr {self.host}:{self.port}"

    @property
    def addresses(self) -> tuple[str, ...]:
        """Addresses of the page, best one first. Empty before ``start``."""
        opened: _Opened | None = getattr(self, "_opened", None)
        return () if opened is None else opened.addresses

    @property
    def link(self) -> LinkState:
        """State of the link; safe at any time and from any thread."""
        link: Link | None = getattr(self, "_link", None)
        return LinkState() if link is None else link.state

    def expect_pulses(self) -> None:
        """Makes the page prepare the controllers for ``pulse``; call this before ``start``."""
        object.__setattr__(self, "_pulses", True)

    def pulse(self, side: Side, strength: float, seconds: float) -> None:
        """Makes the headset's controllers vibrate; safe from any thread.

        Args:
            side: side of the controllers.
            strength: 0 to 1; 0 ends a pulse.
            seconds: duration, unless another pulse comes before its end [s].
        """
        link: Link | None = getattr(self, "_link", None)
        if link is not None:
            link.pulse(side, strength, seconds)

    def show(self, view: View | None) -> None:
        """Makes the page draw a robot around the operator; None shows only the operator's hands."""
        object.__setattr__(self, "_view", view)
        link: Link | None = getattr(self, "_link", None)
        if link is not None:
            link.view = view

    def open(self) -> None:
        """Gets the certificate and opens the port."""
        try:
            import websockets.asyncio.server  # noqa: F401
        except ImportError as error:
            raise MissingExtraError("a headset's browser as source", "webxr") from error
        folder = certificate_folder()
        certificate = get_certificate(names_of(self.host), folder)
        try:
            context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
            context.minimum_version = ssl.TLSVersion.TLSv1_2
            context.load_cert_chain(certificate.file)
        finally:
            if folder is None:
                shutil.rmtree(certificate.file.parent, ignore_errors=True)
        try:
            port = listen(self.host, self.port)
        except OSError as error:
            raise SourceError(
                f"can't listen on {self.host!r} port {self.port}: {error.strerror or error}; name "
                "another port (port=...), or host=127.0.0.1 for this machine, host=0.0.0.0 for its "
                "networks"
            ) from error
        listening = LimitedListener(port, MOST_CONNECTIONS, MOST_OF_ONE_ADDRESS, MOST_WAITING)
        addresses = page_addresses(self.host, listening.getsockname()[1])
        opened = _Opened(listening, certificate, context, Pairing(self.code), addresses)
        object.__setattr__(self, "_opened", opened)

    def run(self, running: Running) -> None:
        """Serves the page until the source is stopped."""
        opened: _Opened = getattr(self, "_opened")  # noqa: B009  (set by open)
        link = Link(running.mailbox, opened.pairing, getattr(self, "_pulses", False))
        object.__setattr__(self, "_link", link)
        link.view = getattr(self, "_view", None)

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
    """Describes the state of the link in one sentence."""
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
                "; only this machine can reach it, or a headset connected by cable with adb "
                f"reverse; use webxr:0.0.0.0 for a headset on the network{also}"
            )
        back = "the headset has disconnected; " if link.session else ""
        return SourceHealth(
            "waiting",
            f"{back}open {where} in the headset's browser, pairing code {pairing.spoken}{also}",
        )
    if not link.rate_hz:
        what = "it sends no hands" if link.tracking else "press Start on its page"
        return SourceHealth("waiting", f"headset {link.address} is paired: {what}{also}")
    trip = link.round_trip_s
    pace = "" if math.isnan(trip) else f", round trip {1e3 * trip:.0f} ms"
    return SourceHealth("running", f"headset {link.address}, {link.rate_hz:.0f} Hz{pace}{also}")
