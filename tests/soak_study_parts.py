"""The soak of a study without its pages: a stand-in for the teleoperation, and disturbances."""

from __future__ import annotations

import random
import threading
import time
from argparse import Namespace
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from fake_teleop import FakeSimulation
from soak_study_ledger import Ledger
from study_console import ConsoleProcess, eventually

from smooth_operator.errors import RemoteRefusedError
from smooth_operator.simulation.tasks.task import PAPER_TASKS
from smooth_operator.study.design.forms import DEFAULT_FORMS
from smooth_operator.study.design.plan import Plan, make_plan, scaled
from smooth_operator.study.design.plan_file import write_plan_files
from smooth_operator.study.design.protocol import Condition, Protocol
from smooth_operator.web.listening import listen

AT_MOST = 2  # withdrawals, and blocks that are ended early: each takes trials away


class StandIn:
    """Answers for a teleoperation with a simulated hand, at a ZeroMQ address."""

    def __init__(self, draw: random.Random) -> None:
        with listen("127.0.0.1", 0) as free:
            self.address = f"tcp://127.0.0.1:{free.getsockname()[1]}"
        self._draw, self._gone, self._ending = draw, threading.Event(), threading.Event()
        self.simulation = FakeSimulation("card")
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def restart(self) -> None:
        """Is gone for a moment, and comes back with whatever it is started with."""
        self._gone.set()
        eventually(lambda: not self._gone.is_set(), "the stand-in")

    def close(self) -> None:
        self._ending.set()
        self._thread.join(10.0)

    def _serve(self) -> None:
        import zmq

        context = zmq.Context()
        while not self._ending.is_set():
            socket = context.socket(zmq.REP)
            socket.setsockopt(zmq.LINGER, 0)
            socket.bind(self.address)
            while not (self._ending.is_set() or self._gone.is_set()):
                if socket.poll(50):
                    socket.send_json(self._answer(socket.recv_json()))
            socket.close()
            if self._gone.is_set():
                time.sleep(self._draw.uniform(0.0, 2.5))
                self.simulation = FakeSimulation(self._draw.choice(("card", "cube")))
                self._gone.clear()
        context.term()

    def _answer(self, said: dict[str, Any]) -> dict[str, Any]:
        simulation = self.simulation
        try:
            answer = simulation.request(said.pop("do"), **said)
            if simulation.trial["phase"] == "running" and said.get("begin"):
                simulation.trial["phase"] = self._draw.choice(("running", "waiting"))
            return answer
        except RemoteRefusedError as error:
            return {"ok": False, "error": str(error)}


class SoakBase:
    """A study, its console, a stand-in for the teleoperation, and what is to disturb it.

    Args:
        folder: for the study.
        options: of the command line.
        kinds: of disturbances.
    """

    def __init__(self, folder: Path, options: Namespace, kinds: Sequence[str]) -> None:
        self.draw = random.Random(options.seed)
        self.plan = study_plan(options.operators, options.seed)
        self.folder = folder / "study"
        self.folder.mkdir()
        write_plan_files(self.plan, self.folder)
        self.teleop = StandIn(random.Random(options.seed + 1))
        self.console = ConsoleProcess(self.folder, "--teleop", self.teleop.address)
        self.other: ConsoleProcess | None = None
        self.ledger = Ledger()
        self.done = Counter[str]()
        self.refusals = Counter[str]()
        self.replacements = self.count = 0
        self.waiting = list(self.plan.codes)
        self.seen: set[Any] = set()
        trials = sum(block.task.trials for block in self.plan.schedule())
        self.disturbances = drawn_disturbances(self.draw, kinds, options.disturbances, trials)

    def wrong(self) -> list[str]:
        """What was seen besides data that differ."""
        return []

    def close(self) -> None:
        """Ends everything."""
        for console in (self.console, self.other):
            if console is not None:
                console.end()
        self.teleop.close()


def study_plan(operators: int, seed: int) -> Plan:
    """The paper's design with so many operators."""
    conditions = tuple(map(Condition, ("sbr", "dexpilot", "hybrid", "geort")))
    protocol = Protocol("soak", conditions, PAPER_TASKS, "dexpilot", 18, familiarisation_s=60.0,
                        forms=DEFAULT_FORMS, seed=seed)  # fmt: skip
    return make_plan(scaled(protocol, operators))


def drawn_disturbances(
    draw: random.Random, kinds_known: Sequence[str], count: int, trials: int
) -> dict[int, str]:
    """Which trials are disturbed, by their order, and how."""
    kinds = [kinds_known[k % len(kinds_known)] for k in range(count)]
    draw.shuffle(kinds)
    few = Counter[str]()
    for k, kind in enumerate(kinds):
        few[kind] += kind in ("withdraw", "end block")
        if few[kind] > AT_MOST:
            kinds[k] = "kill"
    among = range(int(0.9 * trials))
    return dict(zip(draw.sample(among, min(count, len(among))), kinds, strict=False))
