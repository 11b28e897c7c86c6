"""Virtual operators: delay, crossover, hand, noise, determinism; and a plan that they do."""

import json
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from smooth_operator import Hand, Retargeter, load_hand
from smooth_operator.errors import ConfigError, StudyError
from smooth_operator.landmarks import TIPS
from smooth_operator.retargeting.known_gaps import MEDIAPIPE
from smooth_operator.simulation.scenes import ScenePhysics, scene_for
from smooth_operator.simulation.tasks.catalogue import TASKS
from smooth_operator.simulation.tasks.trial import Outcome
from smooth_operator.synthetic.tracker import TrackerModel, tracker_model
from smooth_operator_research.demonstrations.trial_loop import perform
from smooth_operator_research.study_simulation.run import (
    LOG,
    NOTICE,
    SimulationSettings,
    chunks,
    plan_for,
    simulate_chunk,
    simulate_study,
)
from smooth_operator_research.virtual_operator import (
    Familiar,
    OperatorTrial,
    draw_person,
    make_familiar,
    simulate_trial,
)
from smooth_operator_research.virtual_operator.hand_model import (
    GripReach,
    HandModel,
    HandPoints,
    InternalModel,
    ReachingHand,
    SeenTips,
    hand_model,
)
from smooth_operator_research.virtual_operator.operator import (
    CrossoverCorrection,
    DelayedView,
)
from smooth_operator_research.virtual_operator.person import (
    PHASE_MARGIN,
    MotorNoise,
    largest_crossover,
    movement_time,
)
from smooth_operator_research.virtual_operator.strategies import Closing, Observation
from smooth_operator_study.data import read_study
from smooth_operator_study.design.plan import Plan, make_plan
from smooth_operator_study.design.plan_file import write_plan
from smooth_operator_study.design.protocol import Condition, Protocol, Task

pytestmark = pytest.mark.weekly

STEP = 0.01
PERFECT = TrackerModel(rate_hz=30.0)
CARD_SCENE = scene_for("card", load_hand("mimic_p050", "right"))


def closed_loop(
    gain: float, delay: float, wanted: Callable[[float], float], seconds: float
) -> np.ndarray:
    """Where a plant that does what it is sent goes, with a person who only corrects (t,)."""
    view: DelayedView[float] = DelayedView(delay)
    correction = CrossoverCorrection(gain, 0.0, (1, 3), speed_limit=np.inf, reach_limit=np.inf)
    at, path = 0.0, []
    for k in range(round(seconds / STEP)):
        view.show(k * STEP, wanted(k * STEP) - at)
        error = view.latest(k * STEP)
        if error is not None:
            at = float(correction.update(np.array([[error, 0, 0]]), STEP)[0, 0])
        path.append(at)
    return np.array(path)


@pytest.mark.parametrize("delay", [0.1, 0.2, 0.28])
def test_a_step_is_answered_after_the_delay(delay):
    path = closed_loop(3.0, delay, lambda t: 0.01 * (t >= 1.0), 3.0)
    first = np.flatnonzero(path)[0] * STEP
    assert first == pytest.approx(1.0 + delay, abs=1.5 * STEP)
    slope = np.diff(path)[round(first / STEP) + 1] / STEP
    assert slope == pytest.approx(3.0 * 0.01, rel=1e-6)  # gain times error until it is seen to fall


def test_the_loop_crosses_over_at_its_gain():
    """With Y = w exp(-tau s) / s the closed loop is Y / (1 + Y); measured at some frequencies."""
    gain, delay = 3.0, 0.2
    for omega in (1.0, 3.0, 5.0):
        seconds = 2 * np.pi / omega * 12
        path = closed_loop(gain, delay, lambda t, w=omega: 0.01 * np.sin(w * t), seconds)
        times = STEP * np.arange(len(path))
        late = times > seconds / 2
        basis = np.stack([np.sin(omega * times), np.cos(omega * times)], axis=1)[late]
        sine, cosine = np.linalg.lstsq(basis, path[late], rcond=None)[0]
        open_loop = gain * np.exp(-1j * omega * delay) / (1j * omega)
        expected = 0.01 * open_loop / (1 + open_loop)
        assert complex(sine, cosine) == pytest.approx(expected, rel=0.06)
    assert abs(gain * np.exp(-1j * gain * delay) / (1j * gain)) == pytest.approx(1.0)


