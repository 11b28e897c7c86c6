"""Programs are compiled once for all that would compile the same one."""

import dataclasses

import jax
import pytest

from smooth_operator import Retargeter, load_hand, method_config
from smooth_operator.hands.hand import fingerprint
from smooth_operator.retargeting.retargeter import shared_program


def test_the_same_hand_and_settings_share_and_others_do_not():
    hand, config = load_hand("mimic_p050"), method_config("joint_angle")
    first = shared_program(hand, config)
    assert shared_program(hand, method_config("joint_angle")).run is first.run
    other = dataclasses.replace(config, alignment=dataclasses.replace(config.alignment, scale=1.1))
    assert shared_program(hand, other).run is not first.run
    fewer = load_hand("mimic_p050", fingers=("thumb", "index", "middle"))
    assert shared_program(fewer, config).run is not first.run


@pytest.mark.parametrize(("name", "mirrored"), [("mimic_p050", True), ("shadow_hand", False)])
def test_a_mirrored_hand_is_served_by_its_mirror_image(name, mirrored):
    config = method_config("joint_angle")
    right, left = (shared_program(load_hand(name, side), config) for side in ("right", "left"))
    assert (right.run is left.run) == mirrored
    assert (right.reflects, left.reflects) == (False, mirrored)


def test_another_retargeter_of_the_same_hand_compiles_nothing():
    Retargeter("mimic_p050", method="geort", side="right")  # never shared: its file may change
    first = Retargeter("mimic_p050", method="joint_angle", side="left")
    first.warm_up()
    compiled: list[str] = []
    jax.monitoring.register_event_duration_secs_listener(
        lambda event, seconds, **more: compiled.append(event)
    )
    Retargeter("mimic_p050", method="joint_angle", side="left").warm_up()
    assert [event for event in compiled if "backend_compile" in event] == []
    jax.jit(lambda x: x * 1.2345)(1.0)  # what would be heard
    assert [event for event in compiled if "backend_compile" in event]


def test_a_fingerprint_is_of_figures_not_of_names():
    hand = load_hand("leap_hand")
    renamed = load_hand(dataclasses.replace(hand.spec, name="other", source="elsewhere"))
    assert fingerprint(renamed) == fingerprint(hand)
    moved = dataclasses.replace(hand.spec, neutral={hand.actuated_names[0]: 0.1})
    assert fingerprint(load_hand(moved)) != fingerprint(hand)
