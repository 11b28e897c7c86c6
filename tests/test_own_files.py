"""Machine code is taken only from where no other user can have written it."""

import os
import stat
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from smooth_operator import own_files
from smooth_operator.cli import doctor
from smooth_operator.errors import DocumentError
from smooth_operator.own_files import folder_problem, make_private, read_own_file
from smooth_operator.retargeting import program_store, start
from smooth_operator.retargeting.program_store import ProgramStore

pytestmark = pytest.mark.skipif(not hasattr(os, "geteuid"), reason="no owners and modes here")

OTHER = 1001
as_root = pytest.mark.skipif(
    not hasattr(os, "geteuid") or os.geteuid() != 0, reason="only root can make files of others"
)


@pytest.fixture
def cache(tmp_path, monkeypatch) -> Iterator[Path]:
    """The user's cache folder, as a new process would look at it."""
    folder = tmp_path / "above" / "cache"
    monkeypatch.setenv("SMOOTH_OPERATOR_CACHE", str(folder))
    own_files.own_folder.cache_clear()
    yield folder
    own_files.own_folder.cache_clear()


def with_an_entry(cache: Path) -> Path:
    """A kept program."""
    kept = ProgramStore.of_user()
    kept.write("p", b"code")
    assert kept.read("p") == b"code"
    own_files.own_folder.cache_clear()
    return cache / "programs" / "p"


def of_another(path: Path, *_: Path) -> None:
    os.chown(path, OTHER, -1, follow_symlinks=False)


def with_mode(mode: int) -> Callable[..., None]:
    return lambda path, *_: path.chmod(mode)


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (with_mode(0o777), "mode 0777; remove it"),
        (with_mode(0o2775), "mode 2775; remove it"),
        (with_mode(0o1777), "mode 1777; remove it"),
        pytest.param(of_another, "belongs to another user (UID 1001)", marks=as_root),
    ],
)
def test_a_folder_of_others_is_not_used(cache, damage, words, caplog):
    entry = with_an_entry(cache)
    jax_folder = cache / start.machine()
    jax_folder.mkdir()
    for folder in (entry.parent, jax_folder):
        damage(folder)
    assert ProgramStore.of_user() is None
    assert start.jax_folder() is None
    assert words in doctor.environment()["programs"]
    messages = [record.message for record in caplog.records]
    assert [words in message for message in messages] == [True, True]
    assert all("set SMOOTH_OPERATOR_CACHE to a folder" in message for message in messages)
    assert ProgramStore.of_user() is None
    assert len(caplog.records) == 2


@pytest.mark.parametrize(
    "damage", [with_mode(0o777), with_mode(0o2775), pytest.param(of_another, marks=as_root)]
)
@pytest.mark.parametrize("above", [1, 2])
def test_a_folder_above_that_others_can_write_is_not_used(cache, damage, above, caplog):
    with_an_entry(cache)
    folder = (cache / "programs").parents[above - 1]
    damage(folder)
    assert ProgramStore.of_user() is None
    assert start.jax_folder() is None
    assert all(str(folder) in record.message for record in caplog.records)
    assert len(caplog.records) == 2
    folder.chmod(0o1777 if above == 2 else 0o700)  # sticky, as /tmp is
    os.chown(folder, os.geteuid(), -1)
    own_files.own_folder.cache_clear()
    assert with_an_entry(cache).exists()


def test_a_link_to_an_open_folder_is_followed_and_refused(cache, tmp_path):
    entry = with_an_entry(cache)
    entry.parent.rename(tmp_path / "away")
    target = tmp_path / "open"
    target.mkdir()
    target.chmod(0o777)
    entry.parent.symlink_to(target)
    assert ProgramStore.of_user() is None
    target.chmod(0o700)
    own_files.own_folder.cache_clear()
    kept = ProgramStore.of_user()
    assert kept.folder == target  # and not through the link, which might be another one by then


def linked(entry: Path, elsewhere: Path) -> None:
    entry.rename(elsewhere)
    entry.symlink_to(elsewhere)


def pipe(entry: Path, elsewhere: Path) -> None:
    entry.unlink()
    os.mkfifo(entry)


def huge(entry: Path, elsewhere: Path) -> None:
    with entry.open("r+b") as file:
        file.truncate(program_store.MOST_BYTES_OF_ONE + 1)


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (with_mode(0o666), "it can be written by other users"),
        (linked, "symbolic link"),
        (pipe, "it is not a regular file"),
        (huge, "more than 268435456"),
        pytest.param(of_another, "it belongs to another user", marks=as_root),
    ],
)
def test_an_entry_of_others_is_removed_and_compiled_again(cache, tmp_path, damage, words, caplog):
    entry = with_an_entry(cache)
    damage(entry, tmp_path / "elsewhere")
    kept = ProgramStore(entry.parent)
    assert kept.read("p") is None
    assert words in caplog.text
    assert not os.path.lexists(entry)
    kept.write("p", b"new")
    assert kept.read("p") == b"new"


def test_a_secret_is_not_read_where_others_can(tmp_path):
    file = tmp_path / "key"
    file.write_bytes(b"secret")
    file.chmod(0o644)
    assert read_own_file(file, 10) == b"secret"
    with pytest.raises(DocumentError, match="can be read by other users"):
        read_own_file(file, 10, secret=True)
    file.chmod(0o600)
    assert read_own_file(file, 10, secret=True) == b"secret"
    with pytest.raises(DocumentError, match="6 bytes, more than 5"):
        read_own_file(file, 5)
    with pytest.raises(FileNotFoundError):
        read_own_file(tmp_path / "none" / "x", 5)
    with pytest.raises(DocumentError, match="not a regular file"):
        read_own_file(tmp_path, 5)


def test_folders_are_made_for_this_user_alone(tmp_path):
    before = os.umask(0o002)
    try:
        make_private(tmp_path / "a" / "b")
    finally:
        os.umask(before)
    assert [stat.S_IMODE((tmp_path / x).stat().st_mode) for x in ("a", "a/b")] == [0o700] * 2
    assert folder_problem(tmp_path / "a" / "b") == ""
    (tmp_path / "file").touch()
    with pytest.raises(OSError, match="exists"):
        make_private(tmp_path / "file")
