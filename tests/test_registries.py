"""Registries of parts: what they list, load and refuse. An installed plugin: test_plugin.py."""

import inspect
import re
from collections.abc import Callable
from dataclasses import dataclass, field
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from metrics_cases import make_trace

from smooth_operator import HandRecording, plugins, read_recording
from smooth_operator.cli.console import print_metrics
from smooth_operator.errors import (
    ConfigError,
    HandModelError,
    RecordingError,
    UnknownNameError,
    did_you_mean,
)
from smooth_operator.formats.registry import READERS, Reader
from smooth_operator.hands.registry import HANDS, MODELS, hand_names, known_hands, load_hand
from smooth_operator.metrics import Metric, Trace, evaluate
from smooth_operator.metrics.table import REGISTRY as METRIC_REGISTRY
from smooth_operator.metrics.table import add_metrics, plugin_metrics
from smooth_operator.plugins import Entry, Registry
from smooth_operator.reporting.drawing import method_label
from smooth_operator.retargeting.preset_files import method_config
from smooth_operator.retargeting.presets import (
    PRESETS,
    default_preset,
    live_presets,
    loadable_presets,
    method_names,
)
from smooth_operator.retargeting.registry import METHODS
from smooth_operator.retargeting.sbr.method import SbrConfig
from smooth_operator.synthetic import SyntheticOperator
from smooth_operator.teleop.components import SINKS, SOURCES, build_component
from smooth_operator_benchmark.cells import select_methods
from smooth_operator_benchmark.ranking import columns

OWN = SbrConfig(settle_rounds=3)
TWO = {"fast": OWN, "slow": SbrConfig(settle_rounds=30)}
EMPTY: dict[str, Any] = {}


@dataclass(frozen=True)
class Unset(SbrConfig):
    """Settings that have no defaults."""

    name: str = field(kw_only=True)


SPEC = MODELS / "allegro_hand.left.toml"


@pytest.fixture
def broken(monkeypatch, tmp_path) -> str:
    """The target of a module that can't be imported."""
    (tmp_path / "broken_plugin.py").write_text("raise RuntimeError('no\\nlicence')\n")
    monkeypatch.syspath_prepend(tmp_path)
    return "broken_plugin:CONFIG"


@pytest.fixture
def offer(monkeypatch) -> Callable[..., None]:
    """Sets the parts that installed distributions offer in a group."""

    def set_parts(kind: str, **parts: Entry) -> None:
        group = f"smooth_operator.{kind}"
        offered = {group: parts}
        monkeypatch.setattr("smooth_operator.plugins._installed", lambda of: offered.get(of, {}))

    return set_parts


@pytest.mark.parametrize(
    ("registry", "text", "extra"),
    [(SINKS, "leap:/dev/ttyUSB0", "dynamixel"), (SOURCES, "ros2:/hand", "ros2")],
)
def test_a_device_without_its_distribution_names_the_install_command(registry, text, extra, offer):
    offer("sinks")
    name = text.partition(":")[0]
    with pytest.raises(ConfigError) as caught:
        build_component(registry, text)
    assert str(caught.value) == (
        f"{registry.kind} {name!r} is in the distribution smooth-operator-devices, which is not "
        "installed; in a clone of the repository, run: "
        f'python -m pip install ".[teleop]" "./packages/smooth_operator_devices[{extra}]"'
    )
    assert re.search(rf"\n  not installed: .*\b{name}\b", registry.describe())
    offer("sinks", leap=Entry("somewhere:LeapSink", "from devices", "smooth-operator-devices"))
    assert "  leap    the LEAP hand (dynamixel extra)\n  not installed: " in SINKS.describe()


def test_a_published_method_missing_from_an_old_installation_names_the_command(offer):
    offer("methods")
    assert list(METHODS) == ["sbr", "smooth"]
    with pytest.raises(ConfigError, match=r"older than the code: run git pull .* pip install"):
        method_config("dexpilot")


def test_the_distributions_own_method_comes_before_another_of_the_same_name(monkeypatch):
    points = [
        EntryPoint("ako", "other:AKO", "smooth_operator.methods"),
        *entry_points(group="smooth_operator.methods"),
    ]
    monkeypatch.setattr("importlib.metadata.entry_points", lambda group: points)
    monkeypatch.setattr(plugins, "_installed", inspect.unwrap(plugins._installed))
    assert METHODS["ako"].target == "smooth_operator.baselines.slsqp_method:AKO_PRESETS"


