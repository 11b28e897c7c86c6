"""What takes part in the soak of a study: a stand-in for the teleoperation, and a page."""

from __future__ import annotations

import random
import threading
import time
from collections import Counter
from typing import Any

from fake_teleop import FakeSimulation
from soak_study_ledger import Ledger
from study_console import Tab, eventually

from smooth_operator.errors import RemoteRefusedError
from smooth_operator.simulation.tasks.rubrics import PAPER_TASKS
from smooth_operator.study.console.commands import Command
from smooth_operator.study.design.default_forms import DEFAULT_FORMS
from smooth_operator.study.design.plan import Plan, make_plan, scaled
from smooth_operator.study.design.protocol import Condition, Protocol
from smooth_operator.web.listening import listen

KINDS = (
    "kill", "restart", "teleop", "wrong click", "undo", "amend", "void", "pause", "second page",
    "second console", "withdraw", "end block",
)  # fmt: skip
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


class Page(Tab):
    """A page's end of the WebSocket, whose words go into the ledger."""

    def __init__(self, port: int, role: str, ledger: Ledger) -> None:
        self.ledger = ledger
        super().__init__(port, role)

    def hear(self) -> dict[str, Any]:
        said = super().hear()
        if said["type"] in ("done", "refused"):
            self.ledger.heard(said)
        return said

    def send(self, asked: Command) -> None:
        self.ledger.asked(
            {"type": "command", "token": asked.token, "do": asked.do, "operator": asked.operator,
             "fields": dict(asked.fields)}
        )  # fmt: skip
        super().send(asked)


def study_plan(operators: int, seed: int) -> Plan:
    """The paper's design with so many operators."""
    conditions = tuple(map(Condition, ("sbr", "dexpilot", "hybrid", "geort")))
    protocol = Protocol("soak", conditions, PAPER_TASKS, "dexpilot", 18, familiarisation_s=60.0,
                        forms=DEFAULT_FORMS, seed=seed)  # fmt: skip
    return make_plan(scaled(protocol, operators))


def drawn_disturbances(draw: random.Random, count: int, trials: int) -> dict[int, str]:
    """Which trials are disturbed, by their order, and how."""
    kinds = [KINDS[k % len(KINDS)] for k in range(count)]
    draw.shuffle(kinds)
    few = Counter[str]()
    for k, kind in enumerate(kinds):
        few[kind] += kind in ("withdraw", "end block")
        if few[kind] > AT_MOST:
            kinds[k] = "kill"
    among = range(int(0.9 * trials))
    return dict(zip(draw.sample(among, min(count, len(among))), kinds, strict=False))
