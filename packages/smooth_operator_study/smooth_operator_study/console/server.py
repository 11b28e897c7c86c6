"""Serves both pages and their WebSockets on one port.

A page sends ``{"type": "command", ...}`` (``.session_service``). It receives ``state`` (its whole
content, again after each change), ``done`` and ``refused`` (with the command's token; ``again`` if
the same command may succeed later) and, once a second, ``alive``: a page that misses it is cut off.
A command is answered with ``done`` only when its event is on disk.

The operator's token opens the operator's page only. A console that only this machine reaches asks
for no token; pages of other sites in the same browser are refused by their origin. Tokens stay the
same, so that a tablet reconnects by itself when the console is started again.
"""

from __future__ import annotations

import asyncio
import base64
import contextlib
import hashlib
import hmac
import http
import json
import logging
import os
import secrets
import socket
import time
from collections.abc import Callable, Collection, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any, Final, cast
from urllib.parse import urlsplit

from smooth_operator.errors import DocumentError, SmoothOperatorError, StudyError
from smooth_operator.io.documents import json_object
from smooth_operator.own_files import make_private, read_own_file
from smooth_operator.user_folders import is_off, user_cache
from smooth_operator.web.addresses import is_local, page_addresses
from smooth_operator.web.auth import TokenAuth
from smooth_operator.web.files import answer_with, page_files, shielded
from smooth_operator.web.listening import quiet_options
from smooth_operator_study.console.session_service import (
    Role,
    SessionService,
    StoreFailedError,
    command_of,
)

if TYPE_CHECKING:
    from websockets.asyncio.server import ServerConnection
    from websockets.http11 import Request, Response

HOME: Final[Mapping[Role, str]] = {"experimenter": "/", "operator": "/operator"}
"""Path of each page."""
LINK: Final[Mapping[Role, str]] = {"experimenter": "/link", "operator": "/operator/link"}
"""Path of each page's WebSocket."""
OPERATORS: Final = (
    "/operator",
    "/operator/link",
    "/operator.js",
    "/tlx.js",
    "/form.js",
    "/link.js",
    "/dom.js",
    "/console.css",
    "/icon.svg",
)
"""Paths that the operator's token opens."""


@dataclass(frozen=True)
class ConsoleAuth(TokenAuth):
    """Authentication with one token for each role; the operator's opens ``OPERATORS`` only."""

    paths: Mapping[str, Collection[str]] = field(default_factory=lambda: {"operator": OPERATORS})
    shown_by: str = "the terminal, or the experimenter's page,"

    def links(self, host: str, port: int) -> dict[Role, str]:
        """Returns the address of each page with its token."""
        base = page_addresses(host, port, "http")[0]
        return {
            role: base + path + ("" if self.tokens is None else f"?token={self.tokens[role]}")
            for role, path in HOME.items()
        }


def auth_for(host: str, study: str) -> ConsoleAuth:
    """Returns the authentication of a console.

    Args:
        host: address on which the console listens; a loopback address needs no tokens.
        study: name of the study; its tokens are the same after a restart.
    """
    if is_local(host):
        return ConsoleAuth(None)
    secret = _secret()
    tokens: dict[str, str] = {}
    for role in HOME:
        digest = hmac.new(secret, f"{role}\n{study}".encode(), hashlib.sha256).digest()
        tokens[role] = base64.urlsafe_b64encode(digest[:18]).decode()
    return ConsoleAuth(tokens)


def qr_code(text: str) -> bytes:
    """Returns a QR code as SVG with its own light background."""
    import io

    import segno

    out = io.BytesIO()
    segno.make(text, error="m", micro=False).save(
        out, kind="svg", border=3, dark="#10212e", light="#ffffff", xmldecl=False, scale=4
    )
    return out.getvalue()


def _secret() -> bytes:
    """32 random bytes of this user on this machine; new ones in each run if they can't be stored.

    They are not in the folder of the study, which may be given to others.
    """
    drawn = secrets.token_bytes(32)
    if is_off():
        return drawn
    file = user_cache() / "study" / "console.key"
    try:
        make_private(file.parent)
        # The first of two parallel writers wins.
        private = partial(os.open, mode=0o600)
        with contextlib.suppress(FileExistsError), open(file, "xb", opener=private) as out:
            out.write(drawn)
        stored = read_own_file(file, len(drawn), secret=True)
    except (OSError, DocumentError):  # others may be able to read the file
        return drawn
    return stored if len(stored) == len(drawn) else drawn


