"""The paper's experiments: solvers, statistics, verdicts, resuming, and what is written."""

from __future__ import annotations

import dataclasses
import json
import typing
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from trees import float64

from smooth_operator.ablations import study as study_module
from smooth_operator.ablations.bootstrap import Estimate, contrast, mean_of, pooled
from smooth_operator.ablations.catalogue import EXPERIMENTS, experiment
from smooth_operator.ablations.compute import balance
from smooth_operator.ablations.contestants import (
    Contestant,
    Newton,
    Rmsprop,
    Sampling,
    Slsqp,
    Starts,
)
from smooth_operator.ablations.grid import Point, contours
from smooth_operator.ablations.hessian import hessians, projected_jitter
from smooth_operator.ablations.lineup import make_lineup
from smooth_operator.ablations.problems import Problem, unbroken
from smooth_operator.ablations.rmsprop import RmspropConfig, rmsprop_minimise
from smooth_operator.ablations.runs import Run, measure_run, run_contestant
from smooth_operator.ablations.sizes import QUICK, Size
from smooth_operator.ablations.starts import scattered_starts, soft_mean
from smooth_operator.ablations.store import Store
from smooth_operator.ablations.study import TUNING_OPERATOR, Study
from smooth_operator.ablations.suite import (
    SIZES,
    Settings,
    load_recordings,
    run_experiments,
)
from smooth_operator.ablations.verdicts import (
    both,
    judge_direction,
    judge_effect,
    judge_equality,
)
from smooth_operator.cli import main
from smooth_operator.cli.ablate_options import ExperimentName
from smooth_operator.errors import ConfigError, RecordingError, UnknownNameError
from smooth_operator.objective.loss import FrameGoal
from smooth_operator.solvers.normals import seed_words
from smooth_operator.solvers.sampling import SamplingConfig, sample_minimise

OURS = ("solver", "velocity", "hessian", "compute")

TINY = dataclasses.replace(
    QUICK,
    name="tiny",
    recordings=("synthetic:0@200:", "synthetic:1@700:"),
    frames=14,
    samples=64,
    cycles=4,
    rmsprop_starts=3,
    slsqp_starts=2,
    newton_starts=2,
    steps=(0.003, 0.03),
    sigmas=(0.1, 0.2),
    tuning_frames=10,
    grid_samples=(32, 64, 128),
    grid_cycles=(2, 4, 8),
    grid_budget=256,
    grid_frames=12,
)


@pytest.fixture(scope="module", autouse=True)
def tiny() -> Iterator[Size]:
    SIZES["tiny"] = TINY
    yield TINY
    del SIZES["tiny"]


@pytest.fixture(scope="module")
def settings(tmp_path_factory: pytest.TempPathFactory) -> Settings:
    folder = tmp_path_factory.mktemp("ablations") / "out"
    return Settings(output=folder, experiments=OURS, size="tiny")


@pytest.fixture(scope="module")
def outcomes(settings: Settings) -> dict[str, typing.Any]:
    return dict(run_experiments(settings, load_recordings(settings)))


@pytest.fixture(scope="module")
def problem(settings: Settings, tmp_path_factory: pytest.TempPathFactory) -> Problem:
    store = Store(tmp_path_factory.mktemp("problem") / "out", {})
    return Study(load_recordings(settings), "mimic_p050", TINY, store).judged[0]


# Whole runs


def test_every_experiment_writes_results_figures_and_a_verdict(
    settings: Settings, outcomes: dict[str, typing.Any]
) -> None:
    page = (settings.output / "report.html").read_text(encoding="utf-8")
    assert "http://" not in page.replace("http://www.w3.org", "")
    assert "https://" not in page
    assert set(outcomes) == set(OURS)
    for name in OURS:
        folder = settings.output / name
        content = json.loads((folder / "results.json").read_text(encoding="utf-8"))
        assert content["verdicts"]
        for verdict in content["verdicts"]:
            assert verdict["held"] in ("held", "held in part", "not shown", "did not hold")
            assert {"claim", "paper", "ours", "paragraph"} <= set(verdict)
            assert verdict["paragraph"].count(verdict["held"]) >= 1 or "check" in verdict["claim"]
        for drawing in content["drawings"]:
            png = (folder / f"{drawing['name']}.png").read_bytes()
            assert png.startswith(b"\x89PNG")
            assert len(png) > 10_000
        assert content["title"] in page
    assert page.count("data:image/svg+xml;base64,") == len(OURS)