def test_correction_has_its_limits_and_threshold():
    correction = CrossoverCorrection(3.0, 0.002, (1, 3))
    assert not correction.update(np.array([[0.0019, 0, 0]]), 1.0).any()
    one = correction.update(np.array([[1.0, 0, 0]]), 0.1)
    assert one[0, 0] == pytest.approx(0.010)  # 0.1 m/s
    assert correction.update(np.array([[1.0, 0, 0]]), 10.0)[0, 0] == pytest.approx(0.015)


def test_persons_differ_by_seed_and_keep_their_phase_margin():
    persons = [draw_person(k, 3) for k in range(200)]
    again = draw_person(7, 3)
    assert again.delay_s == persons[7].delay_s
    assert np.array_equal(again.map_error, persons[7].map_error)
    assert draw_person(7, 4).delay_s != again.delay_s
    delays = np.array([person.delay_s for person in persons])
    assert delays.mean() == pytest.approx(0.2, abs=0.006)
    assert len(np.unique(delays)) > 150
    for person in persons:
        assert person.crossover <= largest_crossover(person.delay_s)
        margin = np.pi / 2 - person.crossover * person.delay_s
        assert margin >= PHASE_MARGIN
        assert np.abs(person.bone_factors - 1).max() <= 0.1 + 1e-9
    practised = [persons[0].practised(n) for n in (0, 5, 50)]
    assert practised[0] == 1.0 > practised[1] > practised[2] > 0
    with pytest.raises(ConfigError, match="0 or more"):
        draw_person(-1)


def test_fitts_law_with_lag():
    assert movement_time(0.07, 0.01, 0.0) == pytest.approx(0.230 + 0.169 * 3)
    assert movement_time(0.07, 0.01, 0.1) - movement_time(0.07, 0.01, 0.0) == pytest.approx(0.309)


def test_tremor_is_in_its_band_and_noise_grows_with_the_movement():
    noise = MotorNoise(0.0, 1e-4, 5, np.random.default_rng(0))
    still = np.zeros((5, 3))
    path = np.array([noise.update(k / 200, still, 1 / 200) for k in range(2000)])
    assert np.sqrt((path**2).mean()) == pytest.approx(1e-4, rel=0.1)
    power = (np.abs(np.fft.rfft(path, axis=0)) ** 2).sum(axis=(1, 2))
    hertz = np.fft.rfftfreq(len(path), 1 / 200)
    assert power[(hertz >= 7.5) & (hertz <= 12.5)].sum() > 0.95 * power.sum()

    def spread(length: float) -> float:
        ends = []
        for seed in range(60):
            noise = MotorNoise(0.05, 0.0, 5, np.random.default_rng(seed))
            for k in range(30):
                end = noise.update(k * STEP, np.full((5, 3), length / 30 / np.sqrt(3)), STEP)
            ends.append(end)
        return float(np.std(ends))

    assert spread(0.06) == pytest.approx(2 * spread(0.03), rel=1e-6)
    assert 0.01 < spread(0.06) / 0.06 < 0.1


def test_fast_kinematics_agree_with_the_hands_own():
    for name in ("mimic_p050", "allegro_hand"):
        hand = load_hand(name, "right")
        q = np.random.default_rng(1).uniform(*hand.limits.T)
        points, jacobian = HandPoints(hand, hand.tree.names).at(q)
        assert np.allclose(points, hand.landmark_positions(q), atol=1e-9)
        step = 1e-6
        for joint in range(len(q)):
            nudge = step * np.eye(len(q))[joint]
            slope = (hand.landmark_positions(q + nudge) - hand.landmark_positions(q - nudge)) / (
                2 * step
            )
            assert np.allclose(jacobian[..., joint], slope, atol=1e-6)
    hand = load_hand("mimic_p050", "right")
    physics = ScenePhysics(hand, scene_for("cube", hand))
    assert np.allclose(SeenTips(physics).read(), hand.tips(physics.positions), atol=1e-9)


@pytest.mark.parametrize("body", ["matched", "human"])
def test_the_hand_reaches_what_it_can_and_keeps_its_bones(body):
    person, hand = draw_person(2), load_hand("mimic_p050", "right")
    model = hand_model(person, hand, body)
    goal = model.landmarks(model.relaxed + 0.2 * (model.upper - model.relaxed))[0][list(TIPS)]
    own = ReachingHand(model)
    before = own.landmarks
    points = own.reach(goal, np.inf, rounds=60)
    assert np.linalg.norm(points[list(TIPS)] - goal, axis=1).max() < 5e-4
    bones = [np.linalg.norm(np.diff(p[5:9], axis=0), axis=1) for p in (before, points)]
    assert np.allclose(*bones, atol=2e-4)  # a robot's joints are a little off its landmarks
    slow = ReachingHand(model)
    slow.reach(goal, 0.001, rounds=5)
    assert np.abs(slow.angles - model.relaxed).max() <= 0.015 + 1e-12


