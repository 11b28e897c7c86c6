"""The benchmark, end to end on a short recording; what it keeps, resumes, refuses and reports."""

import base64
import json
import re
import shutil
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from html.parser import HTMLParser
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from browser_page import new_page

from smooth_operator import Hand, Retargeter, SyntheticOperator, load_hand, read_commands
from smooth_operator.atomic_files import file_name
from smooth_operator.baselines.joint_angle import JointAngleConfig
from smooth_operator.calibration.operator_file import OperatorProfile
from smooth_operator.cli import main
from smooth_operator.errors import ConfigError, HandModelError, UnknownNameError
from smooth_operator.execution import tools_of
from smooth_operator.io.jsonable import to_json
from smooth_operator.landmarks import TIPS
from smooth_operator.metrics import METRICS
from smooth_operator.planning import make_request, plan
from smooth_operator.plugins import Entry
from smooth_operator.reporting.report_page import Plots
from smooth_operator.reporting.run_plots import Panel, Run
from smooth_operator.retargeting.alignment import AlignmentConfig
from smooth_operator.retargeting.method import MethodConfig
from smooth_operator.retargeting.palm import human_palm_axes
from smooth_operator.retargeting.presets import PRESETS
from smooth_operator.retargeting.registry import METHODS
from smooth_operator.retargeting.sbr.method import SbrConfig
from smooth_operator.retargeting.sbr.sampling import SamplingConfig
from smooth_operator.synthetic.tracker import tracker_model
from smooth_operator.teleop.pages.hand_view import view_basis
from smooth_operator_benchmark import compare, quality, read_results, suite
from smooth_operator_benchmark.cells import (
    Cell,
    Settings,
    cells_of,
    fingerprint,
    select_methods,
)
from smooth_operator_benchmark.figures import make_clip
from smooth_operator_benchmark.quality import measure_cell
from smooth_operator_benchmark.ranking import Line, best, change_verdict, failures, overall
from smooth_operator_benchmark.recordings import load_sources, parse_request, unique_names
from smooth_operator_benchmark.suite import Row

# The smallest SBR there is: it compiles in a second.
TINY = SbrConfig(sampling=SamplingConfig(samples=32, elites=8, cycles=2))
ODD = "<img src=x onerror=pwned=1>&'$x"
"""Name of a recording that a page must not take for markup."""
NAMED = {metric.name: metric for metric in METRICS}


@dataclass(frozen=True)
class PickyConfig(MethodConfig):
    """A method that can't serve any hand there is."""

    alignment: AlignmentConfig = field(default_factory=AlignmentConfig)

    def build(self, hand: Hand) -> Any:
        raise HandModelError(f"picky needs six fingers; {hand.name} has {len(hand.fingers)} <b>")


PICKY = PickyConfig()


@dataclass(frozen=True)
class Bench:
    """A finished benchmark of a good and a broken recording, with a method that refuses."""

    folder: Path
    arguments: tuple[str, ...]
    status: int
    out: str
    err: str

    @property
    def rows(self) -> list[Row]:
        return read_results(self.folder)

    @property
    def page(self) -> str:
        return (self.folder / "report.html").read_text(encoding="utf-8")


@pytest.fixture(scope="module", autouse=True)
def small() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(PRESETS["sbr"], "tiny", TINY)
        patch.setitem(METHODS.built_in, "picky", Entry(f"{__name__}:PICKY"))
        # Other work in this checkout must not look like a change of a method between two runs.
        patch.setattr("smooth_operator_benchmark.cells.code_digest", lambda *_: "fixed")
        yield


