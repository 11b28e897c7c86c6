"""The paper's experiments: solvers, statistics, verdicts, resuming, and what is written."""

import contextlib
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

from smooth_operator.cli import main
from smooth_operator.errors import ConfigError, RecordingError, UnknownNameError
from smooth_operator.retargeting.objective import FrameGoal
from smooth_operator.retargeting.sbr.random_numbers import seed_words
from smooth_operator.retargeting.sbr.sampling import SamplingConfig, sample_minimise
from smooth_operator_benchmark.recordings import load_sources, parse_request
from smooth_operator_research.commands.options import ExperimentName
from smooth_operator_research.paper import experiment as context_module
from smooth_operator_research.paper import interval_coverage
from smooth_operator_research.paper.compared_solvers import (
    Newton,
    Rmsprop,
    RmspropConfig,
    Sampling,
    Slsqp,
    Solver,
    Starts,
    rmsprop_minimise,
    scattered_starts,
    soft_mean,
)
from smooth_operator_research.paper.compute import balance
from smooth_operator_research.paper.experiment import (
    EXPERIMENTS,
    PUBLISHED_STARTS,
    QUICK,
    TUNING_OPERATOR,
    ExperimentContext,
    ExperimentFolder,
    Size,
    experiment,
)
from smooth_operator_research.paper.hessian import hessians, projected_jitter
from smooth_operator_research.paper.intervals import (
    Estimate,
    Samples,
    contrast,
    independent,
    mean_of,
    pooled,
    typical,
)
from smooth_operator_research.paper.runs import Problem, Run, measure_run, run_solver, unbroken
from smooth_operator_research.paper.solver_grid import Point, contours, make_solver_grid
from smooth_operator_research.paper.suite import SIZES, Settings, load_recordings, run_experiments
from smooth_operator_research.paper.verdicts import Direction, Effect, Equality, Held, judge

pytestmark = pytest.mark.weekly

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
def settings(tmp_path_factory) -> Settings:
    folder = tmp_path_factory.mktemp("ablations") / "out"
    return Settings(output=folder, experiments=OURS, size="tiny")


@pytest.fixture(scope="module")
def outcomes(settings) -> dict[str, typing.Any]:
    return dict(run_experiments(settings, load_recordings(settings)))


@pytest.fixture(scope="module")
def problem(settings, tmp_path_factory) -> Problem:
    store = ExperimentFolder(tmp_path_factory.mktemp("problem") / "out", {})
    return ExperimentContext(load_recordings(settings), "mimic_p050", TINY, store).judged[0]


@pytest.fixture(scope="module")
def programs() -> typing.Any:
    return interval_coverage


def test_every_experiment_writes_results_figures_and_a_verdict(settings, outcomes):
    page = (settings.output / "report.html").read_text(encoding="utf-8")
    assert "http://" not in page.replace("http://www.w3.org", "")
    assert "https://" not in page
    assert set(outcomes) == set(OURS)
    for name in OURS:
        folder = settings.output / name
        content = json.loads((folder / "results.json").read_text(encoding="utf-8"))
        assert content["verdicts"]
        for verdict in content["verdicts"]:
            assert verdict["held"] in typing.get_args(Held)
            assert {"claim", "paper", "ours", "note"} <= set(verdict)
        for drawing in content["drawings"]:
            png = (folder / f"{drawing['name']}.png").read_bytes()
            assert png.startswith(b"\x89PNG")
            assert len(png) > 10_000
        assert content["title"] in page
    assert page.count("data:image/svg+xml;base64,") == len(OURS)


def test_solvers_stay_within_limits_and_improve_on_holding_still(outcomes, problem):
    still = float(problem.cost(np.repeat(problem.start[None], len(problem), axis=0), 0.0).mean())
    found = outcomes["solver"].figures["solvers"]
    assert {"sampling", "SLSQP", "RMSProp", "Newton", "SLSQP × 2", "RMSProp × 3"} <= set(found)
    assert found["SLSQP"]["cost"][0][0] < still
    assert found["Newton"]["cost"][0][0] < still
    assert len(found["sampling"]["loss"][0]) == TINY.seeds
    assert len(found["SLSQP"]["loss"][0]) == 1  # nothing in it is random


