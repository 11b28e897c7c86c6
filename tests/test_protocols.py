"""Methods and sinks say what they can do, and what a method of one's own needs."""

from dataclasses import dataclass, field
from itertools import permutations
from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np
import pytest
from made_hands import hand_points

from smooth_operator import AlignmentConfig, Hand, HandFrame, Retargeter, Status, load_hand
from smooth_operator.plugins import Entry
from smooth_operator.reporting.drawing import COLORS, colors_of
from smooth_operator.retargeting.method import Method, MethodConfig, MethodOutput
from smooth_operator.retargeting.preset_files import method_config
from smooth_operator.retargeting.presets import PRESETS
from smooth_operator.retargeting.registry import METHODS
from smooth_operator.retargeting.trajectory import TrajectoryMethodConfig
from smooth_operator.teleop.sinks.simulation import Simulation
from smooth_operator.teleop.sinks.sink import Sink, simulated_hands
from smooth_operator.teleop.sinks.table import TableSink

# Methods


def test_what_methods_say_of_themselves(tmp_path):
    hand = load_hand("mimic_p050")
    built = {name: method_config(name).build(hand) for name in PRESETS}
    on_host = {name for name, one in built.items() if one.on_host}
    assert on_host == {"keyvector", "hybrid", "dexpilot", "ako"}
    trajectories = {n for n, one in built.items() if one.trajectory_objective is not None}
    assert trajectories == {"sbr", "smooth"}
    latches = {n for n, one in built.items() if one.latched(one.init(0)) is not None}
    assert latches == {"sbr", "dexpilot", "smooth"}
    file = tmp_path / "model.npz"
    assert {n for n in PRESETS if method_config(n).with_file(file) is not None} == {"geort"}
    for presets in PRESETS.values():
        for name, config in presets.items():
            assert isinstance(config, TrajectoryMethodConfig) == (name == "offline")
            assert config.with_alignment(scale=0.9).alignment.scale == 0.9


@dataclass(frozen=True)
class MirrorConfig(MethodConfig):
    """A method with the least that one can have."""

    color: ClassVar[str | None] = "#123456"
    alignment: AlignmentConfig = field(default_factory=AlignmentConfig)

    def build(self, hand: Hand) -> "Mirror":
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


def test_a_method_of_ones_own_needs_only_what_is_abstract():
    retargeter = Retargeter("allegro_hand", method=f"{__name__}:MIRROR")
    low, high = retargeter.hand.limits.T
    points = hand_points(1)[0]
    for stamp in (3.0, 5.25, 8.5):
        result = retargeter(HandFrame(points, stamp))
        assert result.status == Status.OK
        share = stamp % 1.0
        wanted = retargeter.hand.full_configuration(low + (high - low) * share)
        np.testing.assert_allclose(result.command.joint_positions, wanted, atol=1e-5)
    assert retargeter.notes == ()


def test_every_built_in_method_has_a_colour_of_its_own():
    assert set(COLORS) == {*METHODS.built_in, *METHODS.elsewhere}
    assert len(set(COLORS.values())) == len(COLORS)


def test_colours_do_not_depend_on_the_order_of_methods():
    names = ("smooth", "sbr:paper", "sbr", "keyvector:fast")
    expected = colors_of(names)
    assert len(set(expected.values())) == len(names)
    assert expected["smooth"] == COLORS["smooth"]
    for order in permutations(names):
        assert colors_of(order) == expected
        assert list(colors_of(order)) == list(order)


def test_a_plugins_method_brings_its_colour(monkeypatch):
    offered = {"mirror": Entry(f"{__name__}:MIRROR"), "broken": Entry("no_such_module:X")}
    monkeypatch.setattr(
        "smooth_operator.plugins._installed",
        lambda group: offered if group == "smooth_operator.methods" else {},
    )
    assert colors_of(["mirror"]) == {"mirror": "#123456"}
    assert colors_of(["broken"])["broken"].startswith("#")


def test_sinks_say_whether_they_simulate_and_observe():
    simulation, table = Simulation(), TableSink()
    assert simulated_hands([table]) is None
    assert simulated_hands([table, simulation]) is simulation
    assert (simulation.observes, table.observes) == (False, True)
    with pytest.raises(TypeError, match="abstract"):
        Sink()
