"""The log of results: what is found again after a kill, and what is said about other lines."""

from smooth_operator_study.result_log import ResultLog


def test_a_log_goes_on_after_half_a_line(tmp_path):
    path = tmp_path / "log.jsonl"
    log = ResultLog(path)
    log.keep("", {"a": 1}, "code", {"x": 1})
    with path.open("ab") as file:
        file.write(b'{"key": "abc", "co')
    log = ResultLog(path)
    log.keep("", {"a": 2}, "code", {"x": 2})
    again = ResultLog(path)
    assert [again.find("", {"a": n}, "code") for n in (1, 2, 3)] == [{"x": 1}, {"x": 2}, None]


def test_a_log_says_what_it_does_not_use(tmp_path):
    path = tmp_path / "log.jsonl"
    ResultLog(path).keep("", "key", "code", {"x": 1})
    with path.open("ab") as file:
        file.write(b'{"search": "of an earlier version"}\nno result\n')
    notes: list[str] = []
    log = ResultLog(path, notes.append)
    assert log.find("", "key", "other code") is None
    log.note_outdated()
    damaged, outdated = notes
    assert "2 lines that are not results" in damaged
    assert "another version of the code" in outdated
    assert log.find("", "key", "code") == {"x": 1}
