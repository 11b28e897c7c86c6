"""Programs that are traced once: the second process reads them, with the same results."""

import os
from collections.abc import Iterator
from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from smooth_operator import Hand, Retargeter, SyntheticOperator, load_hand, method_config
from smooth_operator.retargeting import MethodConfig, program_store
from smooth_operator.retargeting import retargeter as programs
from smooth_operator.retargeting.batching import BatchRetargeter
from smooth_operator.retargeting.compiled_program import CompiledProgram
from smooth_operator.retargeting.program_store import ProgramStore, program_key
from smooth_operator.retargeting.sbr.method import SbrConfig
from smooth_operator.retargeting.sbr.sampling import SamplingConfig

TINY = SbrConfig(sampling=SamplingConfig(samples=64, elites=8, cycles=2, draws="quasi"))


@pytest.fixture
def folder(tmp_path, monkeypatch) -> Iterator[Path]:
    """The programs of this test alone."""
    monkeypatch.setenv("SMOOTH_OPERATOR_CACHE", str(tmp_path))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(programs, "_programs", type(programs._programs)())
        yield tmp_path / "programs"


def forget() -> None:
    """As a new process would begin."""
    programs._programs.clear()


def program(traced: list[int], **settings: Any) -> CompiledProgram:
    def function(state: Any, x: Any) -> Any:
        traced.append(1)
        return {"sum": state["sum"] + x.sum()}, (2 * x, state["sum"])

    config = replace(TINY, **settings)
    store = ProgramStore.of_user()
    return CompiledProgram(
        function, "test", hand=load_hand("mimic_p050"), config=config, cache=store
    )


def call(run: CompiledProgram, size: int = 3) -> tuple[float, list[float], float]:
    state, (twice, before) = run({"sum": jnp.float32(1.5)}, np.arange(size, dtype=np.float32))
    return float(state["sum"]), np.asarray(twice).tolist(), float(before)


def test_it_is_traced_once_and_read_by_the_next(folder):
    traced: list[int] = []
    first = program(traced)
    assert call(first) == call(first) == (4.5, [0.0, 2.0, 4.0], 1.5)
    assert len(list(folder.iterdir())) == len(traced) == 1
    assert call(program(traced)) == (4.5, [0.0, 2.0, 4.0], 1.5)
    assert len(traced) == 1
    # other shapes and other settings are other programs
    assert call(first, size=2)[0] == 2.5
    assert call(first) == (4.5, [0.0, 2.0, 4.0], 1.5)
    call(program(traced, sampling=replace(TINY.sampling, cycles=3)))
    assert len(traced) == 3
    assert len(list(folder.iterdir())) == 3


def test_an_error_of_the_program_is_raised_at_once():
    """An error of the user's own term, say: nothing is tried again."""
    traced: list[int] = []

    def function(x: Any) -> Any:
        traced.append(1)
        raise ZeroDivisionError("of the user's own")

    run = CompiledProgram(function, "test", hand=load_hand(), config=TINY)
    with pytest.raises(ZeroDivisionError, match="own"):
        run(np.zeros(3, np.float32))
    assert len(traced) == 1


