"""The physics of scenes: pads, energy, slip, creep, half the step."""

import pytest

from smooth_operator.simulation.scenes.physics import PRESSED_DEPTH, TIME_CONSTANT, pad_impedance
from smooth_operator_research.physics import validity
from smooth_operator_research.physics.grasp_physics import GRASP_OBJECTS, GraspObject


def thing(name: str) -> GraspObject:
    return next(one for one in GRASP_OBJECTS if one.name == name)


def pad_force(depth: float, inverse_mass: float) -> float:
    """Force of MuJoCo's contact at rest [N], by the formula in ``pads``."""
    low, high = pad_impedance(inverse_mass)
    d = low + (high - low) * min(depth / PRESSED_DEPTH, 1.0)
    return d * d * depth / ((1.0 - d) * high**2 * TIME_CONSTANT**2 * inverse_mass)


@pytest.mark.parametrize("mass", [0.002, 0.009, 0.045, 0.2])
def test_pads_give_way_alike_whatever_the_object_weighs(mass):
    """A fingertip moves 4 1/kg by itself."""
    low, high = pad_impedance(1.0 / mass + 4.0)
    assert 0.0 < low <= high < 1.0
    assert pad_force(0.00035, 1.0 / mass + 4.0) == pytest.approx(1.0, rel=0.12)
    assert pad_force(0.00085, 1.0 / mass + 4.0) == pytest.approx(5.0, rel=0.12)


@pytest.mark.parametrize("name", ["cube 10", "cube 30"])
def test_pressed_pads_are_as_deep_as_silicone_ones(name):
    """Two points of contact bear a fingertip that lies on a face, each with half of the force."""
    depths = [1e3 * validity.indentation(force, thing(name)) for force in (1.0, 2.0, 5.0)]
    assert depths == sorted(depths)
    assert depths[0] == pytest.approx(0.21, abs=0.03)
    assert depths[2] == pytest.approx(0.63, abs=0.06)


@pytest.mark.parametrize("name", ["sphere 10", "sphere 30"])
def test_a_fall_on_a_pad_gains_no_energy(name):
    gain, bounce = validity.energy_gain(thing(name))
    assert gain < 1e-6
    assert bounce < 0.2


@pytest.mark.parametrize("force", [1.0, 5.0])
def test_an_object_slips_at_coulombs_limit(force):
    assert validity.slip_ratio(force, thing("cube 20")) == pytest.approx(1.0, abs=0.1)


def test_what_is_held_does_not_creep():
    assert abs(validity.creep(2.0, thing("cube 30"), 4.0)) < 0.00005
    assert validity.creep(0.1, thing("cube 30"), 1.0) > 0.01  # 0.18 N of friction, 0.26 N of weight


@pytest.mark.parametrize("name", ["card 2", "sphere 20"])
def test_half_the_step_gives_the_same(name):
    coarse, fine = (validity.mimic_pinch(thing(name), step) for step in (0.002, 0.001))
    assert coarse.held
    assert fine.held
    assert fine.force == pytest.approx(coarse.force, rel=0.1)