def test_a_person_learns_where_to_put_a_finger():
    """A retargeter that scales and shifts is learnt exactly; one that bends, locally."""
    rng = np.random.default_rng(0)
    own = rng.uniform(-0.05, 0.05, (400, 5, 3))
    model = InternalModel(1.2 * own + 0.01, own, list(range(5)))
    wanted = rng.uniform(-0.04, 0.04, (5, 3))
    assert np.allclose(model.own_tips(1.2 * wanted + 0.01), wanted, atol=1e-4)
    bent = own + 4 * own**2
    model = InternalModel(bent, own, list(range(5)))
    error = np.linalg.norm(model.own_tips(wanted + 4 * wanted**2) - wanted, axis=1)
    assert error.max() < 0.005


def test_a_person_learns_how_the_robot_moves_behind_a_tracker():
    """Behind a camera that shows no contact, the robot's pinch needs a closer one of one's own."""
    retargeter = Retargeter(load_hand("mimic_p050", "right"), method="geort")
    gaps = TrackerModel(pinch_gaps=(0.3, 0.3, 0.3, 0.3))
    tips = retargeter.hand.tips(retargeter.hand.full_configuration(retargeter.hand.neutral))
    tips[1] = tips[0] + (0.0, 0.0, 0.01)
    apart = []
    for tracker in (TrackerModel(), gaps):
        own = make_familiar(draw_person(0), retargeter, tracker).model.own_tips(tips)
        apart.append(np.linalg.norm(own[1] - own[0]))
    assert apart[1] < apart[0] - 0.001


def test_closing_fingers_stop_where_they_are_seen_to_touch():
    wide = {0: np.array([0.0, 0.0, 0.0]), 1: np.array([0.06, 0.0, 0.0])}
    inward = {0: np.array([1.0, 0.0, 0.0]), 1: np.array([-1.0, 0.0, 0.0])}
    closing = Closing(wide, inward, press=0.002)
    assert np.allclose(closing(0.0, seen_touching())[0], 0.0)
    early = closing(0.5, seen_touching())
    assert 0.0 < early[0][0] < closing(1.0, seen_touching())[0][0]
    assert not closing.complete
    touched = closing(1.0, seen_touching(0))  # the tip is seen at 12 mm
    assert touched[0][0] == pytest.approx(0.012 + 0.002)
    assert closing(1.0, seen_touching())[0][0] == pytest.approx(0.014)  # and it stays there
    assert not closing.complete
    closing(1.0, seen_touching(1))
    assert closing.complete
    assert closing.pressed(-0.001)[1][0] == pytest.approx(0.012 + 0.001)


def seen_touching(*fingers: int) -> Observation:
    """Both fingertips at 12 mm; some of them touch."""
    force = np.zeros(5)
    force[list(fingers)] = 1.0
    state = ScenePhysics(load_hand("mimic_p050", "right"), CARD_SCENE).observe()
    tips = np.tile([0.012, 0.0, 0.0], (5, 1))
    return Observation(replace(state, force=force), None, tips, tips)


def test_strokes_turn_towards_the_goal_and_no_further():
    hand = load_hand("mimic_p050", "right")
    scene = scene_for("cube", hand)
    reach, centre = GripReach(hand, scene), scene.start[0] + np.array([0.0, 0.0, 0.01])
    faces = np.radians([0.0, 90.0, 180.0, 270.0])
    for way in (1.0, -1.0):
        stroke = reach.turn(centre, faces, way, np.radians(20.0), 0.024, 0.039)
        if stroke is not None:
            _, start, end = stroke
            assert way * (end - start) == pytest.approx(np.radians(20.0), abs=np.radians(15.1))
            assert 0 < way * (end - start) <= np.radians(20.0) + 1e-9
    finger, start, end = reach.turn(centre, faces, 0.0, np.pi / 2, 0.024, 0.039)
    assert abs(end - start) > np.radians(30.0)
    n = 0.024 * np.array([np.cos(end), np.sin(end), 0.0])
    assert reach.off({0: centre - n, finger: centre + n}) < 0.005
    assert reach.turn(centre + np.array([0.3, 0.0, 0.0]), faces, 0.0, 1.0, 0.024, 0.039) is None