def test_the_hessian_experiment_checks_itself(outcomes):
    assert 0 < outcomes["hessian"].figures["finite_difference_error"] < 1e-6
    (check,) = [v for v in outcomes["hessian"].verdicts if "our check" in v.claim]
    assert check.held == "held"


def test_a_finished_run_computes_nothing_again_and_says_the_same(settings, outcomes, monkeypatch):
    def never(*_: object, **__: object) -> Run:
        raise AssertionError("a finished cell was computed again")

    monkeypatch.setattr(context_module, "run_solver", never)
    again = dict(run_experiments(settings, load_recordings(settings)))
    for name in OURS:
        assert again[name].verdicts == outcomes[name].verdicts


@pytest.fixture
def counted(monkeypatch) -> list[str]:
    calls: list[str] = []

    def fake(problem: Problem, one: Solver, weight: float, seed: int, advance: object) -> Run:
        calls.append(one.label)
        rng = np.random.default_rng([len(one.label), seed])
        q = problem.start + 1e-3 * rng.standard_normal((len(problem), len(problem.start)))
        return Run(q, np.ones(2), np.ones(len(problem)), 0.0)

    monkeypatch.setattr(context_module, "run_solver", fake)
    return calls


def test_a_stopped_run_goes_on_where_it_was(tmp_path, counted):
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


def test_steps_are_tuned_on_frames_that_are_not_judged(tmp_path, counted):
    frames = f"600:{600 + TINY.tuning_frames}"
    judged = Settings(
        output=tmp_path / "out",
        experiments=("solver",),
        size="tiny",
        recordings=(f"synthetic:{TUNING_OPERATOR}@{frames}",),
    )
    sources = load_recordings(judged)
    context = ExperimentContext(sources, "mimic_p050", TINY, ExperimentFolder(judged.output, {}))
    assert context.tuning.name != context.judged[0].name
    assert not np.allclose(context.tuning.vectors, context.judged[0].vectors)
    solver_grid = make_solver_grid(context, 0.0)
    assert [one.solver for one in solver_grid.tuning] == [
        "sampling, tuned",
        "RMSProp",
        "RMSProp × 3",
    ]
    for tuned in solver_grid.tuning:
        assert tuned.chosen == min(tuned.tried, key=lambda pair: pair[1])[0]


def test_unusable_requests_are_refused(tmp_path):
    with pytest.raises(UnknownNameError, match="experiment"):
        Settings(output=tmp_path, experiments=("nothing",))
    with pytest.raises(RecordingError):
        load_recordings(Settings(output=tmp_path, experiments=OURS, recordings=("no.npz",)))
    short = Settings(
        output=tmp_path / "out", experiments=OURS, size="tiny", recordings=("synthetic:0@:5",)
    )
    with pytest.raises(RecordingError, match="needs 10"):
        run_experiments(short, load_recordings(short))


def test_the_command_knows_every_experiment():
    assert set(typing.get_args(ExperimentName)) == set(EXPERIMENTS)
    for name in EXPERIMENTS:
        made = experiment(name)
        assert made.title
        assert made.claim


def test_the_command_refuses_before_it_computes(tmp_path, capsys):
    (tmp_path / "taken").mkdir()
    (tmp_path / "taken" / "file.txt").write_text("mine")
    assert main(["ablate", "solver", "--output", str(tmp_path / "taken")]) == 2
    assert "something other than earlier experiments" in capsys.readouterr().err
    both_sizes = ["--quick", "--published", "--output", str(tmp_path / "new")]
    assert main(["paper", *both_sizes]) == 2
    assert main(["ablate", "solver", "--hand", "none", "--output", str(tmp_path / "new")]) == 2
    assert not (tmp_path / "new").exists()


def test_published_says_how_many_starts_there_are(capsys):
    """Not every solver has the published number, and the help says which."""
    with contextlib.suppress(SystemExit):
        main(["paper", "--help"])
    told = " ".join(capsys.readouterr().out.replace("│", " ").split())
    size = SIZES["published"]
    assert size.samples == size.rmsprop_starts == PUBLISHED_STARTS
    for words in (
        f"{PUBLISHED_STARTS:,} samples and starts of RMSProp",
        f"{size.slsqp_starts} starts of SLSQP",
        f"{size.newton_starts:,} of Newton",
        f"{size.frames} frames",
    ):
        assert words in told, told


