"""Programs that are traced once: the second process reads them, with the same results."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

from smooth_operator import Retargeter, SyntheticOperator, load_hand, method_config
from smooth_operator.compilation import batching, compile_cache
from smooth_operator.compilation.exported_program import ExportedProgram, program_key
from smooth_operator.methods import shared
from smooth_operator.methods.sbr import SbrConfig
from smooth_operator.solvers.sampling import SamplingConfig

pytestmark = pytest.mark.usefixtures("few_optimisations")

TINY = SbrConfig(sampling=SamplingConfig(samples=64, elites=8, cycles=2, draws="quasi"))


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The programs of this test alone, in this process too."""
    monkeypatch.setattr(compile_cache, "_programs", tmp_path)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(shared, "_known", type(shared._known)())
        patch.setattr(batching, "_programs", type(batching._programs)())
        yield tmp_path


def forget() -> None:
    """As a new process would begin."""
    shared._known.clear()
    batching._programs.clear()


def program(traced: list[int], **settings: Any) -> ExportedProgram:
    def function(state: Any, x: Any) -> Any:
        traced.append(1)
        return {"sum": state["sum"] + x.sum()}, (2 * x, state["sum"])

    config = replace(TINY, **settings)
    return ExportedProgram(function, 0, load_hand("mimic_p050"), config, "test")


def call(run: ExportedProgram, size: int = 3) -> tuple[float, list[float], float]:
    state, (twice, before) = run({"sum": jnp.float32(1.5)}, np.arange(size, dtype=np.float32))
    return float(state["sum"]), np.asarray(twice).tolist(), float(before)


def test_it_is_traced_once_and_read_by_the_next(folder: Path) -> None:
    traced: list[int] = []
    first = program(traced)
    assert call(first) == call(first) == (4.5, [0.0, 2.0, 4.0], 1.5)
    (file,) = folder.iterdir()
    assert len(traced) == 1
    assert call(program(traced)) == (4.5, [0.0, 2.0, 4.0], 1.5)
    assert len(traced) == 1
    # a damaged file is made again, whatever is left of it
    whole = file.read_bytes()
    flipped = bytearray(whole)
    flipped[len(whole) // 2] ^= 1
    for damaged in (b"", whole[:40], whole[: len(whole) // 2], bytes(flipped)):
        file.write_bytes(damaged)
        assert call(program(traced)) == (4.5, [0.0, 2.0, 4.0], 1.5)
        assert len(file.read_bytes()) == len(whole)
    assert len(traced) == 5
    # other shapes and other settings are other programs
    assert call(program(traced), size=2)[0] == 2.5
    call(program(traced, sampling=replace(TINY.sampling, cycles=3)))
    assert len(traced) == 7
    assert len(list(folder.iterdir())) == 3


def test_a_disk_that_takes_nothing_costs_time_only(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(compile_cache, "_programs", folder / "is not there" / "at all")
    traced: list[int] = []
    assert call(program(traced))[0] == call(program(traced))[0] == 4.5
    assert len(traced) == 2


def test_without_the_library_that_writes_it_each_process_traces(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    traced: list[int] = []
    call(program(traced))
    (file,) = folder.iterdir()
    monkeypatch.setattr("smooth_operator.compilation.exported_program._WRITER", "no_such_library")
    assert call(program(traced))[0] == 4.5
    assert len(traced) == 2
    assert list(folder.iterdir()) == [file]  # for those who have it


def test_only_the_newest_are_kept(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("smooth_operator.compilation.exported_program._MOST", 2)
    for size in (1, 2, 3, 4):
        call(program([]), size)
    assert len(list(folder.iterdir())) == 2


def test_what_a_program_depends_on_is_in_its_key() -> None:
    hand = load_hand("mimic_p050")
    key = program_key(hand, TINY, "frame")
    assert key == program_key(load_hand("mimic_p050"), replace(TINY), "frame")
    others = [
        program_key(load_hand("mimic_p050", "left"), TINY, "frame"),
        program_key(load_hand("leap_hand"), TINY, "frame"),
        program_key(hand, replace(TINY, sampling=replace(TINY.sampling, elites=9)), "frame"),
        program_key(hand, TINY, "lanes", 8),
        program_key(hand, method_config("smooth"), "frame"),
    ]
    assert None not in others
    assert len({key, *others}) == 6
    # a file, and code of the user's: what they hold when they are read again is not known
    assert program_key(hand, method_config("geort")) is None

    @dataclass(frozen=True)
    class Mine(SbrConfig):
        pass

    assert program_key(hand, Mine()) is None


def test_results_are_those_of_the_traced_program_to_the_last_bit(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recording = SyntheticOperator(rate_hz=20).record(1.5)

    def results() -> list[bytes]:
        forget()
        retargeter = Retargeter(config=TINY, seed=1)
        runs = [retargeter.run(recording), *retargeter.batch([recording])]
        return [
            each.tobytes() for commands, loss in runs for each in (commands.joint_positions, loss)
        ]

    made, read = results(), results()
    assert len(list(folder.iterdir())) == 2
    monkeypatch.setattr(compile_cache, "_programs", None)
    assert made == read == results()