@pytest.fixture(scope="module")
def recordings(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("recordings")
    save(folder / f"{ODD}.npz", frames=60)
    (folder / "broken.npz").write_bytes(b"garbage")
    return folder


def save(path: Path, frames: int = 24, seed: int = 2, side: str = "right") -> Path:
    hand = SyntheticOperator(seed=seed, side=side).record(frames / 100)
    np.savez(path, landmarks=hand.landmarks, timestamps=hand.stamps, side=hand.side)
    return path


@pytest.fixture(scope="module")
def done(recordings, tmp_path_factory) -> Bench:
    folder = tmp_path_factory.mktemp("bench") / "new" / "out"
    options = "--methods sbr:tiny,picky --workers 0 --latency-frames 20"
    arguments = ("bench", str(recordings), "--output", str(folder), *options.split())
    status, out, err = captured(arguments)
    return Bench(folder, arguments, status, out, err)


def captured(arguments: Sequence[object]) -> tuple[int, str, str]:
    import contextlib
    import io

    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        status = main([str(argument) for argument in arguments])
    return status, out.getvalue(), err.getvalue()


@pytest.fixture
def copied(done, tmp_path) -> tuple[Path, tuple[str, ...]]:
    """A copy of the finished folder, and the command that made it."""
    folder = tmp_path / "copy"
    shutil.copytree(done.folder, folder)
    return folder, tuple(str(folder) if a == str(done.folder) else a for a in done.arguments)


@pytest.fixture
def count(monkeypatch) -> list[str]:
    """What is measured from now on."""
    begun: list[str] = []

    def counted(task: tuple[Cell, Settings]) -> Any:
        begun.append(task[0].method)
        return measure_cell(task)

    def timed(cells: Any, *rest: Any) -> Any:
        begun.append("latency")
        return quality.measure_latency(cells, *rest)

    monkeypatch.setattr(suite, "measure_cell", counted)
    monkeypatch.setattr(suite, "measure_latency", timed)
    return begun


def test_every_cell_has_a_row_with_figures_or_a_reason(done):
    assert done.status == 1, done.err  # some failed, and the rest was done
    rows = {(row["recording"], row["method"]): row for row in done.rows}
    assert set(rows) == {(name, m) for name in (ODD, "broken") for m in ("sbr", "picky")}
    good = rows[ODD, "sbr"]
    assert (good["status"], good["reason"], good["preset"]) == ("ok", None, "tiny")
    assert set(good["metrics"]) >= {metric.name.split(".")[0] for metric in METRICS}
    assert good["metrics"]["frames"] == 60
    assert good["hardware"]["cpu_cores"] >= 1
    assert good["versions"]["jax"]
    assert good["date"].startswith("20")
    assert good["source"]["frames"] == [0, 60]
    assert set(good["fingers"]) == set(load_hand().fingers)

    taken = good["latency"]
    assert (taken["frames"], taken["warm_up"]) == (20, 15)
    assert 0 < taken["p50"] <= taken["p95"] <= taken["p99"]
    assert taken["first"] > 0
    assert good["metrics"]["latency_ms"]["p95"] == taken["p95"]

    refused, broken = rows[ODD, "picky"], rows["broken", "sbr"]
    assert "six fingers" in refused["reason"]
    assert "not a recording" in broken["reason"]
    for row in (refused, broken, rows["broken", "picky"]):
        assert row["status"] == "error"
        assert row["metrics"] is row["latency"] is None


def test_the_commands_of_a_cell_are_the_librarys(done, recordings):
    (row,) = [row for row in done.rows if row["status"] == "ok"]
    commands = read_commands(done.folder / row["cell"])
    recording = SyntheticOperator(seed=2).record(0.6)
    direct, _ = Retargeter(config=TINY).run(recording)
    np.testing.assert_array_equal(commands.joint_positions, direct.joint_positions)
    np.testing.assert_array_equal(commands.stamps, recording.stamps)


def test_the_terminal_shows_the_table_and_the_failures_once(done):
    assert ODD in done.out
    assert done.out.count("not a recording") == 1
    assert "broken on mimic_p050 right, all 2 methods" in done.out
    assert "skipped" in done.err  # said before the long work
    assert "3 of 4 rows failed" in done.err


class Page(HTMLParser):
    """What a browser would look at: links, identifiers, text, tags."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.links: list[str] = []
        self.ids: list[str] = []
        self.tags: list[str] = []
        self.texts: list[str] = []
        self.feed(text)
        self.text = " ".join(self.texts)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        links = ("src", "href", "xlink:href", "action", "data", "poster", "srcset")
        self.links += [value or "" for name, value in attrs if name in links]
        self.ids += [value or "" for name, value in attrs if name == "id"]

    def handle_data(self, data: str) -> None:
        self.texts.append(data)


def test_the_report_needs_nothing_from_outside_and_escapes_names_of_files(done):
    page = Page(done.page)
    assert all(link.startswith(("#", "data:")) for link in page.links)
    assert not {"link", "iframe", "object", "embed", "base", "b"} & set(page.tags)
    assert not re.search(r"https?://|@import|//[a-z0-9.]+\.[a-z]{2,}/", done.page)
    anchors = {link[1:] for link in page.links if link.startswith("#")}
    assert anchors <= set(page.ids)
    assert len(page.ids) == len(set(page.ids))  # plots of one page must not share names
    assert set(re.findall(r"url\(#([^)]+)\)", done.page)) <= set(page.ids)
    assert "<img src=x" not in done.page
    assert any(ODD in text for text in page.texts)
    assert any("six fingers" in text and "<b>" in text for text in page.texts)


def test_the_report_holds_all_that_was_asked_for(done):
    text = Page(done.page).text
    for words in ("Failures", "DexPilot, paper", "other data", "Finger by finger", "All metrics"):
        assert words in text, words
    assert len(re.findall(r'<img src="data:image/webp;base64,\w', done.page)) == 1
    plots = {path.name: path.read_bytes() for path in (done.folder / "plots").iterdir()}
    assert "sheet-mimic_p050-right.webp" in plots
    for kind in ("accuracy-smoothness-", "latency-", "fingertips-", "joints-"):
        png, svg = sorted(name for name in plots if name.startswith(kind))
        assert plots[png].startswith(b"\x89PNG")
        assert b"</svg>" in plots[svg]
    summary = (done.folder / "summary.md").read_text(encoding="utf-8")
    assert "| `sbr:tiny` | " in summary
    assert "--methods sbr:tiny,picky" in summary
    clips = re.findall(r'<script type="application/json">(.*?)</script>', done.page, re.DOTALL)
    (clip,) = [json.loads(clip) for clip in clips]
    assert [pane["method"] for pane in clip["panes"]] == ["sbr:tiny"]
    points = np.frombuffer(base64.b64decode(clip["panes"][0]["robot"]), "<i2")
    assert points.size == len(clip["times"]) * 63
    assert 0 < np.abs(points[points > -32768]).max() <= 1.8 * clip["reach"]


def test_the_sheet_alone(recordings, tmp_path):
    out = tmp_path / "out"
    good = recordings / f"{ODD}.npz"
    arguments = ("bench", good, "--methods", "sbr:tiny", "--output", out, "--workers", 0, "--sheet")
    status, stdout, stderr = captured(arguments)
    assert status == 0, stderr
    files = {path.name for path in out.iterdir()}
    assert files == {"config.json", "results.json", "cells", "sheet-mimic_p050-right.png"}
    assert (out / "sheet-mimic_p050-right.png").read_bytes().startswith(b"\x89PNG")
    assert "results.json and sheet-mimic_p050-right.png" in stderr
    assert "extension" in stdout


def test_only_a_missing_or_damaged_cell_is_done_again(copied, count, done):
    folder, arguments = copied
    status, _, err = captured((*arguments, "--no-report"))
    assert status == 1
    assert count == ["picky"]  # what failed is tried again
    assert "quality: 1 of 2 cells are unchanged and not measured again" in err
    assert read_results(folder) == done.rows
    (row,) = [row for row in done.rows if row["status"] == "ok"]
    commands = folder / row["cell"]
    latency_file = commands.with_suffix(".latency.json")

    def again() -> list[str]:
        count.clear()
        captured((*arguments, "--no-report"))
        return sorted(set(count) - {"picky"})

    whole = commands.read_bytes()
    commands.unlink()
    assert again() == ["sbr"]
    assert commands.read_bytes() == whole
    commands.write_bytes(whole[:-100])
    assert again() == ["sbr"]
    config = commands.with_suffix(".json")
    config.write_text(config.read_text(encoding="utf-8")[:-20], encoding="utf-8")
    assert again() == ["sbr"]
    # The commands of another run beside this configuration, as a crash between the two leaves.
    read = read_commands(commands)
    with np.load(commands, allow_pickle=False) as file:
        arrays = dict(file)
    np.savez(commands, **arrays | {"joint_positions": read.joint_positions + 1e-9})
    assert again() == ["sbr"]
    latency_file.unlink()
    assert again() == ["latency"]
    latency_file.write_text("[]", encoding="utf-8")
    assert again() == ["latency"]
    assert again() == []


def test_what_is_asked_for_in_another_way_is_done_again(recordings):
    path = str(recordings / f"{ODD}.npz")

    def of(text: str, method: str = "sbr:tiny", **changes: Any) -> str:
        settings = Settings(output=Path("out"), **changes)
        (source,) = load_sources([parse_request(text)])
        (cell,) = cells_of([source], settings, select_methods((method,)))
        return fingerprint(cell, settings)

    same = of(path)
    assert of(path) == same
    assert of(path, workers=3, latency_frames=7) == same
    changed = {of(path, seed=1), of(path, definition="paper"), of(path, "sbr:paper")}
    changed |= {of(f"{path}@:30"), of("synthetic:2")}
    for human in ("pinky", "ring"):  # which drives the robot's pinky
        changed.add(of(path, fingers={"thumb": "thumb", "pinky": human}))
    changed.add(of(path, operator=OperatorProfile("right", {"index": 0.08})))
    assert len({same, *changed}) == 9


def test_ctrl_c_keeps_what_is_finished(recordings, tmp_path, monkeypatch):
    good, out = recordings / f"{ODD}.npz", tmp_path / "out"
    options = "--methods sbr:tiny --workers 0 --latency-frames 0 --no-report --quiet"
    parts = (f"{good}@:12", f"{good}@12:24")
    arguments = ("bench", *parts, "--output", out, *options.split())
    begun = []

    def stopped(task: tuple[Cell, Settings]) -> Any:
        begun.append(task)
        if len(begun) == 2:
            raise KeyboardInterrupt
        return measure_cell(task)

    monkeypatch.setattr(suite, "measure_cell", stopped)
    status, stdout, stderr = captured(arguments)
    assert (status, stdout) == (130, "")
    assert "run the same command again to continue" in stderr
    assert not (out / "results.json").exists()
    assert len(list((out / "cells").glob("*.npz"))) == 1
    status, stdout, stderr = captured(arguments)
    assert status == 0, stderr
    assert len(begun) == 3  # the one it was at
    assert [row["source"]["frames"] for row in read_results(out)] == [[0, 12], [12, 24]]
    assert all(row["latency"] is None for row in read_results(out))
    assert stdout == ""
    assert {path.name for path in out.iterdir()} == {"config.json", "results.json", "cells"}


USER_ERRORS = """
good.npz --methods srb          | Did you mean 'sbr'?
good.npz --methods sbr:papr     | Did you mean 'paper'?
good.npz --methods ,            | at least one method
good.npz --hands mimic_p5       | Did you mean 'mimic_p050'?
good.npz --hands ''             | at least one hand
good.npz --frames half          | range A:B
good.npz --workers -1           | workers must be 0 or more
good.npz --latency-frames -1    | latency_frames must be 0 or more
good.npz@fast                   | is not a setting of a recording
synthetic:x                     | whole number
gone.npz                        | no such file
broken.npz                      | not a recording
empty                           | contain no recordings
good.npz --frames 900:          | selects nothing
good.npz --output foreign       | files that are not from an earlier benchmark
good.npz --output good.npz      | it is a file; give the name of a folder
good.npz --compare gone.json    | no such file
good.npz --compare cut.json     | damaged
good.npz --compare object.json  | not a list
good.npz --compare rows.json    | row 0 lacks hand
good.npz --compare metrics.json | metrics of row 0
"""
"""What a user gets wrong, and what the message must say."""


def test_user_errors_come_before_the_long_work(done, recordings, tmp_path, monkeypatch):
    monkeypatch.setattr(suite, "measure_cell", lambda _: pytest.fail("the long work began"))
    foreign, empty = tmp_path / "foreign", tmp_path / "empty"
    foreign.mkdir()
    empty.mkdir()
    (foreign / "config.json").write_text('{"program": "smooth-operator", "command": "demo"}')
    results = {
        "cut": "[{",
        "object": "{}",
        "rows": '[{"recording": "a"}]',
        "metrics": json.dumps([done.rows[0] | {"metrics": 3}]),
    }
    for name, content in results.items():
        (tmp_path / f"{name}.json").write_text(content, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    shutil.copy(recordings / f"{ODD}.npz", "good.npz")
    shutil.copy(recordings / "broken.npz", "broken.npz")
    for line in USER_ERRORS.strip().splitlines():
        words, message = (part.strip() for part in line.split("|"))
        arguments = [word.strip("'") for word in words.split()]
        to = [] if "--output" in arguments else ["--output", "out"]
        status, stdout, stderr = captured(("bench", *arguments, *to))
        assert (status, stdout) == (2, ""), words
        assert message in stderr, (words, stderr)
        assert "Traceback" not in stderr
    assert not Path("out").exists()
    assert [path.name for path in foreign.iterdir()] == ["config.json"]


def test_comparison_on_terminal_and_page(copied, done, tmp_path):
    folder, arguments = copied
    rows = done.rows
    (good,) = [row for row in rows if row["status"] == "ok"]
    good["metrics"]["cosine_similarity"] -= 0.1  # it was worse
    good["metrics"]["flatness"] /= 2  # it was better
    good["source"]["sha256"] = "other"
    good["hardware"]["cpu"] = "<slow>"
    gone = good | {"method": "gone"}
    former = tmp_path / "former"
    former.mkdir()
    (former / "results.json").write_text(json.dumps([*rows, gone]), encoding="utf-8")
    _, out, _ = captured((*arguments, "--compare", former))
    for words in ("+0.1 ▲", "▼", "other frames", "another machine", "only there"):
        assert words in out, words
    page = Page((folder / "report.html").read_text(encoding="utf-8")).text
    for words in ("Comparison", "+0.1 ▲", "gone:tiny"):
        assert words in page, words
    same = compare(done.rows, done.rows, "itself")
    assert same.count("better") == same.count("worse") == 0
    (cell,) = same.cells
    assert cell.notes == ()
    assert {change.difference for change in cell.changes} == {0.0}


def test_the_path_of_a_hand_in_a_plots_name_is_no_folder(tmp_path):
    from matplotlib.figure import Figure

    for stem in ("latency-/hands/my hand.toml", "latency-../../other.toml", "latency-leap_hand"):
        Plots(tmp_path / "plots").element(Figure(), stem, "a figure")
    name = file_name("../a b/ü<>:" + 200 * "x", ("one",))
    assert re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9.-]{1,109}", name)
    assert file_name("a", ("one",)) != file_name("a", ("two",))
    names = sorted(each.name for each in (tmp_path / "plots").glob("*.svg"))
    assert [name[:24] for name in names] == [
        "latency-..-..-other.toml",
        "latency-hands-my-hand.to",
        "latency-leap_hand.svg",
    ]


@pytest.mark.parametrize(
    ("name", "now", "before", "expected"),
    [
        ("cosine_similarity", 0.999, 0.998, "better"),
        ("cosine_similarity", 0.998, 0.999, "worse"),
        ("scale_ratio", 1.02, 0.97, "better"),
        ("scale_ratio", 1.03, 0.97, "same"),
        ("flatness", 2e-6, 3e-6, "better"),
        ("flatness", 3.001e-6, 3e-6, "same"),
        ("latency_ms.p50", 1.08, 1.0, "same"),
        ("frames", 10, 20, "same"),
    ],
)
def test_verdicts_follow_the_goal(name, now, before, expected):
    assert change_verdict(NAMED[name], now, before) == expected


def test_best_knows_goals_ties_and_who_is_incomplete():
    def top(name: str, *values: float | None, short: int | None = None) -> set[int]:
        lines = [
            Line(str(i), {name: v}, count=1 if i == short else 2, of=2)
            for i, v in enumerate(values)
        ]
        return best(lines, NAMED[name])

    assert top("scale_ratio", 0.9, 1.05, 0.97) == {2}
    assert top("scale_ratio", 1.03, 0.97, 0.9) == {0, 1}  # as far from one
    assert top("flatness", 3e-6, 1e-6, None) == {1}
    assert top("flatness", 3e-6, 1e-6, 2e-6, short=1) == {2}
    assert top("workspace_utilisation", 0.1, 0.3) == {1}
    assert top("cosine_similarity", 0.99991, 0.99992, 0.5) == {0, 1}  # look the same
    assert top("cosine_similarity", 0.9, 0.9) == set()
    assert top("cosine_similarity", 0.9) == set()
    assert top("frames", 3, 4) == set()


def test_overall_is_a_mean_over_the_recordings_that_can_be_read():
    def row(recording: str, method: str, value: float | None) -> Row:
        names = {"recording": recording, "hand": "h", "side": "right", "method": method}
        metrics = None if value is None else {"flatness": value}
        state = {"status": "error" if value is None else "ok", "reason": "no", "metrics": metrics}
        return names | {"preset": "p"} | state

    values = {"a": (1.0, 2.0), "b": (3.0, None), "c": (None, None)}
    rows = [
        row(name, m, v) for name, both in values.items() for m, v in zip("mn", both, strict=True)
    ]
    first, second = overall(rows, [NAMED["flatness"]])
    assert (first.values["flatness"], first.count, first.of) == (2.0, 2, 2)
    assert (second.values["flatness"], second.count, second.of) == (2.0, 1, 2)
    missing = [("b on h right", "n:p", "no"), ("c on h right", "all 2 methods", "no")]
    assert failures(rows) == missing


def test_requests_and_their_settings(tmp_path):
    request = parse_request("x.npz@30hz,left,1:9", frames=":5", rate=60, side="right")
    assert (request.path, request.rate, request.side, request.frames) == (
        Path("x.npz"),
        30.0,
        "left",
        "1:9",
    )
    assert parse_request("x.npz", frames=":5", rate=60).frames == ":5"
    operator = parse_request("synthetic:7@50hz", rate=60)
    assert (operator.path, operator.seed, operator.rate) == (None, 7, 50.0)
    assert parse_request("synthetic", rate=60).rate is None  # it needs no rate of its own
    behind = parse_request("synthetic:7@headset,left").operator()
    assert behind == SyntheticOperator(7, "left", tracker=tracker_model("headset", 7))
    odd = save(tmp_path / "me@home.npz")
    assert parse_request(str(odd)).path == odd
    requests = (f"{odd}@Camera", str(odd), f"{odd}@:9", "synthetic")
    trackers = [source.tracker for source in load_sources(map(parse_request, requests))]
    assert trackers == ["camera", "other", "synthetic"]  # the same frames are one source
    (source,) = load_sources([parse_request("synthetic")])
    glove = replace(source.recording, meta={"format": "manus"})
    for name, tracker in (("x.npz", "glove"), ("x.npz@headset", "headset")):
        assert replace(source, request=parse_request(name), recording=glove).tracker == tracker


def test_sources_have_names_that_tell_them_apart(tmp_path):
    for i, folder in enumerate(("a", "b")):
        (tmp_path / folder).mkdir()
        save(tmp_path / folder / "run.npz", frames=12, seed=i)
    operator = SyntheticOperator(seed=5).record(0.12)
    np.save(tmp_path / "b" / "plain.npy", operator.landmarks)
    path = str(tmp_path / "b" / "plain.npy")
    asked = [str(tmp_path), f"{path}@50hz,:6", f"{path}@50hz,0:6", str(tmp_path / "a" / "run.npz")]
    sources = load_sources([parse_request(text, rate=100) for text in asked])
    names = [source.name for source in sources]
    assert names == ["a/run", "plain", "b/run", "plain[0:6]"]
    assert all(source.recording is not None for source in sources)
    # A rate is for those without stamps: the others keep their own.
    rates = [source.recording.rate_hz for source in sources if source.recording]
    np.testing.assert_allclose(rates, [100, 100, 100, 50])
    assert sources[1].facts["side_assumed"]
    assert not sources[0].facts["side_assumed"]
    assert unique_names([("x", Path("x.npz")), ("x", Path("x.npy"))]) == ["x.npz", "x.npy"]


def test_methods_by_name(tmp_path):
    assert [c.method for c in select_methods(("all",))] == list(PRESETS)
    chosen = select_methods(("sbr:tiny", "sbr:all", "sbr"))
    assert [c.preset for c in chosen] == ["tiny", "realtime", "paper", "offline"]
    assert chosen[0].config is TINY
    with pytest.raises(UnknownNameError, match="tiny"):
        select_methods((f"sbr:{save(tmp_path / 'x.npz')}",))  # it has no model to be read
    with pytest.raises(ConfigError, match="at least one"):
        select_methods(())


@pytest.mark.parametrize("side", ["right", "left"])
def test_the_view_has_fingers_up_and_the_thumb_on_its_side(side):
    hand = load_hand("mimic_p050", side)
    basis = view_basis(hand)
    np.testing.assert_allclose(basis @ basis.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(basis) == pytest.approx(1)
    at = dict(zip(hand.tree.names, hand.landmark_positions(hand.neutral) @ basis.T, strict=True))
    assert at["middle_mcp"][1] > at["wrist"][1]
    right = at["index_mcp"][0] - at["pinky_mcp"][0]
    assert right * (1 if side == "right" else -1) > 0.02
    assert basis[2] @ human_palm_axes(hand)[2] > 0.5  # the palm is in sight


def test_a_clip_holds_landmarks_and_objects_to_a_tenth_of_a_millimetre():
    hand = load_hand()
    rng = np.random.default_rng(4)
    stamps = np.arange(400) / 100
    robot = 0.1 * rng.standard_normal((400, 21, 3))
    human = robot.copy()
    human[:, 7] = np.nan
    joints = np.zeros((400, len(hand.joint_names)))
    run = Run("m", human, robot, joints, objects=robot[:, 5:9])
    runs = (run, replace(run, objects=None))
    panel = Panel(("r", "h", "right"), hand, stamps, runs, ((0, 3),))
    clip = make_clip(panel, {"m": "#000000"}, hands=3)
    assert len(clip["humans"]) == 1  # shared by the two
    frames = [round(100 * t) for t in clip["times"]]
    assert 100 < len(frames) < 130  # 30 Hz
    pane, other = clip["panes"]
    there, seen, objects = (
        np.frombuffer(base64.b64decode(text), "<i2").reshape(len(frames), -1, 3) / 1e4
        for text in (pane["robot"], clip["humans"][0], pane["objects"])
    )
    assert (seen[:, 7] == -3.2768).all()
    turned = robot[frames] @ view_basis(hand).T
    np.testing.assert_allclose(there + turned[0, 0] - there[0, 0], turned, atol=1.1e-4)
    np.testing.assert_allclose(seen[:, TIPS[0]], there[:, TIPS[0]], atol=1e-9)
    np.testing.assert_array_equal(objects, there[:, 5:9])
    assert other["objects"] is None
    assert clip["objectEdges"] == [[0, 3]]
    tight = make_clip(panel, {"m": "#000000"}, hands=10**6)
    assert len(tight["times"]) == 40  # many clips share the page


def test_methods_take_turns_and_one_that_fails_stops_no_other(recordings, monkeypatch):
    order: list[str] = []
    built = quality._built

    class Stub:
        def __init__(self, name: str) -> None:
            self.name = name

        def init(self) -> int:
            return 0

        def step(self, state: int, _: object) -> tuple[int, Any]:
            order.append(self.name)
            return state + 1, SimpleNamespace(latency_ms=float(state))

    def stub(cell: Any, seed: int) -> Any:
        return built(cell, seed) if cell.method == "picky" else Stub(cell.preset)

    monkeypatch.setattr(quality, "_built", stub)
    sources = load_sources([parse_request(str(recordings / f"{ODD}.npz"))])
    methods = select_methods(("sbr:tiny", "sbr:paper", "picky"))
    cells, told = cells_of(sources, Settings(output=Path("out")), methods), list[str]()
    *good, bad = quality.measure_latency(cells, 500, 0, lambda cell: told.append(cell.method))
    turns = [order[i] for i in range(0, len(order), quality.BLOCK)]
    assert turns == ["tiny", "paper", "paper", "tiny", "tiny", "paper"]
    for one in good:  # first, warm-up, then what counts, in a state that goes on
        assert (one.first_ms, one.reason) == (0.0, None)
        np.testing.assert_array_equal(one.samples_ms, np.arange(16, 60))
    assert told == ["sbr", "sbr", "picky"]
    assert "six fingers" in bad.reason
    assert bad.facts["p50"] is None


@pytest.mark.browser
def test_the_page_plays_without_complaints(done, chromium):
    page, problems = new_page(chromium, 700, 900)
    page.on("request", lambda r: r.url.startswith(("file:", "data:")) or problems.append(r.url))
    page.goto((done.folder / "report.html").as_uri())
    read: Callable[[], str] = page.locator(".player output").inner_text
    pixels = "c => new Set(c.getContext('2d').getImageData(0, 0, c.width, c.height).data).size"
    for scheme in ("dark", "light"):
        page.emulate_media(color_scheme=scheme)
        assert page.locator(".player canvas").evaluate(pixels) > 20  # something is drawn
    before = read()
    page.get_by_role("button", name="Play").click()
    page.wait_for_function(
        "was => document.querySelector('.player output').textContent !== was", arg=before
    )
    page.get_by_role("button", name="Pause").click()
    page.locator(".player input").fill("0")
    assert read() == "0.00 s"
    assert page.evaluate("document.documentElement.scrollWidth") <= 700  # nothing sticks out
    page.emulate_media(media="print")
    assert not page.locator(".player").is_visible()
    assert page.evaluate("window.pwned") is None
    page.close()
    assert problems == []


def test_methods_with_the_same_settings_share_no_retargeter(recordings):
    (source,) = load_sources([parse_request(str(recordings / f"{ODD}.npz"))])
    first = make_request(hand="mimic_p050", method="joint_angle")
    plans = [
        plan(source.recording, replace(first, config=config))
        for config in (JointAngleConfig(), PICKY)
    ]
    assert to_json(JointAngleConfig()) == to_json(PICKY)
    assert tools_of(plans[0]) != tools_of(plans[1])