def test_without_recordings_there_are_enough_independent_ones():
    for name, least in (("default", 20), ("published", 20), ("quick", 4)):
        requests = [parse_request(word) for word in SIZES[name].recordings]
        assert len({one.unit for one in requests}) == len(requests) >= least
        lengths = [one.hand_length for one in requests]
        assert len(set(lengths)) > least / 2  # hands differ in size, and motions in tempo
        assert len({one.speed for one in requests}) > least / 3
    first, second = (
        load_sources([parse_request(f"synthetic:5@{word},:50")])[0]
        for word in ("17cm", "20cm,1.2x")
    )
    reach = [np.linalg.norm(one.landmarks[0, 12]) for one in (first.recording, second.recording)]
    assert reach[1] / reach[0] == pytest.approx(20 / 17, rel=0.01)
    assert first.name != second.name
    with pytest.raises(ConfigError, match="synthetic hand"):
        parse_request("glove.npz@17cm")


def test_rmsprop_finds_the_minimum_of_a_quadratic_within_bounds():
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


def test_rmsprop_refuses_settings_that_mean_nothing():
    for bad in ({"step": 0.0}, {"final": 0.0}, {"decay": 1.0}, {"tolerance": 0.0}):
        with pytest.raises(ConfigError):
            RmspropConfig(**bad)


@pytest.mark.parametrize("kind", [np.asarray, jnp.asarray])
def test_the_softmax_of_outputs(kind):
    outputs = kind(np.array([[0.0, 1.0, 5.0], [2.0, 4.0, 9.0]]))
    equal = soft_mean(outputs, kind(np.array([3.0, 3.0, 3.0])), 0.1)
    np.testing.assert_allclose(equal, [2.0, 5.0], rtol=1e-6)
    cold = soft_mean(outputs, kind(np.array([0.0, 1.0, 2.0])), 1e-3)
    np.testing.assert_allclose(cold, [0.0, 2.0], atol=1e-6)
    share = 1 / (1 + np.exp(-0.5 / 0.25))
    two = soft_mean(outputs, kind(np.array([1.5, 1.0, np.nan])), 0.25)
    np.testing.assert_allclose(two, [share, 2 + 2 * share], rtol=1e-5)


def test_starts_scatter_about_the_last_answer_within_limits():
    limits = np.array([[-0.1, 3.0], [-3.0, 3.0]])
    starts = scattered_starts(jnp.array([0.0, 1.0]), limits, jnp.asarray(seed_words(1)), 4000, 0.2)
    np.testing.assert_array_equal(starts[:, 0], [0.0, 1.0])
    assert float(starts[0].min()) == pytest.approx(-0.1)
    assert float(starts[1].std()) == pytest.approx(0.2, rel=0.05)
    assert float(starts[1].mean()) == pytest.approx(1.0, abs=0.02)


def test_cycles_given_to_the_sampler_are_those_of_its_configuration():
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


def test_a_batch_of_one_is_the_single_start(problem):
    """And all solvers of one objective agree on what is better than the last answer."""
    one = run_solver(problem, Slsqp(), 0.0, 0)
    same = run_solver(problem, Slsqp(starts=Starts(1)), 0.0, 7)
    np.testing.assert_array_equal(one.q, same.q)
    tight = run_solver(problem, Newton(), 0.0, 0)
    a, b = (measure_run(problem, run, 0.0)["cost"] for run in (one, tight))
    assert b < 1.05 * a
    low, high = problem.hand.limits.T
    for run in (one, tight):
        assert (run.q >= low).all()
        assert (run.q <= high).all()


def test_random_solvers_repeat_by_their_seed(problem):
    sampling = Sampling(TINY.samples, TINY.cycles, most_cycles=TINY.cycles)
    first, again, other = (run_solver(problem, sampling, 0.0, seed) for seed in (0, 0, 1))
    np.testing.assert_array_equal(first.q, again.q)
    assert np.abs(first.q - other.q).max() > 1e-4
    assert not Rmsprop().random
    assert Rmsprop(starts=Starts(2)).random


def test_a_velocity_term_slows_the_answers_down(problem):
    free, held = (run_solver(problem, Newton(), weight, 0).q for weight in (0.0, 100.0))
    assert np.abs(np.diff(held, axis=0)).max() < 0.2 * np.abs(np.diff(free, axis=0)).max()


