"""Operators walked through a study by many processes at once, for tests; run as a script.

Forks writers that write event after event to one store and note each acknowledged number in a file
of their own. As a script of its own it forks before anything starts a thread, and imports little.
"""

import os
import random
import signal
import sys
import time
from pathlib import Path

from smooth_operator_study.design.plan import Plan, make_plan
from smooth_operator_study.design.protocol import Condition, Protocol, Task
from smooth_operator_study.store.events import (
    BlockStarted,
    BreakEnded,
    Calibrated,
    Event,
    FamiliarisationEnded,
    FamiliarisationStarted,
    Noted,
    QuestionnaireAnswered,
    TrialReset,
    TrialScored,
    TrialStarted,
)
from smooth_operator_study.store.nasa_tlx import SCALE_NAMES
from smooth_operator_study.store.progress import Progress
from smooth_operator_study.store.study_store import StudyStore, open_study

STUDY = "twenty"


def notes(progress: Progress) -> list[str]:
    """Texts of the notes in the log."""
    events = (record.event for record in progress.effective)
    return [event.text for event in events if isinstance(event, Noted)]


def small_plan(operators: int = 20) -> Plan:
    conditions = tuple(Condition(name) for name in ("sbr", "dexpilot", "hybrid"))
    tasks = (Task("A", trials=3), Task("B", trials=3))
    return make_plan(Protocol(STUDY, conditions, tasks, "dexpilot", operators))


def due(progress: Progress, rng: random.Random) -> Event | None:
    """Something that may happen now; None where the operator is done."""
    step = progress.step
    if step.what == "break":
        return BreakEnded()
    if step.block is None:
        return None
    block, task, number = step.block, step.block.task.name, step.block.number
    trial = step.trial or 0
    if step.what == "calibrate":
        return Calibrated(task)
    if step.what == "start_block":
        return BlockStarted(task, number, block.condition.name)
    if step.what == "start_familiarisation":
        return FamiliarisationStarted(task, number)
    if step.what == "familiarise":
        return FamiliarisationEnded(task, number)
    if step.what == "start_trial":
        return TrialStarted(task, number, trial)
    if step.what == "trial":
        running = progress.running
        if not running.resets and rng.random() < 0.2:
            return TrialReset(task, number, trial)
        line = rng.choice(block.task.rubric).name
        seconds = round(rng.uniform(5, 60), 2)
        return TrialScored(task, number, trial, line, progress.capped(line), seconds)
    assert step.what == "questionnaire"
    ratings = {name: 5 * rng.randint(0, 20) for name in SCALE_NAMES}
    return QuestionnaireAnswered(task, number, step.point, ratings)


def walk(store: StudyStore, operator: str, until: str = "done", seed: int = 1) -> None:
    """Appends events until a step is due."""
    rng = random.Random(seed)
    while (progress := store.progress(operator)).step.what != until:
        event = due(progress, rng)
        assert event is not None, f"done before {until}"
        store.append(operator, event)


def write(target: str, operator: str, most: int, acknowledged: Path, seed: int) -> None:
    """Appends that many events, or all that are left."""
    rng = random.Random(seed)
    with open_study(target) as store, acknowledged.open("a") as file:
        for _ in range(most):
            event = due(store.progress(operator), rng)
            if event is None:
                return
            record = store.append(operator, event)
            file.write(f"{record.number} {event.kind}\n")
            file.flush()


def fork_writer(
    target: str, operator: str, most: int, folder: Path, seed: int, waits: bool = False
) -> int:
    child = os.fork()
    if child:
        return child
    try:
        write(target, operator, most, folder / f"{operator}.txt", seed)
        while waits:
            time.sleep(60.0)
    except BaseException as error:
        print(f"{operator}: {type(error).__name__}: {error}", file=sys.stderr, flush=True)
        os._exit(1)
    os._exit(0)


def main(what: str, target: str, folder: str, count: int, most: int) -> None:
    """``together``: that many operators at once. ``killed``: one, killed that many times.

    Who is to be killed waits for it after its events.
    """
    codes = small_plan().codes
    if what == "together":
        made = [
            fork_writer(target, codes[k % len(codes)], most, Path(folder), k) for k in range(count)
        ]
        sys.exit(any(os.waitpid(child, 0)[1] for child in made))
    rng = random.Random(5)
    notes = Path(folder) / f"{codes[0]}.txt"
    notes.touch()
    kills = 0
    while kills < count:
        size = notes.stat().st_size
        child = fork_writer(target, codes[0], most, Path(folder), kills, waits=True)
        while notes.stat().st_size == size and os.waitpid(child, os.WNOHANG)[0] == 0:
            time.sleep(0.001)
        time.sleep(10 ** rng.uniform(-4.0, -1.5))  # on quick machines and slow ones in an event
        os.kill(child, signal.SIGKILL)
        kills += os.WIFSIGNALED(os.waitpid(child, 0)[1])


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], sys.argv[3], int(sys.argv[4]), int(sys.argv[5]))
