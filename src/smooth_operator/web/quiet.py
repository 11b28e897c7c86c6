"""Servers of websockets that print nothing of their own accord."""

from __future__ import annotations

import contextlib
import logging
from typing import Any


def quiet_options(name: str) -> dict[str, Any]:
    """Options of ``websockets.asyncio.server.serve``, so that bad requests print nothing.

    What a client does wrong (no HTTP, a request that ends early, a message that its handler fails
    on) goes to a logger, with a traceback; the library's own has no handler, so that Python prints
    it into the operator's terminal.

    Args:
        name: the logger's name, to which a program may add a handler.
    """
    from websockets.asyncio.server import ServerConnection

    class Connection(ServerConnection):
        """Writes all answers to what came together as one.

        A client may be gone when its thousands of pings are answered, and asyncio prints a line for
        each write to a lost connection, from the fifth on.
        """

        def send_data(self) -> None:
            data = self.protocol.data_to_send()
            if answers := b"".join(data):
                self.transport.write(answers)
            if b"" not in data:  # the mark of the end
                return
            if self.transport.can_write_eof():
                with contextlib.suppress(OSError, RuntimeError):
                    self.transport.write_eof()
            else:  # TLS
                self.transport.close()

    logger = logging.getLogger(name)
    if not any(isinstance(each, logging.NullHandler) for each in logger.handlers):
        logger.addHandler(logging.NullHandler())
    return {"logger": logger, "create_connection": Connection, "server_header": None}
