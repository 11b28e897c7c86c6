"""Methods, target policies and sinks say what they can do; nobody else asks for their class."""

from __future__ import annotations

import ast
import inspect
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import permutations
from pathlib import Path
from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np
import pytest
from made_hands import hand_points

import smooth_operator
from smooth_operator.hands.hand import Hand
from smooth_operator.hands.registry import load_hand
from smooth_operator.human.alignment import AlignmentConfig
from smooth_operator.methods.method import HostMethod, Method, MethodConfig, MethodOutput
from smooth_operator.methods.presets import PRESETS, method_config
from smooth_operator.methods.registry import COLORS, METHODS
from smooth_operator.methods.retargeter import Retargeter
from smooth_operator.plugins import Entry
from smooth_operator.reporting.drawing import colors_of
from smooth_operator.teleop.sinks.simulation import Simulation
from smooth_operator.teleop.sinks.sink import Sink, simulated_hands
from smooth_operator.teleop.sinks.table import TableSink
from smooth_operator.types import HandFrame, Status

SOURCE = Path(smooth_operator.__file__).parent
BASES = {"Method", "MethodConfig", "TargetPolicy", "Sink"}
"""Bases of what must not be asked for its class. Whether it is one at all may be asked."""


@dataclass(frozen=True)
class Family:
    """All classes derived from ``BASES``.

    Attributes:
        homes: class -> its file.
        members: names of what the bases have without being abstract.
    """

    homes: dict[str, Path]
    members: set[str]

    def violations(self, path: Path, tree: ast.Module) -> Iterator[str]:
        """Calls that ask a member of the family for its class, or whether it has a member."""
        for node in ast.walk(tree):
            if not (isinstance(node, ast.Call) and isinstance(node.func, ast.Name)):
                continue
            where, asked = f"{path.name}:{node.lineno}: {node.func.id}", node.args[1:2]
            if node.func.id in ("isinstance", "issubclass"):
                names = {name_of(n) for n in ast.walk(asked[0])} & self.homes.keys() - BASES
                yield from (f"{where} of {n}" for n in sorted(names) if self.homes[n] != path)
            elif node.func.id in ("getattr", "hasattr"):
                name = getattr(asked[0], "value", None)
                if isinstance(asked[0], ast.Constant) and name in self.members:
                    yield f"{where} of {name!r}"


def name_of(node: ast.AST) -> str:
    inner = node.value if isinstance(node, ast.Subscript) else node
    return str(getattr(inner, "attr", getattr(inner, "id", "")))


def members_of(node: ast.ClassDef) -> Iterator[str]:
    for each in node.body:
        if isinstance(each, ast.AnnAssign) and each.value is not None:
            yield name_of(each.target)
        elif isinstance(each, ast.FunctionDef) and "abstractmethod" not in map(
            name_of, each.decorator_list
        ):
            yield each.name


@pytest.fixture(scope="module")
def parsed() -> dict[Path, ast.Module]:
    return {path: ast.parse(path.read_text(encoding="utf-8")) for path in SOURCE.rglob("*.py")}


@pytest.fixture(scope="module")
def family(parsed: dict[Path, ast.Module]) -> Family:
    classes = [
        (path, node)
        for path, tree in parsed.items()
        for node in ast.walk(tree)
        if isinstance(node, ast.ClassDef)
    ]
    homes: dict[str, Path] = {}
    before = -1
    while before != len(homes):
        before = len(homes)
        homes |= {
            node.name: path
            for path, node in classes
            if node.name in BASES or set(map(name_of, node.bases)) & homes.keys()
        }
    members = {m for _, node in classes if node.name in BASES for m in members_of(node)}
    return Family(homes, members - {"check"})  # others have a method of that name, too


def test_no_class_and_no_optional_member_is_asked_for(
    family: Family, parsed: dict[Path, ast.Module]
) -> None:
    found = [one for path, tree in parsed.items() for one in family.violations(path, tree)]
    assert found == []


@pytest.mark.parametrize(
    "line",
    [
        "isinstance(config, SmoothConfig)",
        "isinstance(method, HostMethod)",
        "isinstance(config, int | method.TrajectoryMethodConfig)",
        "isinstance(policy, (int, CloseTargets))",
        "isinstance(sink, Simulation)",
        "getattr(method, 'latched', None)",
        "getattr(config, 'shareable', True)",
        "hasattr(sink, 'simulation')",
    ],
)
def test_a_new_question_is_found(family: Family, line: str) -> None:
    assert len(list(family.violations(Path("new.py"), ast.parse(line)))) == 1