def test_the_tracking_loss_is_the_objectives_own(problem):
    rng = np.random.default_rng(0)
    q = np.clip(
        problem.start + 0.1 * rng.standard_normal((len(problem), 16)), *problem.hand.limits.T
    )
    ours = problem.tracking_loss(q)
    objective = jax.jit(
        lambda q, vectors, weights: problem.objective.tracking(
            list(q), FrameGoal(vectors, weights, q, 0.0)
        )
    )
    for t in (0, 5, len(problem) - 1):
        theirs = objective(jnp.asarray(q[t]), problem.vectors[t], problem.weights[t])
        assert ours[t] == pytest.approx(float(theirs), rel=1e-4)
    # one call that was held up by something else says nothing of the solver
    run = Run(q, np.array([1.0, 2.0, 90.0]), np.arange(float(len(q))), 0.0)
    assert measure_run(problem, run, 0.0)["frame_ms"] == 2.0


def test_the_hessian_is_that_of_the_cost_by_finite_differences_of_values(problem):
    """Not through the program that makes the Hessian: NumPy kinematics, differences of values."""
    t, step = 3, 1e-4
    q = run_solver(problem, Newton(), 0.0, 0).q
    exact, error = hessians(problem, q)
    assert error < 1e-6
    np.testing.assert_allclose(exact, np.swapaxes(exact, 1, 2), atol=1e-9)
    pairs = [(0, 0), (2, 2), (1, 3), (4, 6), (9, 9), (15, 14)]
    unit = step * np.eye(16)
    points = np.array(
        [
            q[t] + a * unit[i] + b * unit[j]
            for i, j in pairs
            for a, b in ((1, 1), (1, -1), (-1, 1), (-1, -1))
        ]
    )
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


def test_jitter_along_a_direction_is_seen_there_and_nowhere_else():
    rng = np.random.default_rng(0)
    basis, _ = np.linalg.qr(rng.standard_normal((4, 4)))
    amplitude = 0.01
    q = np.outer(amplitude * (-1.0) ** np.arange(20), basis[:, 2])
    seen = projected_jitter(q, np.repeat(basis[None], 20, axis=0))
    np.testing.assert_allclose(seen, [0, 0, 4 * amplitude, 0], atol=1e-12)


def test_the_first_long_run_of_usable_frames_is_taken():
    usable = np.array([1, 1, 0, 1, 1, 1, 1, 0, 1, 1, 1, 1, 1], bool)
    assert unbroken(usable, 2) == slice(0, 2)
    assert unbroken(usable, 4) == slice(3, 7)
    assert unbroken(usable, 100) == slice(8, 13)
    assert unbroken(np.zeros(3, bool), 2) == slice(0, 0)


def alone(*values: float) -> Samples:
    return independent(values)


def test_contrasts_are_paired_by_recording():
    rng = np.random.default_rng(0)
    size = 10.0 ** rng.uniform(-2, 2, 8)  # recordings differ a hundredfold
    units = [str(k) for k in range(8)]
    a = Samples([[0.5 * s * f for f in rng.normal(1, 0.02, 3)] for s in size], units)
    b = Samples([[s] for s in size], units)
    ratio = contrast(a, b, "ratio")
    assert ratio.low < 0.5 < ratio.high
    assert ratio.high - ratio.low < 0.03
    change = contrast(a, b, "change")
    assert (change.value, change.low) == pytest.approx((ratio.value - 1, ratio.low - 1))
    mean = mean_of(b)
    assert mean.value == pytest.approx(size.mean())
    assert mean.high - mean.value > 0.2 * size.mean()
    assert typical(b).value == pytest.approx(np.exp(np.log(size).mean()))
    both_ways = pooled([(a, b), (b, a)], "ratio")
    assert both_ways.value == pytest.approx(1.0)
    with pytest.raises(ValueError, match="different recordings"):
        contrast(a, Samples(b.values, [*units[:-1], "other"]), "ratio")


def test_intervals_are_students_t():
    found = mean_of(alone(1.0, 2.0, 4.0, 5.0))
    half = 3.182446 * np.std([1.0, 2.0, 4.0, 5.0], ddof=1) / 2  # t of 3 degrees, as in any table
    assert (found.low, found.high) == pytest.approx((3 - half, 3 + half), rel=1e-4)
    low, high = found.interval(among=2)  # each at 97.5 %
    assert high - low == pytest.approx(2 * half * 4.176535 / 3.182446, rel=1e-4)