_TICK_S: Final = 0.2
_ALIVE_S: Final = 1.0
_LOOK_S: Final = 1.5
"""Interval of the checks of what other processes stored, and of the teleoperation [s]."""
_LOOK_CLOSER_S: Final = 0.4
"""Interval of these checks while a trial runs in simulation [s]."""
_TROUBLE_S: Final = 10.0
"""Time for which a failure of the store is shown after its last occurrence [s]."""
_LARGEST: Final = 256 * 1024
_PLACES: Final[dict[Role, int]] = {"experimenter": 16, "operator": 48}
"""Largest number of open pages of each role, counted separately."""
_LOGGER: Final = logging.getLogger("smooth_operator_study.console")


@dataclass(eq=False)
class _Page:
    """A connected page, and the answers that were not sent to it yet."""

    connection: ServerConnection
    role: Role
    answers: list[dict[str, Any]] = field(default_factory=list)
    state_seen: int = -1
    news: asyncio.Event = field(default_factory=asyncio.Event)


class Console:
    """Serves the pages of a session.

    Args:
        service: carries out commands; its ``changed`` is ``Console.changed``.
        auth: authentication of the pages.
        links: role -> address of the page.
        local: whether only this machine reaches the pages.
    """

    def __init__(
        self, service: SessionService, auth: ConsoleAuth, links: dict[Role, str], *, local: bool
    ) -> None:
        self._service = service
        self._auth = auth
        self._links = links
        self._local = local
        self._pages: set[_Page] = set()
        self._version = 0
        self._looks = self._shown = 0
        self._states: dict[Role, dict[str, Any]] = {}
        self._troubles: dict[str, tuple[str, float]] = {}
        self._stale = asyncio.Event()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._threads = ThreadPoolExecutor(8, "study-console")

    def changed(self) -> None:
        """Updates the pages. May be called from any thread."""
        if self._loop is not None and not self._loop.is_closed():
            self._loop.call_soon_threadsafe(self._stale.set)

    async def serve(
        self, listening: socket.socket, stop: asyncio.Event, ready: Callable[[], None]
    ) -> None:
        """Serves the pages until ``stop`` is set."""
        from websockets.asyncio.server import serve

        self._loop = asyncio.get_running_loop()
        site = page_files("smooth_operator.web") | page_files(__package__)
        site |= {
            HOME["experimenter"]: site["/experimenter.html"],
            HOME["operator"]: site["/operator.html"],
        }
        if not self._local:
            site["/operator.svg"] = (qr_code(self._links["operator"]), "image/svg+xml")
        await self._draw()
        service = self._service
        jobs = [
            asyncio.create_task(job)
            for job in (
                self._repeat(service.tick, lambda: _TICK_S),
                self._repeat(service.watch, self._look_s),
                self._repeat(service.has_news, self._look_s),
                self._redraw(),
            )
        ]
        try:
            async with serve(
                self._talk,
                sock=listening,
                process_request=shielded(self._answering(site)),
                compression="deflate",
                max_size=_LARGEST,
                open_timeout=10.0,
                close_timeout=1.0,
                ping_interval=10.0,
                ping_timeout=30.0,
                **quiet_options(_LOGGER.name),
            ):
                ready()
                await stop.wait()
        finally:
            for job in jobs:
                job.cancel()
            await asyncio.gather(*jobs, return_exceptions=True)
            self._threads.shutdown(wait=False, cancel_futures=True)

    def _answering(self, site: dict[str, tuple[bytes, str]]) -> Callable[..., Any]:
        def answer(connection: ServerConnection, request: Request) -> Response | None:
            if (refusal := self._auth.refusal(connection, request)) is not None:
                return cast("Response", refusal)
            path = urlsplit(request.path).path
            if path in LINK.values():
                role = _role_of(path)
                if self._counts()[role] >= _PLACES[role]:
                    return connection.respond(
                        http.HTTPStatus.SERVICE_UNAVAILABLE,
                        f"{_PLACES[role]} pages of the {role} are already open; close some "
                        "of them\n",
                    )
                return None
            if path not in site:
                return connection.respond(http.HTTPStatus.NOT_FOUND, "no such page\n")
            return answer_with(connection, *site[path], links="ws: wss:")

        return answer

    # One page.

    async def _talk(self, connection: ServerConnection) -> None:
        from websockets.exceptions import ConnectionClosed

        request = connection.request
        path = urlsplit(request.path).path if request is not None else ""
        page = _Page(connection, _role_of(path))
        self._pages.add(page)
        self._stale.set()
        page.news.set()
        sending = asyncio.create_task(self._send_news(page))
        try:
            async for message in connection:
                content = json_object(message) or {}
                if content.get("type") == "command":
                    asyncio.create_task(self._command(page, content))  # noqa: RUF006  (answers by itself)
        except ConnectionClosed:
            pass
        finally:
            self._pages.discard(page)
            self._stale.set()
            sending.cancel()
            await asyncio.gather(sending, return_exceptions=True)

    async def _command(self, page: _Page, request: dict[str, Any]) -> None:
        answer: dict[str, Any] = {"type": "done", "token": request.get("token")}
        try:
            command = command_of(request, page.role)
            answer["number"] = await self._in_thread(self._service.carry_out, command, page.role)
            self._note_trouble("command", None)
        except SmoothOperatorError as error:
            again = isinstance(error, StoreFailedError)
            if again:
                self._note_trouble("command", error)
            answer |= {"type": "refused", "error": str(error), "again": again}
        except Exception as error:
            _LOGGER.exception("a command failed")
            text = f"not done, because of an error in this program: {type(error).__name__}: {error}"
            answer |= {"type": "refused", "error": text, "again": False}
        await self._draw()  # so that "done" comes with the state after it
        page.answers.append(answer)
        page.news.set()

    async def _send_news(self, page: _Page) -> None:
        """Sends pending updates to a page; a slow page gets only the newest state."""
        from websockets.exceptions import ConnectionClosed

        with contextlib.suppress(ConnectionClosed):
            while True:
                with contextlib.suppress(TimeoutError):
                    await asyncio.wait_for(page.news.wait(), _ALIVE_S)
                quiet = not page.news.is_set()
                page.news.clear()
                if quiet:
                    await self._send(page, {"type": "alive"})
                if page.state_seen != self._version:
                    page.state_seen = self._version
                    await self._send(page, {"type": "state", **self._states[page.role]})
                while page.answers:
                    await self._send(page, page.answers[0])
                    page.answers.pop(0)

    async def _send(self, page: _Page, what: dict[str, Any]) -> None:
        await page.connection.send(
            json.dumps({**what, "sent": 1e3 * self._service.now().timestamp()})
        )

    # All pages.

    async def _draw(self) -> None:
        """Computes the states, and wakes the pages if they have changed.

        Several calls may overlap. A result that began before one that is shown is dropped, or the
        pages would go back to an older state.
        """
        self._stale.clear()
        self._looks += 1
        began = self._looks
        try:
            experimenter, operator = await self._in_thread(self._service.look)
            self._note_trouble("look", None)
        except Exception as error:
            # Answers are sent whatever the failure is, and the next look tries again.
            if not isinstance(error, SmoothOperatorError):
                _LOGGER.exception("a look at the study failed")
                error = StudyError(f"an error in this program, {type(error).__name__}")
            self._note_trouble("look", error)
            experimenter = self._states.get("experimenter", {})
            operator = self._states.get("operator", {"what": "wait"})
        if began < self._shown:
            return
        self._shown = began
        experimenter = {**experimenter, "trouble": self._trouble(), "pages": self._counts()}
        experimenter["links"] = {
            "operator": self._links["operator"],
            "qr": not self._local,
        }
        states: dict[Role, dict[str, Any]] = {
            "experimenter": experimenter,
            "operator": {**operator, "trouble": bool(self._trouble())},
        }
        if states != self._states:
            self._states = states
            self._version += 1
            for page in self._pages:
                page.news.set()

    def _counts(self) -> dict[Role, int]:
        return {role: sum(page.role == role for page in self._pages) for role in HOME}

    async def _redraw(self) -> None:
        while True:
            await self._stale.wait()
            await self._draw()
            await asyncio.sleep(0.02)

    async def _repeat(self, job: Callable[[], object], pause: Callable[[], float]) -> None:
        """Runs a job regularly; a failure of the store is shown on the pages."""
        while True:
            try:
                if await self._in_thread(job) is True or self._troubles:
                    self._stale.set()
                self._note_trouble(job.__name__, None)
            except SmoothOperatorError as error:
                if isinstance(error, StoreFailedError):
                    self._note_trouble(job.__name__, error)
            except Exception:
                _LOGGER.exception("a regular job failed")
            await asyncio.sleep(pause())

    def _look_s(self) -> float:
        hand = self._states.get("experimenter", {}).get("teleop") or {}
        return _LOOK_S if hand.get("trial") is None else _LOOK_CLOSER_S

    def _note_trouble(self, where: str, error: Exception | None) -> None:
        before = self._trouble()
        if error is None:
            self._troubles.pop(where, None)
        else:
            self._troubles[where] = (str(error), time.monotonic())
        if self._trouble() != before:
            self._stale.set()

    def _trouble(self) -> str:
        """Message of the latest failure of the store; empty without one."""
        since = time.monotonic() - _TROUBLE_S
        return next((text for text, at in self._troubles.values() if at > since), "")

    def _in_thread(self, job: Callable[..., Any], *arguments: Any) -> asyncio.Future[Any]:
        return asyncio.get_running_loop().run_in_executor(self._threads, job, *arguments)


def _role_of(path: str) -> Role:
    return "operator" if path == LINK["operator"] else "experimenter"