class ExactMap:
    """Where the own fingertips of a hand of the robot's shape go, without anything to learn."""

    def __init__(self, body: HandModel, hand: Hand) -> None:
        q = np.random.default_rng(0).uniform(*hand.limits.T, (40, len(hand.limits)))
        own = np.array([body.landmarks(one)[0][list(TIPS)] for one in q]).reshape(-1, 3)
        robot = hand.tips(hand.full_configuration(q)).reshape(-1, 3)
        self._map = np.linalg.lstsq(np.c_[robot, np.ones(len(robot))], own, rcond=None)[0]

    def own_tips(self, robot: np.ndarray) -> np.ndarray:
        return np.asarray(np.c_[robot, np.ones(len(robot))] @ self._map)


def exact_person() -> Familiar:
    """A person who has the robot's hand, and makes no errors; only vision is delayed."""
    retargeter = Retargeter(load_hand("mimic_p050", "right"), method="keyvector")
    person = replace(
        draw_person(0),
        bone_factors=np.ones((5, 3)),
        map_error=np.zeros((5, 3)),
        motor_noise=0.0,
        tremor_m=0.0,
        pace=1.0,
        crossover=1e-9,
    )
    body = hand_model(person, retargeter.hand)
    return Familiar(person, retargeter, body, ExactMap(body, retargeter.hand))


def test_a_person_without_errors_does_the_tasks():
    person = exact_person()
    cube = simulate_trial(person, TASKS["cube"], tracker=PERFECT, seconds=40.0)
    assert cube.outcome.score == 1.0, cube
    assert cube.outcome.seconds > 5.0  # in several strokes
    screwdriver = simulate_trial(person, TASKS["screwdriver"], tracker=PERFECT)
    assert screwdriver.outcome.score >= 0.5, screwdriver
    assert screwdriver.outcome.ended in ("finished", "success")


def test_a_person_who_misjudges_by_centimetres_does_not():
    person = exact_person()
    lost = replace(person, person=replace(person.person, map_error=np.full((5, 3), 0.03)))
    trial = simulate_trial(lost, TASKS["cube"], tracker=PERFECT, seconds=8.0)
    assert trial.outcome.score == 0.0


def test_frames_of_a_person_come_late_and_at_the_trackers_rate():
    person = exact_person()
    trials = [
        simulate_trial(person, TASKS["cube"], tracker=tracker, seconds=4.0, trace=True).trace
        for tracker in (PERFECT, replace(PERFECT, delay=0.1), tracker_model("headset"))
    ]
    seen = [np.flatnonzero(np.isfinite(trial.landmarks[:, 0, 0])) for trial in trials]
    for frames in seen:
        assert len(frames) == pytest.approx(120, abs=3)
    soon, late = (
        trial.landmarks[frames] for trial, frames in zip(trials[:2], seen[:2], strict=True)
    )
    # The person begins before anything is seen of the hand: the same frame, 10 periods later.
    np.testing.assert_array_equal(seen[0][:5] + 10, seen[1][3:8])
    np.testing.assert_allclose(soon[:3], late[3:6], atol=1e-9)


def test_an_operator_is_granted_one_reset_and_may_stop():
    hand = load_hand("mimic_p050", "right")
    wishes = iter(["reset", None, "reset", None, "finish"])
    physics = ScenePhysics(hand, CARD_SCENE)
    hold = hand.full_configuration(hand.neutral)
    moments = list(
        perform(
            physics, TASKS["card"], lambda *_: hold, interventions=lambda: next(wishes), seconds=1.0
        )
    )
    assert [moment.run.resets for moment in moments] == [1] * 5
    assert physics.starts == 2
    outcome = moments[-1].run.outcome
    assert outcome.ended == "finished"
    assert outcome.resets == 1


def small_plan(**changes: object) -> Plan:
    """Two people, two trials with each of two quick methods."""
    conditions = (Condition("joint_angle"), Condition("geort"))
    task = Task("B", trials=2, time_limit_s=1.0)
    settings = {"operators": 2, "questionnaires": ("initial", "final"), "rate_hz": 30.0, **changes}
    return make_plan(Protocol("small", conditions, (task,), "geort", **settings))


