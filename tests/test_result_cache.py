"""The result cache: what is found again, what is not, and what is said about it."""

import multiprocessing
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pytest

from smooth_operator.errors import OutputError
from smooth_operator.parallel import TaskResult, run_tasks
from smooth_operator.result_cache import (
    Job,
    JobResult,
    ResultCache,
    code_digest,
    compute_results,
    find_results,
)


@pytest.fixture
def home(tmp_path) -> Path:
    """A package of three modules and a package."""
    folder = tmp_path / "toy"
    (folder / "c").mkdir(parents=True)
    (folder / "a.py").write_text("from toy import b\ndef f():\n    import toy.c\n")
    (folder / "b.py").write_text("")
    (folder / "c" / "__init__.py").write_text("from toy.a import f\n")
    (folder / "d.py").write_text("")
    return folder


def changed(path: Path) -> Path:
    path.write_text(path.read_text() + "# changed\n")
    code_digest.cache_clear()
    return path


def test_a_digest_changes_with_a_file_below_a_folder(home):
    before = code_digest("a.py", "c", home=home)
    changed(home / "d.py")
    (home / "c" / "left.pyc").write_bytes(b"compiled")
    assert code_digest("a.py", "c", home=home) == before
    changed(home / "c" / "__init__.py")
    assert code_digest("a.py", "c", home=home) != before
    with pytest.raises(FileNotFoundError, match=r"'moved' is not in the package 'toy'"):
        code_digest("a.py", "moved", home=home)


VALUE = {"x": [1.5]}


def test_a_result_is_found_by_key_and_code(tmp_path):
    notes: list[str] = []
    cache = ResultCache(tmp_path / "results", notes.append)
    assert cache.find("one", {"seed": 1}, "code") is None
    cache.keep("one", {"seed": 1}, "code", VALUE)
    again = ResultCache(tmp_path / "results", notes.append)
    np.testing.assert_equal(again.find("one", {"seed": 1}, "code"), VALUE)
    assert again.find("one", {"seed": 2}, "code") is None
    again.note_outdated()
    assert notes == []
    assert again.find("one", {"seed": 1}, "other code") is None
    again.note_outdated()
    (note,) = notes
    assert note.startswith("1 result in ")
    assert "another version of the code" in note


@pytest.mark.parametrize(
    "damage", [lambda text: text[: len(text) // 2], lambda text: b"", lambda text: b"[1]"]
)
def test_a_damaged_result_is_ignored_with_a_note(tmp_path, damage):
    notes: list[str] = []
    cache = ResultCache(tmp_path, notes.append)
    cache.keep("one", "key", "code", VALUE)
    path = cache.path("one")
    path.write_bytes(damage(path.read_bytes()))
    assert cache.find("one", "key", "code") is None
    (note,) = notes
    assert str(path) in note
    assert "computed again" in note
    cache.keep("one", "key", "code", VALUE)
    assert cache.find("one", "key", "code") is not None
    with pytest.raises(OutputError):
        ResultCache(path)  # a file, not a folder


def _write_often(folder: Path) -> None:
    cache = ResultCache(folder)
    for _ in range(50):
        cache.keep("shared", "key", "code", {"x": list(range(500))})


def test_processes_that_share_a_folder_leave_whole_results(tmp_path):
    context = multiprocessing.get_context("spawn")
    writers = [context.Process(target=_write_often, args=(tmp_path,)) for _ in range(2)]
    for writer in writers:
        writer.start()
    notes: list[str] = []
    cache = ResultCache(tmp_path, notes.append)
    while any(writer.is_alive() for writer in writers):
        assert cache.find("shared", "key", "code") in (None, {"x": list(range(500))})
    for writer in writers:
        writer.join()
        assert writer.exitcode == 0
    assert cache.find("shared", "key", "code") is not None
    assert notes == []
    assert [path.name for path in tmp_path.iterdir()] == ["shared.json"]


def square(number: int) -> int:
    if number == 3:
        raise ValueError("three")
    return number**2


def jobs(numbers: Sequence[int]) -> list[Job[int]]:
    return [Job(f"n{n}", {"n": n}, "code", n, str(n), effort=n) for n in numbers]


def test_only_missing_jobs_are_computed_and_failures_are_tried_again(tmp_path):
    begun: list[int] = []

    def execute(tasks: Sequence[int]) -> Iterator[TaskResult[int]]:
        begun.extend(tasks)
        return run_tasks(square, tasks, workers=0)

    cache = ResultCache(tmp_path)

    def run(numbers: list[int]) -> dict[int, JobResult[int]]:
        finished, missing = find_results(jobs(numbers), cache)
        fresh = compute_results(missing[::-1], cache, execute)
        return {r.job.task: r for r in (*finished, *fresh)}

    first = run([1, 2, 3])
    assert begun == [3, 2, 1]  # in the given order
    assert first[3].error == "ValueError: three"
    assert first[2].value == 4
    begun.clear()
    second = run([1, 2, 3, 4])
    assert begun == [4, 3]
    assert second[2].value == 4
    stopped = compute_results(jobs([8, 7]), cache, execute)
    assert next(stopped).job.task == 8
    stopped.close()
    kept = ResultCache(tmp_path)
    assert [kept.find(f"n{n}", {"n": n}, "code") for n in (7, 8)] == [None, 64]
