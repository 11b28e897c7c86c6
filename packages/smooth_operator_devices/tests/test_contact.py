"""Contact of a real hand's fingers, from touch pads, forces or currents."""

from dataclasses import replace

import numpy as np
import pytest
from live_time import until
from simulators.inspire_touch import InspireTouchHand

from smooth_operator import load_hand
from smooth_operator.errors import ConfigError
from smooth_operator.teleop.components import build_sink
from smooth_operator_devices.hands.actuator_map import (
    BoundMap,
    built_in_tables,
    read_table,
    write_table,
)

TABLES = built_in_tables()


def contact_map(name: str):
    table = read_table(TABLES / f"{name}_right.toml")
    return BoundMap(table, load_hand(table.hand, "right")).contact


def test_forces_of_the_motors_have_newtons():
    """The thumb has two motors; of them the larger force counts."""
    forces = np.array([0.0, 50.0, 275.0, 900.0, 0.0, 140.0])  # little to thumb [g]
    contact = contact_map("inspire")(None, forces, {})
    np.testing.assert_allclose(contact.levels, [0.2, 1.0, 0.5, 0.0, 0.0])
    np.testing.assert_allclose(contact.newtons, 9.80665e-3 * np.array([140, 900, 275, 50, 0]))
    assert contact_map("inspire")(np.ones(6), None, {}) is None  # not read yet


@pytest.mark.parametrize(
    ("table", "idle", "full"), [("linker_l10", 50, 2000), ("inspire_ftp", 200, 8000)]
)
def test_pads_belong_to_the_finger_that_they_are_named_after(table, idle, full):
    pads = {"little_tip": np.full((2, 2), full / 4), "index": np.full((2, 1), idle / 2)}
    pads |= {"index_nail": np.array([[idle + (full - idle) / 4]]), "palm": np.array([[1e5]])}
    contact = contact_map(table)(None, None, pads)
    np.testing.assert_allclose(contact.levels, [0.0, 0.25, 0.0, 0.0, 1.0])
    assert np.isnan(contact.newtons).all()
    assert contact_map(table)(None, None, {}) is None


def test_currents_count_above_what_a_free_motor_needs():
    currents = np.zeros(16)
    currents[[1, 5, 9]] = -350.0, 0.65 * 350.0, 0.3 * 350.0  # mA of 350
    currents[12] = np.nan
    levels = contact_map("leap")(currents, None, {}).levels
    np.testing.assert_allclose(levels, [np.nan, 1.0, 0.5, 0.0], atol=1e-12)
    assert contact_map("hx5_d20")(np.ones(20), None, {}) is None  # its table has no limit


def test_a_table_keeps_its_scale_and_a_wrong_one_is_refused(tmp_path):
    table = read_table(TABLES / "inspire_right.toml")
    path = tmp_path / "mine_right.toml"
    write_table(table, path)
    assert read_table(path).contact == table.contact
    for change, words in (({"full": 50.0}, "full larger"), ({"fingers": ()}, "finger of each")):
        with pytest.raises(ConfigError, match=words):
            replace(table.contact, **change)


def test_a_touched_pad_reaches_the_state_of_the_hand():
    pytest.importorskip("pymodbus", reason="the extra inspire is not installed")
    with InspireTouchHand() as hand:
        host, port = hand.address
        hand.touch["index", "nail"][:2] = 1000
        sink = build_sink(f"inspire:{host}:{port},table=inspire_ftp")
        sink.open({"right": load_hand("inspire_ftp", "right")}, {})
        try:
            until(lambda: (s := sink.state("right")) and s.contact and s.contact.levels[1] == 1.0)
            assert sink.state("right").contact.levels.sum() == 1.0
        finally:
            sink.close()