def test_a_method_of_ones_own_is_named_by_its_module():
    assert method_config(f"{__name__}:OWN") is OWN
    assert method_config(f"{__name__}:TWO") is OWN
    assert method_config(f"{__name__}:TWO", "slow") is TWO["slow"]
    assert (
        method_config("smooth_operator.retargeting.sbr.method:SbrConfig") == SbrConfig()
    )  # the class itself
    assert default_preset("smooth_operator.retargeting.sbr.method:SbrConfig") == "default"
    chosen = select_methods((f"{__name__}:TWO", f"{__name__}:TWO:slow", "sbr:paper"))
    assert [c.config for c in chosen] == [*TWO.values(), method_config("sbr", "paper")]
    labels = [method_label(c.method, c.preset) for c in chosen]
    assert labels == [f"{__name__}:TWO", f"{__name__}:TWO:slow", "sbr:paper"]


@pytest.mark.parametrize(
    ("name", "error", "says"),
    [
        (f"{__name__}:EMPTY", ConfigError, "has no preset"),
        (f"{__name__}:Path", ConfigError, "can't be a method: it must be a MethodConfig"),
        (f"{__name__}:Unset", ConfigError, "not a class that needs arguments"),
        (f"{__name__}:NONE", ConfigError, "has no 'NONE'. Available methods: sbr, smooth"),
        ("srb", UnknownNameError, "Did you mean 'sbr'?"),
        ("srb:paper", UnknownNameError, "unknown method"),
    ],
)
def test_what_is_no_method_is_refused(name, error, says):
    with pytest.raises(error, match=re.escape(says)):
        method_config(name)


def test_a_hand_and_its_sink_find_each_other():
    for name, names, hint in (
        ("revo2", ("leap_hand", "brainco_revo2"), "'brainco_revo2'"),
        ("brainco_revo2", ("leap", "revo2"), "'revo2'"),
        ("linker", ("linker_l10", "linker_l20", "leap_hand"), "'linker_l10' or 'linker_l20'"),
    ):
        assert did_you_mean(name, names) == f" Did you mean {hint}?"
        assert did_you_mean("xyz", names) == ""


def test_a_broken_plugin_is_an_error_only_where_it_is_asked_for(broken, offer, capsys):
    offer("methods", sbr=Entry(broken), cracked=Entry(broken, "from cracks", "cracks"))
    assert method_names()[-1] == "cracked"
    assert "cracked" in METHODS.describe()
    assert method_config("sbr") is PRESETS["sbr"]["realtime"]  # a built-in name stays
    for _ in range(2):
        assert "cracked" not in loadable_presets()
        assert "cracked" not in live_presets()
        assert "cracked" not in {choice.method for choice in select_methods(("all",))}
    says = f"{broken} (of cracks) can't be imported: RuntimeError: no licence"
    assert capsys.readouterr().err == f"method 'cracked' is skipped: {says}\n"  # once
    with pytest.raises(ConfigError, match=re.escape(says)):
        method_config("cracked")
    with pytest.raises(ConfigError, match="no licence"):  # a built-in part is not left out
        Registry("toy", {"toy": Entry(broken)}).loadable()


def test_a_hand_of_ones_own_is_named_by_its_module():
    own = load_hand(f"{__name__}:SPEC")
    assert (own.name, own.spec.side, own.spec.mirror) == ("allegro_hand", "left", False)
    hand = load_hand(f"{__name__}:SPEC", "right")
    assert (hand.name, hand.spec.side, hand.spec.mirror) == ("allegro_hand", "right", True)
    assert hand.actuated == load_hand("allegro_hand").actuated


def test_a_plugins_hand_is_a_spec_file_or_a_folder(broken, offer, capsys):
    offer(
        "hands",
        allegro_hand=Entry(broken),
        cracked=Entry(broken, "from cracks", "cracks"),
        other=Entry(f"{__name__}:SPEC", "from cracks", "cracks"),
    )
    assert hand_names()[len(HANDS.built_in) :] == ("cracked", "other")
    assert {*known_hands()} == {*HANDS.built_in}
    notes = capsys.readouterr().err
    assert "hand 'cracked' is skipped: broken_plugin:CONFIG (of cracks)" in notes
    with pytest.raises(HandModelError, match="describes the hand 'allegro_hand'; expected 'other'"):
        load_hand("other")
    with pytest.raises(HandModelError, match=r"MODELS: expected one hand in .*models, not"):
        load_hand("smooth_operator.hands.registry:MODELS")
    with pytest.raises(ConfigError, match=r"TWO can't be a hand: it must be the path of a spec"):
        load_hand(f"{__name__}:TWO")


def read_rows(path: Path, rate: float | None, side: Any, layout: str | None) -> HandRecording:
    """A text of numbers, 63 in a row."""
    frames = np.loadtxt(path, delimiter=",").reshape(-1, 21, 3)
    return HandRecording(frames, np.arange(len(frames)) / (rate or 100.0), side or "right")


ROWS = Reader("a .rows file", read_rows, suffixes=(".rows",))
WRONG = Reader("a .wrong file", lambda *given: "hands", suffixes=(".wrong",))