# Methods


def test_every_step_takes_the_frames_time() -> None:
    hand = load_hand("mimic_p050")
    for name in PRESETS:
        built = method_config(name).build(hand)
        assert [*inspect.signature(built.step).parameters] == ["state", "aligned", "ticks"]
        if built.host is not None:
            assert [*inspect.signature(built.host.prepare).parameters][-1] == "ticks"


def test_what_methods_say_of_themselves() -> None:
    hand = load_hand("mimic_p050")
    built = {name: method_config(name).build(hand) for name in PRESETS}
    assert {name for name, one in built.items() if one.host is not None} == {
        "keyvector", "hybrid", "dexpilot", "ako",
    }  # fmt: skip
    assert {name for name, one in built.items() if one.frame_goals() is not None} == {
        "sbr", "smooth",
    }  # fmt: skip
    latches = {n for n, one in built.items() if one.latched(one.init(0)) is not None}
    assert latches == {"sbr", "dexpilot"}
    assert isinstance(built["ako"].host, HostMethod)
    for presets in PRESETS.values():
        for name, config in presets.items():
            whole = config.trajectory
            assert (whole is None) == (name != "offline")
            assert config.with_alignment(scale=0.9).alignment.scale == 0.9


def test_a_file_stands_for_a_preset_only_where_the_method_takes_one(tmp_path: Path) -> None:
    file = tmp_path / "model.npz"
    taken = {name for name in PRESETS if method_config(name).with_file(file) is not None}
    assert taken == {"geort"}


@dataclass(frozen=True)
class MirrorConfig(MethodConfig):
    """A method with the least that one can have."""

    color: ClassVar[str | None] = "#123456"
    alignment: AlignmentConfig = field(default_factory=AlignmentConfig)

    def build(self, hand: Hand) -> Mirror:
        return Mirror(hand)


@dataclass(frozen=True, eq=False)
class Mirror(Method):
    hand: Hand
    needs = (0, 8)

    def init(self, seed: int) -> Any:
        return ()

    def step(self, state: Any, aligned: Any, ticks: Any) -> tuple[Any, MethodOutput]:
        low, high = self.hand.limits.T
        share = (ticks % 1000000) / 1e6
        q = jnp.asarray(low + (high - low) * share, jnp.float32)
        return state, MethodOutput(q, jnp.float32(0.0))


MIRROR = MirrorConfig()


def test_a_method_of_ones_own_needs_only_what_is_abstract() -> None:
    retargeter = Retargeter("allegro_hand", method=f"{__name__}:MIRROR")
    low, high = retargeter.hand.limits.T
    points = hand_points(1)[0]
    for stamp in (3.0, 5.25, 8.5):
        result = retargeter(HandFrame(points, stamp))
        assert result.status == Status.OK
        share = stamp % 1.0
        wanted = retargeter.hand.full_configuration(low + (high - low) * share)
        np.testing.assert_allclose(result.command.positions, wanted, atol=1e-5)
    assert retargeter.notes == ()
    assert MIRROR.without_pull() == MIRROR


# Colours


def test_every_built_in_method_has_a_colour_of_its_own() -> None:
    assert set(COLORS) == set(METHODS.built_in)
    assert len(set(COLORS.values())) == len(COLORS)


def test_colours_do_not_depend_on_the_order_of_methods() -> None:
    names = ("smooth", "sbr:paper", "sbr", "keyvector:slsqp")
    expected = colors_of(names)
    assert len(set(expected.values())) == len(names)
    assert expected["smooth"] == COLORS["smooth"]
    for order in permutations(names):
        assert colors_of(order) == expected
        assert list(colors_of(order)) == list(order)


def test_a_plugins_method_brings_its_colour(monkeypatch: pytest.MonkeyPatch) -> None:
    offered = {"mirror": Entry(f"{__name__}:MIRROR"), "broken": Entry("no_such_module:X")}
    monkeypatch.setattr(
        "smooth_operator.plugins._installed",
        lambda group: offered if group == "smooth_operator.methods" else {},
    )
    assert colors_of(["mirror"]) == {"mirror": "#123456"}
    assert colors_of(["broken"])["broken"].startswith("#")


# Sinks


def test_sinks_say_whether_they_simulate_and_observe() -> None:
    simulation, table = Simulation(), TableSink()
    assert simulated_hands([table]) is None
    assert simulated_hands([table, simulation]) is simulation
    assert (simulation.observes, table.observes) == (False, True)
    with pytest.raises(TypeError, match="abstract"):
        Sink()  # type: ignore[abstract]
