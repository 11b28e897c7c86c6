"""What comes from elsewhere is printed as text: no control characters, no markup."""

import json

import pytest
from rich.table import Table
from rich.text import Text

from smooth_operator.cli import main
from smooth_operator.cli.console import Progressing
from smooth_operator.console import open_console
from smooth_operator.errors import OutputError, RecordingError, UnknownNameError, reason
from smooth_operator.teleop.sources.programs import read_manus
from smooth_operator.terminal import printable

HOSTILE = "\x1b]0;title\x07\x1b[2J\x9b31m\r\u202e[/x][bold]:warning:"


def harmless(text: str) -> bool:
    """Whether a terminal would take nothing of a text for a command."""
    return not any((ord(c) < 32 and c not in "\n\t") or 127 <= ord(c) < 160 for c in text)


def test_control_characters_become_escapes_and_the_rest_stays():
    assert printable("m² → 3 µs\n\tß 手") == "m² → 3 µs\n\tß 手"
    assert printable(HOSTILE) == (r"\x1b]0;title\x07\x1b[2J\x9b31m\x0d\u202e[/x][bold]:warning:")
    assert printable("\udc80") == r"\udc80"  # of a file name that is no UTF-8


def test_tables_take_no_text_for_markup(capsys):
    table = Table(title=HOSTILE)
    table.add_column(HOSTILE)
    table.add_row(HOSTILE)
    open_console().print(table, HOSTILE, Text(HOSTILE), width=200)
    out = capsys.readouterr().out
    assert harmless(out)
    assert out.count("[/x][bold]:warning:") == 5


def test_errors_name_hostile_files_as_text(tmp_path, capsys):
    assert main(["retarget", f"/nowhere/{HOSTILE}.npz", "--output", str(tmp_path / "o.npz")]) == 2
    told = capsys.readouterr()
    assert harmless(told.err)
    assert r"\x1b[2J" in told.err.replace("\\\\", "\\")


def test_keys_of_a_message_are_told_as_text(capsys):
    message = json.dumps({HOSTILE: 1}).encode()
    with pytest.raises(RecordingError) as caught:
        read_manus(message, gloves={}, side="right")
    Progressing().note(f"manus: {caught.value}", matters=True)
    err = capsys.readouterr().err
    assert harmless(err)
    assert "[/x][bold]:warning:" in err.replace("\n", "")


def test_no_error_has_control_characters_of_a_file():
    foreign = "a\x1b]0;owned\x07b\u202e"
    for error in (
        RecordingError(f"a.csv: {foreign}"),
        OutputError(5, foreign),
        UnknownNameError("hand", foreign, ("leap_hand",)),
    ):
        assert str(error) == printable(str(error))
        assert "\\x1b" in str(error)
    assert reason(ValueError("no\n  number: 'x'")) == "no number: 'x'"
    assert len(reason(ValueError("{a=" * 500))) == 160  # of another library: one short line