def test_solvers_stay_within_limits_and_improve_on_holding_still(
    outcomes: dict[str, typing.Any], problem: Problem
) -> None:
    still = float(problem.cost(np.repeat(problem.start[None], len(problem), axis=0), 0.0).mean())
    found = outcomes["solver"].figures["solvers"]
    assert {"sampling", "SLSQP", "RMSProp", "Newton", "SLSQP × 2", "RMSProp × 3"} <= set(found)
    assert found["SLSQP"]["cost"][0][0] < still
    assert found["Newton"]["cost"][0][0] < still
    assert len(found["sampling"]["loss"][0]) == TINY.seeds
    assert len(found["SLSQP"]["loss"][0]) == 1  # nothing in it is random


def test_the_hessian_experiment_checks_itself(outcomes: dict[str, typing.Any]) -> None:
    assert 0 < outcomes["hessian"].figures["finite_difference_error"] < 1e-6
    (check,) = [v for v in outcomes["hessian"].verdicts if "our check" in v.claim]
    assert check.held == "held"


def test_a_finished_run_computes_nothing_again_and_says_the_same(
    settings: Settings, outcomes: dict[str, typing.Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    def never(*_: object, **__: object) -> Run:
        raise AssertionError("a finished cell was computed again")

    monkeypatch.setattr(study_module, "run_contestant", never)
    again = dict(run_experiments(settings, load_recordings(settings)))
    for name in OURS:
        assert again[name].verdicts == outcomes[name].verdicts


# Resuming, without any solver


@pytest.fixture
def counted(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    calls: list[str] = []

    def fake(problem: Problem, one: Contestant, weight: float, seed: int, advance: object) -> Run:
        calls.append(one.label)
        rng = np.random.default_rng([len(one.label), seed])
        q = problem.start + 1e-3 * rng.standard_normal((len(problem), len(problem.start)))
        return Run(q, np.ones(2), np.ones(len(problem)), 0.0)

    monkeypatch.setattr(study_module, "run_contestant", fake)
    return calls


def test_a_stopped_run_goes_on_where_it_was(tmp_path: Path, counted: list[str]) -> None:
    settings = Settings(output=tmp_path / "out", experiments=("solver",), size="tiny")
    sources = load_recordings(settings)

    @contextmanager
    def stopping(name: str, work: float) -> Iterator[typing.Any]:
        def advance(label: str, done: float) -> None:
            if len(counted) == 9:
                raise KeyboardInterrupt

        yield advance

    with pytest.raises(KeyboardInterrupt):
        run_experiments(settings, sources, stopping)
    assert not (settings.output / "solver" / "results.json").exists()
    assert not list(settings.output.rglob("*.tmp"))
    run_experiments(settings, sources)
    total = len(list((settings.output / "cells").glob("*.npz")))
    assert len(counted) == total  # none twice
    cell = sorted((settings.output / "cells").glob("run-slsqp-*.npz"))[0]
    cell.write_bytes(cell.read_bytes()[:200])  # a damaged one is as good as none
    run_experiments(settings, sources)
    assert len(counted) == total + 1


def test_steps_are_tuned_on_frames_that_are_not_judged(tmp_path: Path, counted: list[str]) -> None:
    frames = f"600:{600 + TINY.tuning_frames}"
    judged = Settings(
        output=tmp_path / "out",
        experiments=("solver",),
        size="tiny",
        recordings=(f"synthetic:{TUNING_OPERATOR}@{frames}",),
    )
    sources = load_recordings(judged)
    study = Study(sources, "mimic_p050", TINY, Store(judged.output, {}))
    assert study.tuning.name != study.judged[0].name
    assert not np.allclose(study.tuning.vectors, study.judged[0].vectors)
    lineup = make_lineup(study, 0.0)
    assert [one.solver for one in lineup.tuning] == ["sampling, tuned", "RMSProp", "RMSProp × 3"]
    for tuned in lineup.tuning:
        assert tuned.chosen == min(tuned.tried, key=lambda pair: pair[1])[0]


def test_unusable_requests_are_refused(tmp_path: Path) -> None:
    with pytest.raises(UnknownNameError, match="experiment"):
        Settings(output=tmp_path, experiments=("nothing",))
    with pytest.raises(RecordingError):
        load_recordings(Settings(output=tmp_path, experiments=OURS, recordings=("no.npz",)))
    short = Settings(
        output=tmp_path / "out", experiments=OURS, size="tiny", recordings=("synthetic:0@:5",)
    )
    with pytest.raises(RecordingError, match="needs 10"):
        run_experiments(short, load_recordings(short))


# The command


def test_the_command_knows_every_experiment() -> None:
    assert set(typing.get_args(ExperimentName)) == set(EXPERIMENTS)
    for name in EXPERIMENTS:
        made = experiment(name)
        assert made.title
        assert made.claim


def test_the_command_refuses_before_it_computes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "taken").mkdir()
    (tmp_path / "taken" / "file.txt").write_text("mine")
    assert main(["ablate", "solver", "--output", str(tmp_path / "taken")]) == 2
    assert "something other than earlier experiments" in capsys.readouterr().err
    both_sizes = ["--quick", "--published", "--output", str(tmp_path / "new")]
    assert main(["paper", *both_sizes]) == 2
    assert main(["ablate", "solver", "--hand", "none", "--output", str(tmp_path / "new")]) == 2
    assert not (tmp_path / "new").exists()


# Solvers


def test_rmsprop_finds_the_minimum_of_a_quadratic_within_bounds() -> None:
    stiffness, centre = jnp.array([1.0, 10.0, 100.0]), jnp.array([0.3, -0.2, 2.0])
    limits = np.array([[-1.0, 1.0]] * 3)

    def both_of(q: jax.Array) -> tuple[jax.Array, jax.Array]:
        off = q - centre[:, None]
        return (stiffness[:, None] * off**2).sum(axis=0), 2 * stiffness[:, None] * off

    starts = jnp.array([[-1.0, 0.0, 0.9], [1.0, 0.0, -0.9], [-1.0, 0.0, 0.5]])
    config = RmspropConfig(step=0.1, final=1e-3, max_evaluations=200, tolerance=1e-9)
    found, costs, spent = rmsprop_minimise(both_of, starts, limits, config)
    np.testing.assert_allclose(found, np.tile([[0.3], [-0.2], [1.0]], (1, 3)), atol=5e-3)
    np.testing.assert_allclose(costs, 100.0, rtol=1e-3)  # (1 - 2)² × 100: the bound holds
    assert int(spent) <= 200
    at_the_minimum, _, spent = rmsprop_minimise(
        both_of, jnp.array([[0.3], [-0.2], [1.0]]), limits, RmspropConfig(step=1e-6)
    )
    assert int(spent) < 10  # it gains nothing, and stops
    np.testing.assert_allclose(at_the_minimum[:, 0], [0.3, -0.2, 1.0], atol=1e-4)


def test_rmsprop_refuses_settings_that_mean_nothing() -> None:
    for bad in ({"step": 0.0}, {"final": 0.0}, {"decay": 1.0}, {"tolerance": 0.0}):
        with pytest.raises(ConfigError):
            RmspropConfig(**bad)


@pytest.mark.parametrize("kind", [np.asarray, jnp.asarray])
def test_the_softmax_of_outputs(kind: typing.Any) -> None:
    outputs = kind(np.array([[0.0, 1.0, 5.0], [2.0, 4.0, 9.0]]))
    equal = soft_mean(outputs, kind(np.array([3.0, 3.0, 3.0])), 0.1)
    np.testing.assert_allclose(equal, [2.0, 5.0], rtol=1e-6)
    cold = soft_mean(outputs, kind(np.array([0.0, 1.0, 2.0])), 1e-3)
    np.testing.assert_allclose(cold, [0.0, 2.0], atol=1e-6)
    share = 1 / (1 + np.exp(-0.5 / 0.25))
    two = soft_mean(outputs, kind(np.array([1.5, 1.0, np.nan])), 0.25)
    np.testing.assert_allclose(two, [share, 2 + 2 * share], rtol=1e-5)


def test_starts_scatter_about_the_last_answer_within_limits() -> None:
    limits = np.array([[-0.1, 3.0], [-3.0, 3.0]])
    starts = scattered_starts(jnp.array([0.0, 1.0]), limits, jnp.asarray(seed_words(1)), 4000, 0.2)
    np.testing.assert_array_equal(starts[:, 0], [0.0, 1.0])
    assert float(starts[0].min()) == pytest.approx(-0.1)
    assert float(starts[1].std()) == pytest.approx(0.2, rel=0.05)
    assert float(starts[1].mean()) == pytest.approx(1.0, abs=0.02)


def test_cycles_given_to_the_sampler_are_those_of_its_configuration() -> None:
    limits = np.array([[-2.0, 2.0]] * 2)
    key, start = jnp.asarray(seed_words(3)), jnp.array([1.0, -1.0])

    def cost(q: typing.Sequence[jax.Array]) -> jax.Array:
        return (q[0] - 0.2) ** 2 + 3 * (q[1] - 0.1) ** 2

    configured = sample_minimise(cost, start, limits, key, SamplingConfig(256, 16, 5))
    given = jax.jit(
        lambda cycles: sample_minimise(
            cost, start, limits, key, SamplingConfig(256, 16, 9), cycles=cycles
        )
    )(5)
    np.testing.assert_allclose(given, configured, atol=1e-6)


def test_a_batch_of_one_is_the_single_start(problem: Problem) -> None:
    """And all solvers of one objective agree on what is better than the last answer."""
    one = run_contestant(problem, Slsqp(), 0.0, 0)
    same = run_contestant(problem, Slsqp(starts=Starts(1)), 0.0, 7)
    np.testing.assert_array_equal(one.q, same.q)
    tight = run_contestant(problem, Newton(), 0.0, 0)
    a, b = (measure_run(problem, run, 0.0)["cost"] for run in (one, tight))
    assert b < 1.05 * a
    low, high = problem.hand.limits.T
    for run in (one, tight):
        assert (run.q >= low).all()
        assert (run.q <= high).all()


def test_random_solvers_repeat_by_their_seed(problem: Problem) -> None:
    sampling = Sampling(TINY.samples, TINY.cycles, most_cycles=TINY.cycles)
    first, again, other = (run_contestant(problem, sampling, 0.0, seed) for seed in (0, 0, 1))
    np.testing.assert_array_equal(first.q, again.q)
    assert np.abs(first.q - other.q).max() > 1e-4
    assert not Rmsprop().random
    assert Rmsprop(starts=Starts(2)).random


def test_a_velocity_term_slows_the_answers_down(problem: Problem) -> None:
    free, held = (run_contestant(problem, Newton(), weight, 0).q for weight in (0.0, 100.0))
    assert np.abs(np.diff(held, axis=0)).max() < 0.2 * np.abs(np.diff(free, axis=0)).max()


# The problem and its Hessian


def test_the_tracking_loss_is_the_objectives_own(problem: Problem) -> None:
    rng = np.random.default_rng(0)
    q = np.clip(problem.start + 0.1 * rng.standard_normal((len(problem), 16)),
                *problem.hand.limits.T)  # fmt: skip
    ours = problem.tracking_loss(q)
    objective = jax.jit(
        lambda q, vectors, weights: problem.objective.tracking(
            list(q), FrameGoal(vectors, weights, q, 0.0)
        )
    )
    for t in (0, 5, len(problem) - 1):
        theirs = objective(jnp.asarray(q[t]), problem.vectors[t], problem.weights[t])
        assert ours[t] == pytest.approx(float(theirs), rel=1e-4)


def test_the_hessian_is_that_of_the_cost_by_finite_differences_of_values(problem: Problem) -> None:
    """Not through the program that makes the Hessian: NumPy kinematics, differences of values."""
    t, step = 3, 1e-4
    q = run_contestant(problem, Newton(), 0.0, 0).q
    exact, error = hessians(problem, q)
    assert error < 1e-6
    np.testing.assert_allclose(exact, np.swapaxes(exact, 1, 2), atol=1e-9)
    pairs = [(0, 0), (2, 2), (1, 3), (4, 6), (9, 9), (15, 14)]
    unit = step * np.eye(16)
    points = np.array([
        q[t] + a * unit[i] + b * unit[j]
        for i, j in pairs for a, b in ((1, 1), (1, -1), (-1, 1), (-1, -1))
    ])  # fmt: skip
    many = dataclasses.replace(
        problem,
        vectors=np.repeat(problem.vectors[None, t], len(points), axis=0),
        weights=np.repeat(problem.weights[None, t], len(points), axis=0),
        stamps=np.arange(len(points), dtype=float),
    )
    with float64():
        pp, pm, mp, mm = many.cost(points, 0.0).reshape(-1, 4).T
    differences = (pp - pm - mp + mm) / (4 * step**2)
    ours = [exact[t][i, j] for i, j in pairs]
    np.testing.assert_allclose(differences, ours, atol=2e-3 * np.abs(exact[t]).max())


def test_jitter_along_a_direction_is_seen_there_and_nowhere_else() -> None:
    rng = np.random.default_rng(0)
    basis, _ = np.linalg.qr(rng.standard_normal((4, 4)))
    amplitude = 0.01
    q = np.outer(amplitude * (-1.0) ** np.arange(20), basis[:, 2])
    seen = projected_jitter(q, np.repeat(basis[None], 20, axis=0))
    np.testing.assert_allclose(seen, [0, 0, 4 * amplitude, 0], atol=1e-12)


def test_the_first_long_run_of_usable_frames_is_taken() -> None:
    usable = np.array([1, 1, 0, 1, 1, 1, 1, 0, 1, 1, 1, 1, 1], bool)
    assert unbroken(usable, 2) == slice(0, 2)
    assert unbroken(usable, 4) == slice(3, 7)
    assert unbroken(usable, 100) == slice(8, 13)
    assert unbroken(np.zeros(3, bool), 2) == slice(0, 0)


# Statistics and verdicts


def test_contrasts_are_paired_by_recording() -> None:
    rng = np.random.default_rng(0)
    size = 10.0 ** rng.uniform(-2, 2, 8)  # recordings differ a hundredfold
    a = [[0.5 * s * f for f in rng.normal(1, 0.02, 3)] for s in size]
    b = [[s] for s in size]
    ratio = contrast(a, b, "ratio")
    assert ratio.low is not None
    assert ratio.high is not None
    assert ratio.low < 0.5 < ratio.high
    assert ratio.high - ratio.low < 0.03
    assert ratio == contrast(a, b, "ratio")  # no chance in it
    mean = mean_of(b)
    assert mean.value == pytest.approx(size.mean())
    assert mean.high is not None
    assert mean.high - mean.value > 0.2 * size.mean()
    both_ways = pooled([(a, b), (b, a)], "ratio")
    assert both_ways.value == pytest.approx(1.0)


def test_intervals_cover_the_truth_as_often_as_they_say() -> None:
    rng = np.random.default_rng(1)
    inside = 0
    for trial in range(60):
        found = mean_of([[x] for x in rng.normal(2.0, 1.0, 20)], seed=trial)
        assert found.low is not None
        assert found.high is not None
        inside += found.low <= 2.0 <= found.high
    assert 50 <= inside <= 60


def test_one_run_has_no_interval_and_shows_nothing() -> None:
    alone = contrast([[2.0]], [[1.0]], "ratio")
    assert alone.low is None
    assert "one run" in alone.shown()
    assert judge_effect(alone, 1.0, 3.0) == "not shown"
    assert judge_equality(alone, 0.5, 4.0) == "not shown"
    seeds = contrast([[2.0, 2.2, 1.9]], [[1.0]], "ratio")
    assert seeds.low is not None  # over seeds, then


def _of(low: float, value: float, high: float) -> Estimate:
    return Estimate(value, low, high, 3, 2)


@pytest.mark.parametrize(
    ("found", "expected"),
    [
        (_of(-0.5, -0.4, -0.3), "held"),
        (_of(-0.5, -0.3, -0.2), "held"),  # smaller, but the claimed figure lies within
        (_of(-0.2, -0.1, -0.05), "held in part"),
        (_of(-0.9, -0.8, -0.7), "held"),  # more than was claimed
        (_of(-0.5, -0.2, 0.1), "not shown"),
        (_of(0.1, 0.2, 0.3), "did not hold"),
    ],
)
def test_an_effect_is_judged_by_its_interval(found: Estimate, expected: str) -> None:
    assert judge_effect(found, 0.0, -0.364) == expected


def test_the_other_judges() -> None:
    assert judge_effect(_of(2.0, 3.0, 4.0), 1.0, 7.18) == "held in part"
    assert judge_equality(_of(-0.02, 0.0, 0.03), -0.05, 0.05) == "held"
    assert judge_equality(_of(-0.02, 0.0, 0.08), -0.05, 0.05) == "not shown"
    assert judge_equality(_of(0.06, 0.07, 0.08), -0.05, 0.05) == "did not hold"
    assert judge_direction(_of(1.1, 1.2, 1.3), 1.0, upwards=True) == "held"
    assert judge_direction(_of(1.1, 1.2, 1.3), 1.0, upwards=False) == "did not hold"
    assert both("held", "held") == "held"
    assert both("held", "did not hold") == "held in part"
    assert both("not shown", "did not hold") == "did not hold"
    assert both("not shown", "held in part") == "held in part"
    assert both("not shown", "not shown") == "not shown"


def test_contours_of_equal_compute_run_from_wide_to_deep() -> None:
    points = [Point(n, depth) for n in (256, 1024, 4096) for depth in (5, 20, 80)]
    (line,) = contours(points)
    assert line == [Point(4096, 5), Point(1024, 20), Point(256, 80)]
    losses = {line[0]: [[1.2], [2.4]], line[1]: [[1.0], [2.0]], line[2]: [[1.5], [3.0]]}
    inner, wide, deep = balance(losses, line)
    assert inner == line[1]
    assert wide.value == pytest.approx(1 / 1.2 - 1)
    assert deep.value == pytest.approx(1 / 1.5 - 1)
