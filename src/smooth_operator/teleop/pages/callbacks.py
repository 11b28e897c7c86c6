"""Callbacks of controls that answer people only."""

from __future__ import annotations

from collections.abc import Callable, Coroutine
from typing import Any


def asked(action: Callable[[Any], None]) -> Callable[[Any], Coroutine[Any, Any, None]]:
    """Wrap an action as a callback that answers people only.

    Handles also call back when the program itself writes a value; such events have no client.
    Coroutines run in order on the server's event loop, plain functions in a pool without order.
    """

    async def callback(event: Any) -> None:
        if event.client is not None:
            action(event)

    return callback