def test_windows_of_one_recording_are_one_unit():
    ratios = ([2.0], [2.2], [1.1])
    units = ["glove", "glove", "video"]
    found = contrast(Samples(ratios, units), Samples([[1.0]] * 3, units), "ratio")
    assert found.units == 2
    assert found.points == pytest.approx(((np.log(2.0) + np.log(2.2)) / 2, np.log(1.1)))
    one = contrast(Samples(ratios[:2], units[:2]), Samples([[1.0]] * 2, units[:2]), "ratio")
    assert one.low is None  # however many windows: of another recording they say nothing


def test_parts_of_a_file_share_a_unit_and_people_do_not(tmp_path):
    words = ("synthetic:3@:100", "synthetic:3@100:200", "synthetic:4@18cm", "a.npz@:9", "b.npz")
    units = [parse_request(word).unit for word in words]
    assert units[0] == units[1]
    assert len(set(units)) == 4
    path = tmp_path / "a.npz"
    assert parse_request(f"{path}@:50").unit == parse_request(f"{tmp_path}/./a.npz@60hz").unit


@pytest.mark.parametrize("count", [2, 4, 8])
def test_intervals_hold_the_truth_as_often_as_they_say(programs, count):
    found = programs.coverage(programs.DRAWS["normal"], count, 1500)
    assert 0.93 < found.covered < 0.97  # intervals of 90 % have 0.90, four standard errors below
    assert found.shown == pytest.approx(1 - found.covered)
    windows = programs.coverage(programs.DRAWS["normal"], count, 1500, windows=2)
    assert 0.93 < windows.covered < 0.97
    wrong = programs.coverage(programs.DRAWS["normal"], count, 300, windows=2, alone=True)
    assert wrong.covered < 0.9


def test_the_table_of_coverage_is_that_of_the_page(programs):
    made = programs.coverage_table(programs.Settings(draws=2))
    page = (Path(__file__).resolve().parents[2] / "research" / "docs" / "paper.md").read_text(
        encoding="utf-8"
    )
    text = page.split("<!-- table: coverage -->\n")[1].split("<!-- end -->")[0]
    lines = [line.strip("|").split("|") for line in text.strip().splitlines()]
    assert [cell.strip() for cell in lines[0]] == made.headers
    assert [line[0].strip() for line in lines[2:]] == [row[0] for row in made.rows]


def test_one_unit_has_no_interval_and_shows_nothing():
    one = contrast(alone(2.0), alone(1.0), "ratio")
    assert one.low is None
    assert "n = 1" in one.shown()
    assert judge(Effect(1.0, 3.0), [one]) == "not shown"
    assert judge(Equality(0.5, 4.0), [one]) == "not shown"
    # seeds repeat the solver, not the recording
    seeds = contrast(Samples([[2.0, 2.2, 1.9]], ["a"]), Samples([[1.0]], ["a"]), "ratio")
    assert seeds.low is None
    nothing = contrast(alone(0.0, 1.0), alone(1.0, 1.0), "ratio")  # no logarithm
    assert nothing.low is None
    assert judge(Direction(1.0, upwards=False), [nothing]) == "not shown"


def _of(low: float, value: float, high: float) -> Estimate:
    """An estimate with about these ends, of 20 recordings."""
    shape = np.linspace(-1, 1, 20)
    unit = mean_of(alone(*shape))
    points = value + shape * (high - low) / 2 / unit.high
    found = mean_of(alone(*points))
    assert (found.low, found.value) == pytest.approx((value - (high - low) / 2, value))
    return found


@pytest.mark.parametrize(
    ("found", "expected"),
    [
        (_of(-0.5, -0.4, -0.3), "held"),
        (_of(-0.34, -0.33, -0.32), "held"),  # smaller, but surely more than four fifths
        (_of(-0.26, -0.25, -0.24), "held in part"),
        (_of(-0.59, -0.3, -0.01), "held in part"),  # the claimed figure lies within: of no help
        (_of(-0.21, -0.1, 0.01), "not shown"),
        (_of(-0.15, -0.1, -0.05), "held in part"),
        (_of(-0.9, -0.8, -0.7), "held"),  # more than was claimed
        (_of(-0.5, -0.2, 0.1), "not shown"),
        (_of(0.1, 0.2, 0.3), "did not hold"),
    ],
)
def test_an_effect_is_judged_by_its_interval(found, expected):
    assert judge(Effect(0.0, -0.364), [found]) == expected


