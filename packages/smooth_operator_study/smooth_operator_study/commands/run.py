"""``smooth-operator study run``: opens a study and serves its console until Ctrl-C."""

from __future__ import annotations

import asyncio
import functools
import socket
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from smooth_operator.errors import ConfigError
from smooth_operator.signals import Ending, ended_by_signals
from smooth_operator.terminal import print_note
from smooth_operator.web.addresses import is_local
from smooth_operator.web.browser import open_page
from smooth_operator.web.listening import listen
from smooth_operator_study.commands.options import Run
from smooth_operator_study.console.server import Console, auth_for
from smooth_operator_study.console.session_service import SessionService
from smooth_operator_study.console.switching import Teleop
from smooth_operator_study.design.plan import Plan
from smooth_operator_study.design.plan_file import (
    NAME,
    read_plan,
    write_plan_files,
)
from smooth_operator_study.store.nasa_tlx import ENGLISH, read_words
from smooth_operator_study.store.study_store import FILE, StudyStore, open_study


def run_study(options: Run) -> None:
    """Serves the pages of a study until Ctrl-C."""
    teleop = _teleop(options.teleop)
    folder = _folder(options.study)
    with _listening(options) as listening, _opened(folder) as store:
        port = int(listening.getsockname()[1])
        protocol = store.plan.protocol
        auth = auth_for(options.host, protocol.name)
        links = auth.links(options.host, port)
        service = SessionService(
            store,
            operator=options.operator,
            blind=options.blind,
            teleop=teleop,
            words=read_words(folder / language) if (language := protocol.tlx_language) else ENGLISH,
            enrolled=lambda plan: _write_plan(plan, folder),
            changed=lambda: console.changed(),
            report=print_note,
        )
        console = Console(service, auth, links, local=is_local(options.host))

        def ready() -> None:
            print_note(f"study {protocol.name!r}, for the experimenter: {links['experimenter']}")
            print_note(f"for the operator's tablet: {links['operator']}")
            print_note("press Ctrl-C to stop; no data is lost")
            if options.open:
                open_page(links["experimenter"])

        with ended_by_signals() as ending:
            asyncio.run(_serve(console, listening, ready, ending))


async def _serve(
    console: Console, listening: socket.socket, ready: Callable[[], None], ending: Ending
) -> None:
    stop = asyncio.Event()
    ending.quit = functools.partial(asyncio.get_running_loop().call_soon_threadsafe, stop.set)
    try:
        await console.serve(listening, stop, ready)
    finally:
        ending.quit = None


def _listening(options: Run) -> socket.socket:
    try:
        return listen(options.host, options.port)
    except (OSError, OverflowError) as error:
        why = getattr(error, "strerror", None) or error
        raise ConfigError(
            f"can't listen on {options.host!r} port {options.port}: {why}; choose another "
            "--port, or use --host 127.0.0.1 for this machine only or --host 0.0.0.0 for "
            "its networks"
        ) from error


def _opened(folder: Path) -> StudyStore:
    """Opens the store with all operators of the stored plan and of the plan in the folder."""
    file = folder / NAME
    if not file.is_file():
        if not (folder / FILE).is_file():
            raise ConfigError(
                f"there is no study in {folder}: {NAME} is missing; create it with "
                "smooth-operator study new"
            )
        return open_study(folder)
    plan = read_plan(file)
    if not (folder / FILE).is_file():
        return open_study(folder, plan)
    store = open_study(folder)
    try:
        # An operator who was enrolled on a page is missing in a file that could not be written.
        stored, erased = store.plan, store.erased
        new = [one for one in plan.enrolled if one.code not in (*stored.codes, *erased)]
        store.revise(replace(plan, enrolled=(*stored.enrolled, *new)))
    except BaseException:
        store.close()
        raise
    return store


def _folder(study: str) -> Path:
    path = Path(study)
    if not path.exists():
        raise ConfigError(
            f"there is no study at {study}; create one with smooth-operator study new"
        )
    return path if path.is_dir() else path.parent


def _write_plan(plan: Plan, folder: Path) -> None:
    """Writes the files of a plan that was changed on a page."""
    if (folder / NAME).is_file():
        write_plan_files(plan, folder)


def _teleop(address: str | None) -> Teleop | None:
    if address is None:
        return None
    from smooth_operator.teleop.runtime.remote_client import RemoteTeleop

    return RemoteTeleop(address, timeout_s=2.0)
