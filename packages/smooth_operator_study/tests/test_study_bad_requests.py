"""What comes to the console's port that is no request, or a wrong one, is refused in silence."""

from collections.abc import Iterator
from pathlib import Path

import pytest
import study_console
import test_bad_requests
from test_bad_requests import (  # noqa: F401  tests of every server, here of the console
    Server,
    started,
    test_a_wrong_request_is_refused_and_prints_nothing,
    test_messages_that_are_none_print_nothing,
)

CONSOLE = """
import asyncio, sys
from pathlib import Path
from smooth_operator_study.console.server import ConsoleAuth
from smooth_operator_study.console.server import Console
from smooth_operator_study.console.session_service import SessionService
from smooth_operator_study.store.study_store import open_study
from smooth_operator.web.listening import listen
sys.path[:0] = sys.argv[2:]
from study_console import console_plan

async def serve(listening, console):
    stop = asyncio.Event()
    port = listening.getsockname()[1]
    loop = asyncio.get_running_loop()
    loop.run_in_executor(None, lambda: (sys.stdin.read(), loop.call_soon_threadsafe(stop.set)))
    await console.serve(listening, stop, lambda: print(port, flush=True))

with open_study(Path(sys.argv[1]), console_plan()) as store:
    listening = listen("127.0.0.1", 0)
    auth = ConsoleAuth(None)
    links = auth.links("127.0.0.1", listening.getsockname()[1])
    asyncio.run(serve(listening, Console(SessionService(store), auth, links, local=True)))
"""


@pytest.fixture(scope="module")
def server(tmp_path_factory) -> Iterator[Server]:
    folder = tmp_path_factory.mktemp("server")
    tests = (Path(module.__file__).parent for module in (study_console, test_bad_requests))
    words = (CONSOLE, str(folder), *map(str, tests))
    with started(words, folder, path="/link") as server:
        yield server