def test_noise_never_helps_a_claim():
    """A wider interval about the same figure never has a better verdict."""
    rank = {"not shown": 0, "held in part": 1, "held": 2}
    judges = (Effect(0.0, -0.364), Direction(0.0, upwards=False), Equality(-0.3, 0.3))
    for value in np.linspace(-0.9, -0.01, 30):
        for one in judges:
            wider = [judge(one, [_of(value - w, value, value + w)]) for w in (0.001, 0.1, 0.3, 1.0)]
            ranks = [rank[held] for held in wider if held != "did not hold"]
            assert ranks == sorted(ranks, reverse=True), (value, one, wider)


def test_shares_of_ratios_are_on_a_logarithmic_scale():
    claim = Effect(1.0, 4.0)  # four fifths of it are × 3.03
    assert judge(claim, [contrast(alone(3.1, 3.11, 3.12), alone(1, 1, 1), "ratio")]) == "held"
    part = contrast(alone(2.9, 2.91, 2.92), alone(1, 1, 1), "ratio")
    assert judge(claim, [part]) == "held in part"


def test_claims_of_several_parts():
    down = Direction(0.0, upwards=False)
    clearly, hardly = _of(-0.4, -0.3, -0.2), _of(-0.4, -0.2, -0.001)
    opposite, unclear = _of(0.2, 0.3, 0.4), _of(-0.3, 0.1, 0.5)
    assert judge(down, [hardly]) == "held"
    assert judge(down, [clearly, hardly]) == "held"  # all at 95 %: no correction
    assert judge(down, [clearly, unclear]) == "held in part"
    # one of two by a hair is what chance does: the interval of 97.5 % holds 0
    assert judge(down, [hardly, unclear]) == "not shown"
    assert judge(down, [clearly, opposite]) == "mixed"
    assert judge(down, [unclear, opposite]) == "did not hold"
    assert judge(down, [unclear, unclear]) == "not shown"
    assert judge(down, []) == "not shown"
    assert judge(down, [clearly], missing=1) == "held in part"
    assert judge(down, [hardly], missing=1) == "not shown"  # one of two, though one was measured
    equal = Equality(-0.05, 0.05)
    assert judge(equal, [_of(-0.02, 0.0, 0.02)]) == "held"
    assert judge(equal, [_of(-0.02, 0.03, 0.08)]) == "not shown"
    assert judge(equal, [_of(0.06, 0.07, 0.08)]) == "did not hold"


def test_contours_of_equal_compute_run_from_wide_to_deep():
    points = [Point(n, depth) for n in (256, 1024, 4096) for depth in (5, 20, 80)]
    (line,) = contours(points)
    assert line == [Point(4096, 5), Point(1024, 20), Point(256, 80)]
    losses = {line[0]: alone(1.2, 2.4), line[1]: alone(1.0, 2.0), line[2]: alone(1.5, 3.0)}
    inner, wide, deep = balance(losses, line)
    assert inner == line[1]
    assert wide.value == pytest.approx(1 / 1.2 - 1)
    assert deep.value == pytest.approx(1 / 1.5 - 1)


def test_a_cell_is_not_judged_by_the_losses_that_it_was_chosen_by():
    """Of many cells that differ by chance alone, the luckiest is no better than the ends."""
    rng = np.random.default_rng(0)
    line = [Point(2**k, 2 ** (20 - k)) for k in range(18, 1, -1)]
    changes = []
    for _ in range(40):
        losses = {point: alone(*np.exp(rng.normal(0, 0.1, 8))) for point in line}
        inner, wide, _ = balance(losses, line)
        chosen = float(np.log(losses[inner].means).mean())
        changes.append((np.log1p(wide.value), chosen - float(np.log(losses[line[0]].means).mean())))
    fair, lucky = np.mean(changes, axis=0)
    assert lucky < -0.05
    assert abs(fair) < 0.02
