"""The hand-landmarker file: fetched once, whole, and the published one; or nothing."""

import hashlib
import http.server
import io
import threading
import zipfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from smooth_operator.errors import OutputError, SourceError
from smooth_operator.teleop.sources.webcam import picture_tracker as model_file
from smooth_operator.teleop.sources.webcam.picture_tracker import SWITCH, hand_model, model_cache


def archive() -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as file:
        file.writestr("hand_landmarks_detector.tflite", b"network" * 30_000)
    return buffer.getvalue()


MODEL = archive()
HASH = hashlib.sha256(MODEL).hexdigest()


class Server:
    """Answers every request with the same bytes, and counts them."""

    def __init__(self) -> None:
        self.body, self.length, self.status, self.asked = MODEL, len(MODEL), 200, 0
        outer = self

        class Handler(http.server.BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                outer.asked += 1
                self.send_response(outer.status)
                self.send_header("Content-Length", str(outer.length))
                self.end_headers()
                self.wfile.write(outer.body)

            def log_message(self, *_: object) -> None:
                pass

        self.server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.url = f"http://127.0.0.1:{self.server.server_address[1]}/hand_landmarker.task"
        threading.Thread(target=self.server.serve_forever, daemon=True).start()


@pytest.fixture
def server() -> Iterator[Server]:
    made = Server()
    yield made
    made.server.shutdown()
    made.server.server_close()


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch) -> Path:
    """The place of the file in a cache folder of the test's own."""
    for name in ("XDG_CACHE_HOME", "LOCALAPPDATA", "HOME"):
        monkeypatch.setenv(name, str(tmp_path))
    monkeypatch.setenv("no_proxy", "*")
    monkeypatch.delenv(SWITCH, raising=False)
    monkeypatch.delenv("SMOOTH_OPERATOR_CACHE", raising=False)
    assert tmp_path in model_cache().parents
    return model_cache()


def test_it_is_kept_where_the_caches_are(tmp_path, monkeypatch):
    usual = model_cache()
    monkeypatch.setenv("SMOOTH_OPERATOR_CACHE", str(tmp_path / "elsewhere"))
    assert model_cache() == tmp_path / "elsewhere" / "models" / "hand_landmarker.task"
    monkeypatch.setenv("SMOOTH_OPERATOR_CACHE", "off")  # of compiled programs; this one is needed
    assert model_cache() == usual


def left_behind(cache: Path) -> list[Path]:
    return list(cache.parent.iterdir()) if cache.parent.is_dir() else []


def test_it_is_fetched_once_and_kept(server, cache):
    told: list[tuple[int, int | None]] = []
    for _ in range(2):
        path = hand_model(url=server.url, sha256=HASH, progress=lambda *at: told.append(at))
        assert path == cache
    assert cache.read_bytes() == MODEL
    assert server.asked == 1
    assert told[-1] == (len(MODEL), len(MODEL))
    assert told == sorted(told)
    assert left_behind(cache) == [cache]


@pytest.mark.parametrize(
    ("body", "length", "said"),
    [
        (b"<html>please log in</html>", 26, "not the published hand landmarker"),
        (MODEL[: len(MODEL) // 2], len(MODEL), "can't be downloaded"),
    ],
    ids=["another file", "half a file"],
)
def test_what_is_not_the_whole_file_is_refused_and_thrown_away(server, cache, body, length, said):
    server.body, server.length = body, length
    with pytest.raises(SourceError, match=said):
        hand_model(url=server.url, sha256=HASH)
    assert left_behind(cache) == []
    server.body, server.length = MODEL, len(MODEL)
    assert hand_model(url=server.url, sha256=HASH).read_bytes() == MODEL


def test_a_damaged_file_in_the_cache_is_fetched_again(server, cache):
    cache.parent.mkdir(parents=True)
    cache.write_bytes(MODEL[:-1])
    assert hand_model(url=server.url, sha256=HASH).read_bytes() == MODEL
    assert server.asked == 1


def test_a_damaged_file_is_kept_where_nothing_better_comes(server, cache):
    cache.parent.mkdir(parents=True)
    cache.write_bytes(b"old")
    server.status = 503
    with pytest.raises(SourceError, match="503"):
        hand_model(url=server.url, sha256=HASH)
    assert cache.read_bytes() == b"old"
    assert left_behind(cache) == [cache]


def test_without_a_network_one_sentence_says_what_to_do(cache):
    nobody = "http://127.0.0.1:9/hand_landmarker.task"
    with pytest.raises(SourceError) as caught:
        hand_model(url=nobody, sha256=HASH)
    for part in (nobody, str(cache), "model=PATH", SWITCH):
        assert part in str(caught.value)


def test_a_body_that_never_ends_is_cut_off(server, monkeypatch, cache):
    monkeypatch.setattr(model_file, "_LARGEST", 1000)
    monkeypatch.setattr(model_file, "_CHUNK", 100)
    counts: list[int] = []
    with pytest.raises(SourceError):
        hand_model(url=server.url, sha256=HASH, progress=lambda n, _: counts.append(n))
    assert counts[-1] <= 1100
    assert left_behind(cache) == []


def test_a_cache_that_can_not_be_made(server, cache):
    cache.parent.parent.mkdir(parents=True)
    cache.parent.write_text("a file where the folder should be")
    with pytest.raises(OutputError):
        hand_model(url=server.url, sha256=HASH)


def test_a_given_file_is_taken_as_it_is(tmp_path, monkeypatch):
    """It needs no hash: the user may have another version."""
    mine = tmp_path / "mine.task"
    mine.write_bytes(MODEL)
    assert hand_model(mine) == mine
    monkeypatch.setenv(SWITCH, str(mine))
    assert hand_model() == mine


def test_a_given_file_must_be_a_hand_landmarker(tmp_path, monkeypatch):
    with pytest.raises(SourceError, match=r"^model: there is no file"):
        hand_model(tmp_path / "nowhere.task")
    other = tmp_path / "other.task"
    other.write_bytes(b"not an archive")
    with pytest.raises(SourceError, match="is not a MediaPipe hand landmarker"):
        hand_model(other)
    with zipfile.ZipFile(other, "w") as file:
        file.writestr("face_detector.tflite", b"")
    monkeypatch.setenv(SWITCH, str(other))
    with pytest.raises(SourceError, match=rf"^{SWITCH}: .*is not a MediaPipe hand landmarker"):
        hand_model()