def test_a_damaged_file_is_said_once_and_made_again(folder, caplog):
    traced: list[int] = []
    call(program(traced))
    (file,) = folder.iterdir()
    whole = file.read_bytes()
    flipped = bytearray(whole)
    flipped[len(whole) // 2] ^= 1
    other = b"null\n" + whole[32:]  # whole, and of something else
    for damaged in (b"", whole[: len(whole) // 2], bytes(flipped), sha256(other).digest() + other):
        caplog.clear()
        file.write_bytes(damaged)
        for _ in range(2):
            assert call(program(traced)) == (4.5, [0.0, 2.0, 4.0], 1.5)
        assert [str(file) in record.message for record in caplog.records] == [True]
        assert len(file.read_bytes()) == len(whole)
    assert len(traced) == 5


def test_what_can_not_be_kept_costs_time_only(folder, monkeypatch, tmp_path):
    (tmp_path / "file").touch()
    traced: list[int] = []
    for value in ("off", str(tmp_path / "file" / "cache")):
        monkeypatch.setenv("SMOOTH_OPERATOR_CACHE", value)
        assert call(program(traced))[0] == call(program(traced))[0] == 4.5
    assert len(traced) == 4
    assert not folder.exists()
    monkeypatch.setenv("SMOOTH_OPERATOR_CACHE", str(tmp_path))
    monkeypatch.setattr(program_store, "_named_tuples", lambda _: 1 / 0)
    assert call(program(traced))[0] == 4.5
    assert not list(folder.iterdir())


@pytest.mark.parametrize(
    ("setting", "other"),
    [("jax_numpy_rank_promotion", "warn"), ("jax_default_matmul_precision", "float32")],
)
def test_other_settings_of_jax_are_other_programs(folder, setting, other):
    traced: list[int] = []
    call(program(traced))
    before = jax.config.values[setting]
    assert before != other
    jax.config.update(setting, other)
    try:
        call(program(traced))
    finally:
        jax.config.update(setting, before)
    assert len(traced) == len(list(folder.iterdir())) == 2
    call(program(traced))
    assert len(traced) == 2


def test_only_the_newest_are_kept(tmp_path):
    programs = ProgramStore(tmp_path, most_bytes=200)
    for number, name in enumerate("abcd"):
        programs.write(name, bytes(50))  # with its digest 82
        os.utime(tmp_path / name, (number, number))
        programs.read("a")  # used, and so newer
    assert {file.name for file in tmp_path.iterdir()} == {"a", "d"}


def test_what_a_program_depends_on_is_in_its_key():
    hand = load_hand("mimic_p050")

    def key_of(hand: Hand, config: MethodConfig, *name: object, constants: Any = None) -> Any:
        program = CompiledProgram(abs, *name, hand=hand, config=config, constants=constants)
        return program_key(program)

    key = key_of(hand, TINY, "frame")
    assert key == key_of(load_hand("mimic_p050"), replace(TINY), "frame")
    others = [
        key_of(load_hand("mimic_p050", "left"), TINY, "frame"),
        key_of(load_hand("leap_hand"), TINY, "frame"),
        key_of(hand, replace(TINY, sampling=replace(TINY.sampling, elites=9)), "frame"),
        key_of(hand, TINY, "lanes", 8),
        key_of(hand, method_config("smooth"), "frame"),
    ]
    assert None not in others
    assert len({key, *others}) == 6
    # a file, and code of the user's: what they hold when they are read again is not known
    geort = method_config("geort")
    assert key_of(hand, geort) is None
    weights = [key_of(hand, geort, constants=np.full(3, x, np.float32)) for x in (1, 2)]
    assert None not in weights
    assert weights[0] != weights[1]

    @dataclass(frozen=True)
    class Mine(SbrConfig):
        pass

    assert key_of(hand, Mine()) is None


@pytest.mark.parametrize(
    "config",
    [
        pytest.param(method_config("joint_angle"), id="joint_angle"),
        pytest.param(method_config("geort"), id="geort"),
        pytest.param(TINY, id="sbr", marks=pytest.mark.weekly),
        pytest.param(method_config("dexpilot"), id="dexpilot", marks=pytest.mark.weekly),
    ],
)
def test_results_are_those_of_the_traced_program_to_the_last_bit(config, folder):
    recording = SyntheticOperator(rate_hz=20).record(1.5)

    def results(cache: ProgramStore | None) -> list[bytes]:
        forget()
        retargeter = BatchRetargeter(config=config, seed=1, cache=cache)
        runs = [retargeter.run(recording), *retargeter.batch([recording])]
        return [
            each.tobytes() for commands, loss in runs for each in (commands.joint_positions, loss)
        ]

    traced = results(None)
    assert not folder.exists() or not list(folder.iterdir())
    made = results(ProgramStore.of_user())
    files = {file: file.stat().st_size for file in folder.iterdir()}
    assert len(files) == 2
    assert traced == made == results(ProgramStore.of_user())
    assert files == {file: file.stat().st_size for file in folder.iterdir()}


def test_a_state_that_comes_back_compiles_nothing(folder, caplog):
    """The first frame's state is of NumPy, the next one's of JAX."""
    retargeter = Retargeter("mimic_p050", method="joint_angle")
    retargeter.warm_up()
    frames = list(SyntheticOperator(seed=1).record(0.03))
    state = retargeter.init()
    with jax.log_compiles():
        for frame in frames:
            state, _ = retargeter.step(state, frame)
    assert len(frames) > 2
    assert "Compiling" not in caplog.text