def test_the_plan_is_done_by_so_many(tmp_path):
    plan = small_plan()
    assert plan_for(plan, None) is plan
    assert len(plan_for(plan, 6).codes) == 6
    for wrong in (0, -1, 1001):
        with pytest.raises(StudyError, match="from 1 to 1000"):
            plan_for(plan, wrong)
    with pytest.raises(StudyError, match="--operators"):
        plan_for(replace(plan, enrolled=()), None)
    done = [trial for chunk in chunks(SimulationSettings(plan)) for trial in chunk.trials]
    assert len(done) == 2 * 2 * 2


@pytest.mark.parametrize("kind", ["camera", "headset"])
def test_a_study_is_behind_its_tracker_at_the_rate_of_the_plan(monkeypatch, kind):
    """And its retargeters know the gaps of a webcam, as in ``teleop``."""
    seen = []

    def note(familiar: Familiar, *_: object, tracker: TrackerModel, **__: object) -> OperatorTrial:
        seen.append((familiar.retargeter.known_gaps, tracker))
        return OperatorTrial(Outcome(0.0, "", 1.0, "time", "", 0), 1, 1, 0)

    monkeypatch.setattr("smooth_operator_research.study_simulation.run.simulate_trial", note)
    simulate_chunk(next(iter(chunks(SimulationSettings(small_plan(rate_hz=20.0), tracker=kind)))))
    gaps, tracker = seen[0]
    assert gaps == (MEDIAPIPE if kind == "camera" else {})
    assert tracker == replace(tracker_model(kind), rate_hz=20.0)


@pytest.mark.parametrize(
    ("conditions", "task", "message"),
    [
        (("nothing", "geort"), "B", "condition 'nothing'.*unknown method"),
        (("smooth=smooth:offline", "geort"), "B", "whole recording"),
        (("sbr", "geort"), "peel", "task 'peel' of the plan can't be simulated"),
    ],
)
def test_what_cannot_be_simulated_is_named(conditions, task, message):
    made = tuple(Condition.of(text) for text in conditions)
    plan = make_plan(Protocol("wrong", made, (Task(task, trials=3),), "geort", operators=2))
    with pytest.raises(StudyError, match=message):
        SimulationSettings(plan)


def test_a_stopped_simulation_goes_on_and_analyze_reads_it(tmp_path, monkeypatch):
    settings = SimulationSettings(small_plan())
    calls = []

    def counted(chunk: object) -> object:
        if len(calls) == 2:
            raise KeyboardInterrupt
        calls.append(chunk)
        return simulate_chunk(chunk)

    monkeypatch.setattr("smooth_operator_research.study_simulation.run.simulate_chunk", counted)
    with pytest.raises(KeyboardInterrupt):
        simulate_study(settings, tmp_path, workers=0)
    lines = (tmp_path / LOG).read_bytes().splitlines()
    assert len(lines) == 2
    assert not (tmp_path / "trials.csv").exists()
    (tmp_path / LOG).write_bytes(b"\n".join(lines) + b'\n{"half')  # as a kill leaves it
    done = len(calls)
    calls[:] = [None] * -1000
    monkeypatch.setattr(
        "smooth_operator_research.study_simulation.run.simulate_chunk",
        lambda chunk: calls.append(chunk) or simulate_chunk(chunk),
    )
    rows = simulate_study(settings, tmp_path, workers=0)
    assert len(calls) == 4 - done
    # The same seed gives the same trials, whoever computes them.
    again = simulate_chunk(next(iter(chunks(settings))))
    for row, other in zip(rows, again, strict=False):
        assert {name: row[name] for name in other} == other
    about = json.loads((tmp_path / "simulation.json").read_text(encoding="utf-8"))
    assert about["simulated"] is True
    assert about["notice"] == NOTICE
    data = read_study([tmp_path])
    assert len(data.trials) == 8
    assert all(str(code).startswith("simulated-") for code in data.trials.operator)
    assert any("8 of 8 questionnaires have a missing answer" in note for note in data.notes)


def test_the_command_says_what_it_is_and_what_is_wrong(tmp_path):
    def command(*words: str) -> subprocess.CompletedProcess[str]:
        line = [sys.executable, "-m", "smooth_operator", "study", "simulate", *words]
        return subprocess.run(line, capture_output=True, text=True, timeout=1200, check=False)

    lost = command(str(tmp_path / "nothing"))
    assert lost.returncode == 2
    assert "study new" in lost.stderr
    write_plan(small_plan(), tmp_path / "study.toml")
    many = command(str(tmp_path), "--operators", "0")
    assert many.returncode == 2
    assert "from 1 to 1000" in many.stderr