def test_a_plugins_reader_recognises_its_files(broken, offer, tmp_path, capsys):
    recording = SyntheticOperator(seed=1).record(0.1)
    text = "\n".join(
        ",".join(map(repr, row)) for row in recording.landmarks.reshape(-1, 63).tolist()
    )
    for suffix in ("rows", "wrong", "pkl", "other"):
        (tmp_path / f"a.{suffix}").write_text(text)
    offer(
        "readers",
        cracked=Entry(broken),
        rows=Entry(f"{__name__}:ROWS"),
        wrong=Entry(f"{__name__}:WRONG"),
        thing=Entry(f"{__name__}:OWN"),
    )
    read = read_recording(tmp_path / "a.rows", rate=50.0)
    np.testing.assert_allclose(read.landmarks, recording.landmarks)
    assert (read.rate_hz, read.side, read.meta["format"]) == (50.0, "right", "rows")
    assert READERS.load("files").matches(tmp_path / "a.rows")  # in a folder of recordings
    (tmp_path / "b.rows").write_text("1,2,three")
    with pytest.raises(RecordingError, match=r"b\.rows: can't be read as a \.rows file: could not"):
        read_recording(tmp_path / "b.rows")
    with pytest.raises(ConfigError, match="must return a HandRecording, not str"):
        read_recording(tmp_path / "a.wrong")
    with pytest.raises(RecordingError, match="this is a pickle"):
        read_recording(tmp_path / "a.pkl")
    with pytest.raises(RecordingError, match=r"own \.h5 file, .* a \.rows file and a \.wrong file"):
        read_recording(tmp_path / "a.other")
    notes = capsys.readouterr().err.splitlines()
    skipped = [note.partition(" is skipped")[0] for note in notes]
    assert skipped == ["reader 'cracked'", "reader 'thing'"]
    with pytest.raises(ConfigError, match=r"must have magic \(first bytes\) or suffixes"):
        Reader("anything", read_rows)


def _travel(trace: Trace) -> float:
    return float(np.abs(np.diff(trace.joint_positions, axis=0)).sum())


def _fails(trace: Trace) -> float:
    raise ZeroDivisionError("no frames")


TRAVEL = Metric("travel", "rad", "down", "way of all joints", compute=_travel, short="way")
TAKEN = Metric("flatness", "", "up", "of another")
SEVERAL = (TRAVEL, Metric("fails", "", "up", "never there", "motion", _fails))


def test_a_plugins_metric_is_measured_and_shown(broken, offer, capsys):
    human = np.broadcast_to(SyntheticOperator(seed=1).record(0.1).landmarks, (10, 21, 3))
    q = np.linspace(0.0, 1.0, 10)[:, None] * [1.0, 2.0]
    trace = make_trace(human, joint_positions=q, joint_limits=np.tile([-9.0, 9.0], (2, 1)))
    before = evaluate(trace)
    offer(
        "metrics",
        travel=Entry(f"{__name__}:TRAVEL"),
        fails=Entry(f"{__name__}:SEVERAL"),
        other=Entry(f"{__name__}:SEVERAL"),
        cracked=Entry(broken),
    )
    values = evaluate(trace, extra={"first_command_s": 1.0})
    assert list(values) == [*before, "travel", "fails", "first_command_s"]
    assert {name: values[name] for name in before} == before
    assert values["travel"] == pytest.approx(3.0)
    assert values["fails"] is None
    notes = capsys.readouterr().err
    assert "metric 'fails' is skipped: ZeroDivisionError: no frames" in notes
    assert "metric 'cracked' is skipped: broken_plugin:CONFIG" in notes
    assert "SEVERAL can't be a metric: it must be a Metric called 'other'" in notes
    with pytest.raises(ConfigError, match=r"extra must not contain metrics .* travel"):
        evaluate(trace, extra={"travel": 1.0})
    assert columns()[-1] is TRAVEL
    print_metrics("title", values)
    printed = capsys.readouterr().out
    assert re.search(r"travel +3 +rad +↓ +way of all joints", printed)
    assert re.search(r"fails +– +↑ +never there", printed)


def test_a_metric_is_measured_that_is_named_by_its_module(monkeypatch):
    monkeypatch.setattr(METRIC_REGISTRY, "_added", {})
    add_metrics(["flatness", f"{__name__}:SEVERAL"])
    assert [metric.name for metric in plugin_metrics()] == ["travel", "fails"]
    for target, error, says in [
        (f"{__name__}:OWN", ConfigError, "can't be a metric"),
        (f"{__name__}:TAKEN", ConfigError, "there is another metric 'flatness'"),
        ("flatnes", UnknownNameError, "Did you mean 'flatness'?"),
    ]:
        with pytest.raises(error, match=re.escape(says)):
            add_metrics([target])
