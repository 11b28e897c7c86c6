"""Kabsch-Umeyama against closed forms and a reference by SVD."""

import jax
import numpy as np
import pytest
from trees import float64, random_rotations

from smooth_operator.geometry import Similarity, umeyama

COUNTS = [3, 4, 14]


def svd_reference(
    source: np.ndarray, target: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Umeyama 1991 as printed, with LAPACK: rotation, scale, translation."""
    a = source - source.mean(-2, keepdims=True)
    b = target - target.mean(-2, keepdims=True)
    u, d, vt = np.linalg.svd(np.einsum("...ni,...nj->...ij", b, a))
    sign = np.ones_like(d)
    sign[..., 2] = np.sign(np.linalg.det(u) * np.linalg.det(vt))
    rotation = u * sign[..., None, :] @ vt
    scale = (d * sign).sum(-1) / (a**2).sum((-2, -1))
    moved = np.einsum("...ij,...j->...i", rotation, source.mean(-2))
    return rotation, scale, target.mean(-2) - scale[..., None] * moved


def residual(fit: Similarity[np.ndarray], source: np.ndarray, target: np.ndarray) -> np.ndarray:
    return ((fit.apply(source) - target) ** 2).sum((-2, -1))


def moved(
    source: np.ndarray, rotation: np.ndarray, scale: np.ndarray, translation: np.ndarray
) -> np.ndarray:
    turned = np.einsum("...ij,...nj->...ni", rotation, source)
    return scale[..., None, None] * turned + translation[..., None, :]


def assert_proper(rotation: np.ndarray, atol: float = 1e-12) -> None:
    identity = np.broadcast_to(np.eye(3), rotation.shape)
    np.testing.assert_allclose(rotation @ np.swapaxes(rotation, -1, -2), identity, atol=atol)
    np.testing.assert_allclose(np.linalg.det(rotation), 1.0, atol=atol)


@pytest.mark.parametrize("turn", [0.0, np.pi / 2, np.pi, -np.pi / 2, 1e-7, np.pi - 1e-7])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_turns_about_an_axis_of_an_aligned_set(turn, axis):
    """Half turns and aligned axes make zero entries and equal values in the covariance."""
    c, s = np.cos(turn), np.sin(turn)
    rotation = np.roll(np.array([[1, 0, 0], [0, c, -s], [0, s, c]]), (axis, axis), (0, 1))
    source = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1.0], [0, 0, -1]])
    for points in (source, source[[0, 1, 2, 3]], source * (1, 2, 3)):
        fit = umeyama(points, points @ rotation.T)
        np.testing.assert_allclose(fit.rotation, rotation, atol=1e-12)


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("count", COUNTS)
def test_the_fit_is_that_of_the_reference(count, mirrored):
    """Of unrelated points, and of a mirror image, whose best fit is a rotation as well."""
    rng = np.random.default_rng([count, 1])
    source, target = rng.normal(0, 0.05, (2, 300, count, 3))
    if mirrored:
        target = source * (-1, 1, 1) + rng.normal(0, 1e-3, source.shape)
    fit = umeyama(source, target)
    rotation, scale, translation = svd_reference(source, target)
    reference = Similarity(rotation, translation, scale, scale)
    np.testing.assert_allclose(
        residual(fit, source, target), residual(reference, source, target), rtol=1e-9
    )
    np.testing.assert_allclose(fit.scale, scale, rtol=1e-9)
    usable = fit.condition > 1e-2  # the best rotation is well defined
    assert usable.sum() > 250
    np.testing.assert_allclose(fit.rotation[usable], rotation[usable], atol=1e-9)
    np.testing.assert_allclose(fit.translation[usable], translation[usable], atol=1e-9)
    assert_proper(fit.rotation)


LINE = np.outer([-0.3, 0.1, 0.5, 1.0], [0.02, -0.05, 0.03])
POINT = np.tile([0.1, -0.2, 0.05], (4, 1))
CLOUD = np.random.default_rng(3).normal(0, 0.05, (4, 3))


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@pytest.mark.parametrize(
    ("source", "target"),
    [
        (LINE, CLOUD),
        (CLOUD, LINE),
        (LINE, LINE),
        (POINT, CLOUD),
        (CLOUD, POINT),
        (POINT, POINT),
        (np.zeros((4, 3)), np.zeros((4, 3))),
        (LINE[[0, 0, 3, 3]], CLOUD),
    ],
)
def test_degenerate_sets_are_finite_and_say_so(source, target, dtype):
    fit = umeyama(source.astype(dtype), target.astype(dtype))
    assert all(np.isfinite(part).all() for part in fit)
    assert np.isfinite(fit.apply(source.astype(dtype))).all()
    assert fit.condition < 1e-5


def test_a_collinear_palm_is_told_from_a_flat_one():
    triangle = np.array([[0.0, 0, 0], [0.08, 0, 0], [0.04, 0.0, 0]])
    heights = np.array([0.0, 0.0005, 0.002, 0.02, 0.06])
    sets = np.repeat(triangle[None], len(heights), axis=0)
    sets[:, 2, 1] = heights
    condition = umeyama(sets, np.broadcast_to(CLOUD[:3], sets.shape)).condition
    assert condition[0] < 1e-12
    assert (np.diff(condition) > 0).all()


def test_a_fixed_scale_is_held_and_the_rest_is_optimal():
    rng = np.random.default_rng(5)
    source, target = rng.normal(0, 0.05, (2, 50, 14, 3))
    fit, free = umeyama(source, target, 1.3), umeyama(source, target)
    np.testing.assert_array_equal(fit.scale, np.full(50, 1.3))
    np.testing.assert_allclose(fit.rotation, free.rotation, atol=1e-12)
    np.testing.assert_allclose(
        fit.apply(source).mean(-2), target.mean(-2), atol=1e-12
    )  # centroids meet: the best translation for any scale
    each = rng.uniform(0.5, 2, 50)
    np.testing.assert_array_equal(umeyama(source, target, each).scale, each)


def test_units_do_not_matter():
    """Millimetres, kilometres, or a source a thousand times its target."""
    rng = np.random.default_rng(7)
    source, target = rng.normal(0, 0.05, (2, 14, 3))
    plain = umeyama(source, target)
    for unit in (1e-6, 1e3, 1e9):
        fit = umeyama(source * unit, target)
        np.testing.assert_allclose(fit.rotation, plain.rotation, atol=1e-9)
        np.testing.assert_allclose(fit.scale * unit, plain.scale, rtol=1e-9)


@pytest.mark.parametrize("count", [3, 14])
def test_float32_is_accurate_and_numpy_equals_jax(count):
    rng = np.random.default_rng([count, 3])
    palm = np.array([[0.03, 0.01, 0.15], [0.025, 0.02, 0.2], [-0.04, 0.013, 0.18]])
    source = palm if count == 3 else rng.normal(0, 0.05, (count, 3))
    source = source + rng.normal(0, 0.003, (100, count, 3)) + 0.4  # somewhere in a room
    rotation, scale = random_rotations(rng, 100), rng.uniform(0.7, 1.4, 100)
    target = moved(source, rotation, scale, rng.normal(0, 0.1, (100, 3)))
    exact = umeyama(source, target)
    single = jax.jit(umeyama)(source.astype(np.float32), target.astype(np.float32))
    host = umeyama(source.astype(np.float32), target.astype(np.float32))
    for fit in (single, host):
        assert fit.rotation.dtype == np.float32
        assert abs(fit.rotation - exact.rotation).max() < 2e-5
        np.testing.assert_allclose(fit.scale, scale, rtol=1e-5)
        assert abs(fit.condition - exact.condition).max() < 1e-5
        assert_proper(np.asarray(fit.rotation), atol=2e-6)
    with float64():
        double = jax.jit(umeyama)(source, target)
        for ours, theirs in zip(double, exact, strict=True):
            np.testing.assert_allclose(ours, theirs, atol=1e-11)
