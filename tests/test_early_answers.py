"""Answers while a method compiles: the first stage, and the way from it to the method."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest
from jax.experimental.compilation_cache import compilation_cache

from smooth_operator import HandFrame, Retargeter, Status, SyntheticOperator, load_hand
from smooth_operator.compilation import kept_program
from smooth_operator.compilation.early_answers import MOST_STEP
from smooth_operator.compilation.first_stage import FirstStage
from smooth_operator.errors import ConfigError
from smooth_operator.human.alignment import AlignmentConfig, reference_landmarks
from smooth_operator.landmarks import TIPS, WRIST
from smooth_operator.methods import shared
from smooth_operator.planning import make_request
from smooth_operator.synthetic.robot_landmarks import human_landmarks
from smooth_operator.teleop import teleoperate
from smooth_operator.teleop.pages.live.live_session import LiveSession
from smooth_operator.teleop.pages.live.live_texts import modes
from smooth_operator.teleop.runtime.pipeline import OWN, PROVISIONAL, HandPipeline
from smooth_operator.teleop.runtime.settings import LoopConfig
from smooth_operator.teleop.runtime.statistics import LoopStatistics
from smooth_operator.teleop.sources.live import Arrival
from smooth_operator.types import Result

pytestmark = pytest.mark.usefixtures("few_optimisations")

METHOD = "joint_angle"
"""The quickest to compile."""
LONG = 120.0


@dataclass
class Compiler:
    """Compiles when a test lets it, or fails."""

    go: threading.Event = field(default_factory=threading.Event)
    error: Exception | None = None
    asked: int = 0


@pytest.fixture
def compiler(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Compiler]:
    """Nothing is kept, and a compilation takes as long as the test wants."""
    monkeypatch.setenv("SMOOTH_OPERATOR_CACHE", str(tmp_path))
    monkeypatch.setattr(shared, "_known", type(shared._known)())
    # what JAX takes from its own cache, which all tests share, is not kept
    before = jax.config.jax_enable_compilation_cache
    jax.config.update("jax_enable_compilation_cache", False)
    compilation_cache.reset_cache()
    waits, compile_it = Compiler(), kept_program._compiled_and_kept

    def waiting(*given: Any) -> Callable[..., Any]:
        waits.asked += 1
        assert waits.go.wait(LONG)
        if waits.error is not None:
            raise waits.error
        return compile_it(*given)

    monkeypatch.setattr(kept_program, "_compiled_and_kept", waiting)
    yield waits
    waits.go.set()
    for thread in threading.enumerate():
        if thread.name == "compile":
            thread.join(LONG)
    jax.config.update("jax_enable_compilation_cache", before)
    compilation_cache.reset_cache()


def frames(count: int) -> list[HandFrame]:
    return list(SyntheticOperator(seed=4, rate_hz=50).record(count / 50 + 0.02))[:count]


# The first stage


@pytest.mark.parametrize("name", ["mimic_p050", "inspire_hand", "shadow_dexee"])
def test_fingertips_go_where_the_hand_can_have_them(name: str) -> None:
    hand = load_hand(name)
    stage = FirstStage(hand, AlignmentConfig(scale=1.0), ())
    rng, last, worst = np.random.default_rng(1), None, []
    for k in range(40):
        share = 0.5 + 0.3 * np.sin(0.15 * k + np.arange(len(hand.limits)))
        q = hand.limits[:, 0] + share * np.ptp(hand.limits, axis=1)
        tips = hand.tips(hand.full_configuration(q))
        human = human_landmarks(hand, q[None])[0]
        answer = stage(human + rng.normal(size=3), np.ones(21, bool), last, 0.02)
        assert answer.status == Status.OK
        assert answer.q is not None
        assert (answer.q >= hand.limits[:, 0]).all()
        assert (answer.q <= hand.limits[:, 1]).all()
        got = hand.tips(hand.full_configuration(answer.q))
        apart = np.linalg.norm(got - tips, axis=1).mean()
        at_rest = np.linalg.norm(hand.tips(hand.full_configuration(hand.neutral)) - tips, axis=1)
        worst.append(apart / at_rest.mean())
        last = answer.q
    assert np.median(worst) < 0.35  # of what it would be if the hand stayed in its neutral pose


def test_derivatives_are_those_of_the_kinematics() -> None:
    for name in ("mimic_p050", "inspire_hand"):  # its joints are coupled
        hand = load_hand(name)
        kinematics = FirstStage(hand, AlignmentConfig(), ())._kinematics
        q = hand.limits.mean(axis=1)
        found = kinematics(hand.full_configuration(q))
        np.testing.assert_allclose(found.points, hand.tips(hand.full_configuration(q)), atol=1e-12)
        for joint, step in enumerate(1e-6 * np.eye(len(q))):
            ahead, behind = (hand.tips(hand.full_configuration(q + s)) for s in (step, -step))
            slope = (ahead - behind) / 2e-6
            np.testing.assert_allclose(found.jacobian[:, :, joint], slope, atol=1e-8)


@pytest.mark.parametrize(
    ("spoilt", "status"),
    [
        (lambda points: points[[WRIST]].repeat(21, 0), Status.DEGENERATE_PALM),
        (lambda points: 1e3 * points, Status.IMPLAUSIBLE_HAND),
        (lambda points: np.where(np.arange(21)[:, None] == TIPS[1], np.nan, points),
         Status.INVALID_LANDMARKS),
    ],
)  # fmt: skip
def test_a_frame_of_no_use_is_none(spoilt: Callable[[np.ndarray], np.ndarray], status: Any) -> None:
    hand = load_hand("mimic_p050")
    points = spoilt(reference_landmarks(hand))
    answer = FirstStage(hand, AlignmentConfig(), ())(points, np.isfinite(points).all(1), None, 0.02)
    assert (answer.status, answer.q) == (status, None)


# From the first stage to the method


def test_calls_are_answered_while_the_method_compiles_and_then_by_it(compiler: Compiler) -> None:
    compiled: list[str] = []
    jax.monitoring.register_event_duration_secs_listener(
        lambda name, *_, **__: compiled.append(name)
    )
    early = Retargeter(method=METHOD, early=True)
    actuated = list(early.hand.actuated)
    motion = frames(260)
    compiled.clear()
    results = [early(frame) for frame in motion[:20]]
    seen = list(compiled)
    assert compiler.asked == 1
    assert not [name for name in seen if "compile" in name]
    assert all(r.provisional and r.status == Status.OK and r.tracking_loss > 0 for r in results)
    assert "provisional" in repr(results[0])
    lost = HandFrame(np.full((21, 3), np.nan), motion[19].time + 0.001)
    held = early(lost)
    assert held.status == Status.INVALID_LANDMARKS
    np.testing.assert_array_equal(held.command.positions, results[-1].command.positions)

    compiler.go.set()
    assert early.live.wait(LONG)
    results += [early(frame) for frame in motion[20:]]
    assert compiler.asked == 1
    # the method's own, as if it had begun with the frame of the hand-over
    plain = Retargeter(method=METHOD)
    assert plain.live is plain
    own = [plain(frame) for frame in motion[20:]]
    q, full = (np.array([r.command.positions[actuated] for r in a]) for a in (results[20:], own))
    provisional = np.array([r.provisional for r in results[20:]])
    assert provisional[0]
    assert not provisional[-1]
    last = int(np.flatnonzero(provisional)[-1])
    assert provisional[: last + 1].all()
    np.testing.assert_array_equal(q[last + 1 :], full[last + 1 :])
    offset = q - full
    assert np.abs(offset[0]).max() > MOST_STEP  # else nothing was to be blended
    # no joint moves farther in a frame than by the method alone, but for this; limits may hold it
    further = np.abs(np.diff(q, axis=0)) - np.abs(np.diff(full, axis=0))
    assert further.max() <= MOST_STEP + 1e-9
    # the frame of the hand-over is the first stage's
    stage = FirstStage(early.hand, early.config.alignment, early.method.needs)
    again = None
    for i, frame in enumerate(motion[:21]):
        dt = frame.time - motion[i - 1].time if i else 0.0
        again = stage(frame.landmarks, np.asarray(frame.valid), again, dt).q
    np.testing.assert_array_equal(q[0], np.asarray(again))
    assert not any(r.provisional for r in own)

    early.reset()  # nothing to go over from
    first = early(motion[0])
    assert not first.provisional
    np.testing.assert_array_equal(
        first.command.positions, Retargeter(method=METHOD)(motion[0]).command.positions
    )


def test_a_program_that_was_kept_answers_the_first_frame(compiler: Compiler) -> None:
    compiler.go.set()
    (frame,) = frames(1)
    expected = Retargeter(method=METHOD)(frame)
    shared._known.clear()
    early = Retargeter(method=METHOD, early=True)
    found = early(frame)
    assert compiler.asked == 1
    assert not found.provisional
    np.testing.assert_array_equal(found.command.positions, expected.command.positions)


def test_frames_without_stamps_are_timed_as_ever(compiler: Compiler) -> None:
    points = [frame.landmarks for frame in frames(3)]
    video = Retargeter(method=METHOD, rate=50, early=True)
    assert [video(each).command.stamp for each in points] == pytest.approx([0.0, 0.02, 0.04])
    live = Retargeter(method=METHOD, early=True, clock=iter([5.0, 6.0]).__next__)
    assert [live(each).command.stamp for each in points[:2]] == [5.0, 6.0]
    with pytest.raises(ConfigError, match="no stamp, and step"):
        live.live.step(live.live.init(), points[0])
    with pytest.raises(ConfigError, match="left human hand"):
        live.live.step(live.live.init(), HandFrame(points[0], 1.0, "left"))


def test_what_compiling_raises_is_raised_by_the_next_answer(compiler: Compiler) -> None:
    early = Retargeter(method=METHOD, early=True)
    first, second = frames(2)
    assert early(first).provisional
    compiler.error = MemoryError("the compiler has none left")
    compiler.go.set()
    with pytest.raises(MemoryError, match="none left"):
        early.live.wait(LONG)
    with pytest.raises(MemoryError, match="none left"):
        early(second)
    with pytest.raises(MemoryError, match="none left"):
        early.warm_up()


def test_a_plugin_is_compiled_first(compiler: Compiler, monkeypatch: pytest.MonkeyPatch) -> None:
    compiler.go.set()
    config = Retargeter(method=METHOD).config
    monkeypatch.setattr(type(config), "__module__", "somebody.elses")
    early = Retargeter(config=config, early=True)
    assert early.live.ready
    assert not early(frames(1)[0]).provisional


def test_a_process_may_end_while_it_compiles(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text(
        "from smooth_operator import HandFrame, Retargeter\n"
        "from smooth_operator.human.alignment import reference_landmarks\n"
        f"r = Retargeter(method={METHOD!r}, early=True)\n"
        "print(r(HandFrame(reference_landmarks(r.hand), 0.0)).provisional)\n"
    )
    done = subprocess.run([sys.executable, str(script)], capture_output=True, text=True,
                          check=False, timeout=LONG, env=_fresh(tmp_path))  # fmt: skip
    assert (done.returncode, done.stdout, done.stderr) == (0, "True\n", "")


def test_a_command_does_not_wait_for_what_it_no_longer_needs() -> None:
    code = (
        "import threading\n"
        "from smooth_operator.cli import process\n"
        "def main():\n"
        "    threading.Thread(target=threading.Event().wait, name='compile').start()\n"
        "    return 3\n"
        "process.main = main\n"
        "process.program()\n"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False, timeout=LONG).returncode == 3


def _fresh(folder: Path) -> dict[str, str]:
    return {**os.environ, "SMOOTH_OPERATOR_CACHE": str(folder / "cache")}


# The live loop


def test_the_loop_says_who_answers(compiler: Compiler) -> None:
    pipeline = HandPipeline(Retargeter(method=METHOD, early=True), LoopConfig(rate=50.0))
    statistics, motion, ticks = LoopStatistics(0.02), frames(200), []
    for k, frame in enumerate(motion):
        if k == 10:
            compiler.go.set()
            assert pipeline.retargeter.live.wait(LONG)
        now = frame.time
        tick = pipeline.step(now, Arrival(frame, now, 0))
        statistics.add(tick, now, now)
        ticks.append(tick)
    assert PROVISIONAL in ticks[0].events
    begins = next(k for k, tick in enumerate(ticks) if OWN in tick.events)
    assert begins > 10
    assert [tick.provisional for tick in ticks] == [k < begins for k in range(len(ticks))]
    assert statistics.summary()["frames_provisional"] == begins
    assert not pipeline.provisional
    assert pipeline.latched is None


@dataclass
class Said:
    """A reporter that keeps its lines."""

    notes: list[str] = field(default_factory=list)

    def note(self, text: str, *, matters: bool = False) -> None:
        self.notes.append(text)

    def waiting(self, text: str) -> contextlib.AbstractContextManager[None]:
        return contextlib.nullcontext()


def test_a_run_says_who_answers(compiler: Compiler) -> None:
    said, loops, status = Said(), [], []

    def watch(tick: Any) -> None:
        if tick.provisional and not status:
            session = LiveSession(loops[0], make_request(method=METHOD), (), Path())
            session.watch(tick)
            look = session.look(text=False, settings=0)
            status.append(modes(look["hands"]))
            session.close()
            compiler.go.set()
        if OWN in tick.events:
            loops[0].controls.quit()

    def started(loop: Any) -> None:
        loops.append(loop)
        loop.watch = watch

    summary = teleoperate("synthetic", method=METHOD, started=started, duration=LONG, reporter=said)
    assert "first answers: the method compiles" in status[0]
    assert 0 < summary["frames_provisional"] < summary["frames_answered"]
    assert any("answers of a first stage, until" in note for note in said.notes)
    assert any("answered by the first stage or on the way" in note for note in said.notes)


def test_a_run_ends_with_what_compiling_raised(compiler: Compiler) -> None:
    compiler.error = MemoryError("the compiler has none left")
    seen: list[Result] = []

    def started(loop: Any) -> None:
        loop.watch = lambda tick: (seen.append(tick), tick.provisional and compiler.go.set())

    with pytest.raises(MemoryError, match="none left"):
        teleoperate("synthetic", method=METHOD, started=started, duration=LONG)
    assert any(tick.provisional for tick in seen)


@pytest.mark.parametrize("waits", [{"early": False}, {"blind": True}])
def test_a_run_may_wait_for_the_method(compiler: Compiler, waits: dict[str, bool]) -> None:
    compiler.go.set()
    summary = teleoperate("synthetic", method=METHOD, duration=0.3, **waits)  # type: ignore[arg-type]
    assert summary["frames_answered"] > 0
    assert summary["frames_provisional"] == 0
