"""The scene, the trials and the clock of a study in simulation follow the protocol."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from fake_teleop import FakeSimulation
from study_console import command, console_plan, give, walk

from smooth_operator.cli import main
from smooth_operator.errors import StudyError
from smooth_operator.simulation.tasks.catalogue import TASKS
from smooth_operator.simulation.tasks.task import GENERAL_RUBRIC, RubricLine
from smooth_operator_study.console.session_service import Command, SessionService
from smooth_operator_study.design.plan import Plan, make_plan
from smooth_operator_study.design.plan_file import read_plan
from smooth_operator_study.store.study_store import StudyStore, open_study


def two_tasks(**changes: Any) -> Plan:
    """The plan of the console's tests, with free movement, and with the cube as a second task."""
    protocol = console_plan().protocol
    card = replace(protocol.tasks[0], **changes)
    cube = replace(card, name="cube", time_limit_s=None)
    return make_plan(
        replace(protocol, tasks=(card, cube), familiarisation_s=60.0, task_order="listed")
    )


@pytest.fixture
def store(tmp_path: Path) -> Iterator[StudyStore]:
    with open_study(tmp_path, two_tasks()) as made:
        yield made


@pytest.fixture
def simulation() -> FakeSimulation:
    return FakeSimulation()


@pytest.fixture
def service(store: StudyStore, simulation: FakeSimulation) -> SessionService:
    """A session of the first operator."""
    return SessionService(store, operator="P01", teleop=simulation)


def due(store: StudyStore, do: str, operator: str = "P01", **fields: Any) -> Command:
    return command(store.progress(operator), do, **fields)


def begun(simulation: FakeSimulation) -> list[tuple[str | None, int]]:
    """Scene and number of the trials that began."""
    asked = (fields for do, fields in simulation.asked if do == "trial" and fields.get("begin"))
    return [(fields["about"]["task"], fields["about"]["trial"]) for fields in asked]


def test_a_trial_has_its_scene_after_a_restart_with_another(service, simulation):
    walk(service, "trial")
    give(service, "score", line="done")
    walk(service, "start_trial")
    simulation.task = "screwdriver"  # started again, as the guide gives the command
    simulation.trial["phase"] = "ready"
    give(service, "start_trial")
    assert simulation.task == "card"
    assert begun(simulation)[-1] == ("card", 2)
    assert simulation.trial["phase"] == "running"


def test_between_trials_the_scene_is_watched(service, simulation):
    walk(service, "start_trial")
    simulation.task = "cube"
    service.watch()
    assert simulation.task == "card"
    assert service.look()[0]["teleop"]["scene"] == "card"


def test_back_at_an_operator_in_mid_block_their_scene_is_there(simulation, store):
    service = SessionService(store, operator="P02", teleop=simulation)
    walk(service, "start_block", "cube")
    service = SessionService(store, operator="P01", teleop=simulation)
    walk(service, "trial")
    give(service, "score", line="done")
    choose = Command("c" * 16, "choose", "P02", None, {})
    service.carry_out(choose, "experimenter")
    walk(service, "start_trial", "cube")
    assert simulation.task == "cube"
    service.carry_out(replace(choose, token="d" * 16, operator="P01"), "experimenter")
    walk(service, "start_trial")
    give(service, "start_trial")
    assert (simulation.task, begun(simulation)[-1]) == ("card", ("card", 2))


def test_before_the_first_trial_of_a_block_there_is_no_object(service, simulation):
    walk(service, "familiarise")
    assert (simulation.task, simulation.there) == ("card", False)
    simulation.there = True  # started again
    service.watch()
    assert not simulation.there
    walk(service, "trial")
    assert simulation.there
    give(service, "score", line="done")
    service.watch()
    assert simulation.there


def test_a_console_that_is_started_again_leaves_the_hand_alone(simulation, store):
    walk(SessionService(store, operator="P01", teleop=simulation), "trial")
    simulation.done("done", 1.0, 12.25)
    written, asked = store.records("P01"), len(simulation.asked)
    service = SessionService(store, teleop=simulation)
    service.watch()
    assert {do for do, _ in simulation.asked[asked:]} <= {"status", "trial"}
    assert store.records("P01") == written
    assert service.look()[0]["teleop"]["trial"]["time_s"] == 12.25  # and knows its trial
    give(service, "score", line="done")
    assert store.progress("P01").trials[-1].time_s == 12.25


def test_a_start_that_is_undone_ends_the_trial_of_the_simulation(service, simulation, store):
    for end, marked in ((lambda: None, 0), (lambda: simulation.done("done", 1.0, 3.0), 1)):
        walk(service, "trial")
        end()
        last = store.progress("P01").undoable
        give(service, "undo", number=last.number)
        assert simulation.trial["phase"] != "running"
        assert len(simulation.marked) == marked
    assert simulation.marked[0][0] == "undone"
    walk(service, "trial")
    simulation.done("done", 1.0, 3.0)
    give(service, "void", reason="tracker")
    assert [word for word, _ in simulation.marked] == ["undone", "void"]


def test_a_line_after_a_reset_needs_one(tmp_path):
    rubric = TASKS["card"].task.rubric
    with open_study(tmp_path, two_tasks(rubric=rubric)) as store:
        service = SessionService(store, operator="P01")
        walk(service, "trial")

        def possible() -> dict[str, bool]:
            lines = service.look()[0]["now"]["rubric"]
            return {line["name"]: line["possible"] for line in lines}

        assert possible()["no-edge"]
        assert not possible()["done-after-reset"]
        score = due(store, "score", line="done-after-reset")
        with pytest.raises(StudyError, match="needs a reset, and this trial had none"):
            service.carry_out(score, "experimenter")
        give(service, "reset")
        assert possible()["done-after-reset"]
        assert not possible()["done"]
        give(service, "score", line="done-after-reset")
        assert store.progress("P01").trials[-1].score == 0.5


def test_plans_of_scenes_have_their_rubric_and_limit(tmp_path):
    main(["study", "new", str(tmp_path / "study"), "--tasks", "card:4", "A:4", "lift:4"])
    card, paper, other = read_plan(tmp_path / "study" / "study.toml").protocol.tasks
    assert (card.time_limit_s, card.trials) == (60.0, 4)
    assert card.rubric == paper.rubric == TASKS["card"].task.rubric
    assert paper.time_limit_s is None  # the paper's; in simulation the scene's is used
    assert other.rubric == GENERAL_RUBRIC


def test_a_rubric_that_contradicts_the_scene_is_refused(tmp_path):
    rubric = (
        RubricLine("done", 1.0, "as instructed"),
        RubricLine("done-after-reset", 0.0, "too late"),
        RubricLine("failed", 0.0, "dropped"),
    )
    with open_study(tmp_path, two_tasks(rubric=rubric)) as store:
        service = SessionService(store, operator="P01", teleop=FakeSimulation())
        with pytest.raises(StudyError, match=r"done-after-reset.*0 in the plan and 0\.5 in the"):
            walk(service, "trial")
