"""Retargeting with objects: signed distances, contacts, costs, and what they gain on made clips."""

from dataclasses import replace
from importlib.util import find_spec

import numpy as np
import pytest
from object_scenes import bumpy_mesh, pinch_clip

from smooth_hand_datasets.objects.contacts import ContactSettings, Scene, clip_scene, find_contacts
from smooth_hand_datasets.objects.hand_surface import HandSurface
from smooth_hand_datasets.objects.interaction_metrics import (
    hand_depths,
    interaction_figures,
    interaction_tracks,
)
from smooth_hand_datasets.objects.placement import (
    apply,
    landmarks_in_world,
    palm_in_world,
    wrist_in_palm,
)
from smooth_hand_datasets.objects.retargeter import ObjectAwareRetargeter
from smooth_hand_datasets.objects.signed_distance import (
    Box,
    Capsule,
    Cylinder,
    Mesh,
    Solid,
    Sphere,
    read_solid,
    signed_distance,
)
from smooth_hand_datasets.objects.terms import ObjectCosts, ObjectSettings, object_frames
from smooth_hand_datasets.pipeline.clip import robot_part
from smooth_hand_datasets.pipeline.quality import quality_figures
from smooth_hand_datasets.pipeline.retargeting import Recipe, retarget_clips, whole_config
from smooth_hand_datasets.pipeline.sources import find_items
from smooth_hand_datasets.pipeline.work import read_item
from smooth_operator import AlignmentConfig, HandRecording, load_hand, method_config, poses
from smooth_operator.errors import ConfigError, RecordingError
from smooth_operator.formats.clip import Clip, ObjectTrack
from smooth_operator.metrics.accuracy import cosine_similarity
from smooth_operator.metrics.assemble import assemble_trace
from smooth_operator.planning import RetargetRequest
from smooth_operator.retargeting.sbr.method import SbrConfig
from smooth_operator.retargeting.sbr.newton import NewtonConfig
from smooth_operator.retargeting.sbr.sampling import SamplingConfig
from smooth_operator.retargeting.trajectory import TrajectoryConfig, TrajectoryMethodConfig
from smooth_operator.synthetic.robot_landmarks import human_landmarks

needs_libigl = pytest.mark.skipif(
    find_spec("igl") is None, reason="libigl (extra objects) is not there"
)

# -- signed distances ------------------------------------------------------------------------------


def test_primitives_against_figures_by_hand():
    box, tube = Box(np.array([0.1, 0.2, 0.3])), Cylinder(0.1, 0.2)
    cases = [
        (Sphere(0.1), [0.0, 0.3, 0.4], 0.4),
        (Sphere(0.1), [0.0, 0.0, 0.04], -0.06),
        (box, [0.0, 0.0, 0.0], -0.1),
        (box, [0.13, 0.24, 0.0], 0.05),
        (box, [0.13, 0.24, 0.42], 0.13),
        (tube, [0.0, 0.05, 0.0], -0.05),
        (tube, [0.13, 0.0, 0.24], 0.05),
        (Capsule(0.1, 0.2), [0.0, 0.0, 0.5], 0.2),
        (Capsule(0.1, 0.2), [0.3, 0.0, 0.1], 0.2),
    ]
    for shape, point, expected in cases:
        found = signed_distance(shape, np.array([point]))[0]
        assert found == pytest.approx(expected, abs=1e-8), (shape, point)


def test_nearest_point_and_normal_of_a_box():
    distance, place, normal = Solid(Box(np.array([0.02, 0.03, 0.04]))).nearest(
        np.array([[0.05, 0.01, -0.02]])
    )
    np.testing.assert_allclose(distance, [0.03], atol=1e-9)
    np.testing.assert_allclose(place, [[0.02, 0.01, -0.02]], atol=1e-7)
    np.testing.assert_allclose(normal, [[1.0, 0.0, 0.0]], atol=1e-6)


@needs_libigl
def test_a_mesh_is_measured_exactly_and_its_grid_nearly(tmp_path):
    trimesh = pytest.importorskip("trimesh")
    half = np.array([0.02, 0.03, 0.04])
    file = tmp_path / "box.ply"
    trimesh.creation.box(2e3 * half).export(file)  # in millimetres
    solid = read_solid(file, 1e-3)
    points = np.random.default_rng(0).uniform(-0.055, 0.055, (500, 3))
    truth = signed_distance(Box(half), points)
    np.testing.assert_allclose(solid.distance(points), truth, atol=1e-6)
    near = np.abs(truth) < 0.01
    assert np.abs(signed_distance(solid.shape, points) - truth)[near].max() < 7e-4
    far = np.array([[0.3, 0.0, 0.0]])  # beyond the grid
    assert signed_distance(solid.shape, far)[0] == pytest.approx(0.28, abs=2e-3)
    with pytest.raises(RecordingError, match="scale"):
        read_solid(file, 1.0)


@needs_libigl
def test_the_sign_holds_for_a_mesh_with_a_hole():
    mesh = bumpy_mesh(0.02, 0.05)
    open_one = Mesh(mesh.vertices, mesh.faces[5:])
    inside, outside = np.array([[0.0, 0.0, 0.0]]), np.array([[0.05, 0.0, 0.0]])
    assert open_one.nearest(inside)[0][0] < -0.01 < 0.01 < open_one.nearest(outside)[0][0]


def test_invalid_meshes_are_refused(tmp_path):
    (tmp_path / "mug.obj").write_text("nothing\n", encoding="utf-8")
    for name in ("mug.obj", "none.obj"):
        with pytest.raises((RecordingError, ImportError), match=name):
            read_solid(tmp_path / name)


def still_hand(gaps: np.ndarray) -> Clip:
    """A straight index finger along x above a sphere, its pad so far from it [m]."""
    count = len(gaps)
    points = np.zeros((count, 21, 3))
    points[:, 1:5] = [0.02, 0.05, 0.0]
    for finger, first in enumerate((5, 9, 13, 17)):
        for k in range(4):
            points[:, first + k] = [0.09 + 0.025 * k, 0.03 - 0.02 * finger, 0.0]
    wrist = np.tile(poses.IDENTITY, (count, 1))
    hand = HandRecording(points, np.arange(count) / 50.0, T_world_wrist=wrist, world="w")
    radius, pad = 0.03, 0.0075
    track = np.tile(poses.IDENTITY, (count, 1))
    track[:, :3] = points[:, 8] + [-pad, 0.0, 0.0]
    track[:, 2] -= radius + pad + gaps
    return Clip("c", {"right": hand}, "test", objects=(ObjectTrack("ball", track),))


def test_hysteresis_and_durations_of_contacts():
    gaps = np.full(60, 0.02)
    gaps[10:30] = 0.0
    gaps[18] = 0.006  # between the thresholds: the contact goes on
    gaps[24] = 0.02  # an interruption of one frame
    gaps[40] = 0.0  # a contact of one frame
    gaps[45:50] = 0.006  # near, and never below the first threshold
    clip = still_hand(gaps)
    scene = clip_scene(clip, {"ball": Solid(Sphere(0.03))})
    found = find_contacts(clip, "right", scene, ContactSettings(0.0075, 0.004, 0.007, 0.05))
    np.testing.assert_allclose(found.clearance[:, 1], gaps, atol=1e-9)
    assert np.flatnonzero(found.touching[:, 1]).tolist() == list(range(10, 30))
    assert not found.touching[:, [0, 2, 3, 4]].any()
    np.testing.assert_allclose(found.normal[12, 1], [0, 0, 1], atol=1e-6)
    np.testing.assert_allclose(found.place[12, 1], [0, 0, 0.03], atol=1e-7)


def test_landmarks_are_carried_to_the_wrist():
    clip = still_hand(np.zeros(3))
    hand = clip.hands["right"]
    turn = poses.from_rotation_vectors(np.array([0.3, -0.5, 0.8]))
    there = np.concatenate([[0.4, -0.2, 1.0], turn])
    own = poses.wrist_from_landmarks(hand.landmarks, "right")
    moved = replace(hand, T_world_wrist=poses.compose(np.tile(there, (3, 1)), own))
    expected = poses.rotate(np.broadcast_to(turn, (3, 21, 4)), hand.landmarks) + there[:3]
    np.testing.assert_allclose(landmarks_in_world(moved), expected, atol=1e-9)
    with pytest.raises(RecordingError, match="wrist"):
        landmarks_in_world(replace(hand, T_world_wrist=None))


@pytest.mark.parametrize("side", ["right", "left"])
def test_contacts_of_a_pinch_are_found(side):
    made = pinch_clip("box", side)
    found = find_contacts(made.clip, side, made.scene)
    assert set(np.flatnonzero(found.touching[17:23].all(axis=0))) == {0, 1}
    assert not found.touching[:7].any()
    shared = (made.truth.touching & found.touching).sum()
    assert shared > 0.97 * made.truth.touching.sum()
    assert shared > 0.85 * found.touching.sum()  # it begins at 4 mm, the contacts of record at 1 mm


@pytest.mark.parametrize("side", ["right", "left"])
def test_a_robot_lies_on_its_own_landmarks(side):
    """Both from landmarks in the world and from those of a tracker; the left hand is mirrored."""
    hand = load_hand("mimic_p050", side)
    turn = poses.from_rotation_vectors(np.array([[0.3, -0.5, 0.8], [-1.0, 0.2, 0.1]]))
    palm = np.concatenate([[[0.4, -0.2, 1.0], [0.1, 0.0, 0.9]], turn], axis=1)
    own = human_landmarks(hand, hand.neutral[None])
    wrist = poses.compose(palm, wrist_in_palm(hand)[None])
    for points in (np.repeat(own, 2, axis=0), apply(palm, own)):
        hand_there = HandRecording(points, np.arange(2.0), side, T_world_wrist=wrist, world="w")
        found = palm_in_world(hand_there, hand, AlignmentConfig())
        assert poses.separation(palm, found).max() < 1e-6


def test_depth_of_a_hand_at_a_sphere_and_its_bodies_frames():
    hand = load_hand("mimic_p050")
    surface = HandSurface(hand)
    q = hand.full_configuration(hand.neutral)[None]
    tips = hand.tips(q)[0]
    identity = np.tile(poses.IDENTITY, (1, 1))
    ball = np.concatenate([tips[1] + [0.0, 0.0, 0.05], [1.0, 0, 0, 0]])
    scene = Scene(("ball",), (Solid(Sphere(0.045)),), ball[None, None])
    found = hand_depths(surface, q, identity, scene)
    # spheres of the solver and points of the measurement describe one hand
    spheres = surface.spheres.at(surface.frames(q))[0]
    gap = np.linalg.norm(spheres - ball[:3], axis=1) - 0.045 - surface.spheres.radius
    assert found.clearance[0, 1] == pytest.approx(
        gap[surface.fingertips(surface.spheres)[1]].min(), abs=4e-4
    )
    assert found.deepest[0] == pytest.approx(max(0.0, -gap.min()), abs=4e-4)


def test_derivatives_of_the_costs_by_finite_differences():
    hand = load_hand("mimic_p050")
    costs = ObjectCosts(hand, ObjectSettings())
    made = pinch_clip("cylinder")
    side = "right"
    palm = palm_in_world(made.clip.hands[side], hand, AlignmentConfig())
    contacts = find_contacts(made.clip, side, made.scene)
    frames = object_frames(hand, palm, made.scene, contacts, made.clip.stamps, costs.settings)
    rng = np.random.default_rng(1)
    picked = np.array([15, 20, 30])
    rows = type(frames)(*(values[picked] for values in frames))
    q = hand.neutral + 0.4 * (hand.limits[:, 1] - hand.neutral) * rng.random((3, len(hand.neutral)))
    x = np.concatenate([q, 0.3 * rng.normal(size=(3, 6))], axis=1)
    shapes = tuple(solid.shape for solid in made.scene.solids)
    _, gradient, hessian = costs.all_costs(shapes, x, rows)
    step = 1e-3
    numeric = np.stack(
        [
            (
                costs.all_costs(shapes, x + step * e, rows)[0]
                - costs.all_costs(shapes, x - step * e, rows)[0]
            )
            / (2 * step)
            for e in np.eye(x.shape[1])
        ],
        axis=1,
    )
    size = np.linalg.norm(gradient, axis=1)
    assert (size > 0.1).all()
    assert (np.linalg.norm(gradient - numeric, axis=1) < 0.03 * size).all()
    assert np.linalg.eigvalsh(hessian).min() > -1e-3 * np.abs(hessian).max()


LIGHT = TrajectoryMethodConfig(
    SbrConfig(
        sampling=SamplingConfig(samples=64, elites=12, cycles=3, draws="quasi"),
        polish=NewtonConfig(iterations=3, damping=(0.0, 1.0)),
    ),
    TrajectoryConfig(acceleration_weight=1e-7, speed_limit=28.0),
)
"""Compiles in less time than ``smooth:offline``."""


@pytest.mark.weekly
@pytest.mark.usefixtures("optimised")
def test_contacts_are_kept_and_the_surface_is_respected():
    hand = load_hand("mimic_p050")
    aware, blind_errors, aware_errors = ObjectAwareRetargeter(hand, LIGHT), [], []
    for form in ("box", "cylinder"):
        made = pinch_clip(form)
        recording = made.clip.hands["right"]
        found = aware.run(made.clip, "right", made.solids)
        assert found.figures["penetration_max_mm"] < 2.0
        assert np.abs(found.correction[:, :3]).max() <= aware.costs.settings.shift + 1e-9
        moved = poses.compose(found.T_world_palm, wrist_in_palm(hand)[None])
        np.testing.assert_allclose(moved, found.T_world_wrist, atol=1e-12)
        blind, _ = aware.blind.run(recording)
        palm = palm_in_world(recording, hand, AlignmentConfig())
        for commands, at, errors in (
            (found.commands, found.T_world_palm, aware_errors),
            (blind, palm, blind_errors),
        ):
            tracks = interaction_tracks(
                aware.costs.surface, commands.joint_positions, at, made.scene, made.truth
            )
            figures = interaction_figures(tracks)
            trace = assemble_trace(recording, commands, hand, AlignmentConfig(), reach_samples=0)
            cosine = cosine_similarity(trace.human_keyvectors, trace.robot_keyvectors)
            wrong = 1.0 - figures["contact_precision"]
            errors.append((figures["contact_error_mm"], wrong, cosine))
    aware_error, blind_error = np.mean(aware_errors, axis=0), np.mean(blind_errors, axis=0)
    assert (aware_error[:2] < 0.5 * blind_error[:2]).all()
    assert aware_error[2] > blind_error[2] - 0.01


@needs_libigl
def test_a_data_set_keeps_contacts_where_a_clip_has_an_object(tmp_path):
    trimesh = pytest.importorskip("trimesh")
    made = pinch_clip("box", rate=10.0)
    recording, (track,) = made.clip.hands["right"], made.clip.objects
    arrays = {
        "right": recording.landmarks,
        "stamps": recording.stamps,
        "T_world_wrist_right": recording.T_world_wrist,
    }
    np.savez(tmp_path / "blind.npz", **arrays)
    np.savez(
        tmp_path / "take.npz", **arrays, **{f"T_world_object_{track.name}": track.T_world_object}
    )
    box = made.solids[track.name].shape
    trimesh.creation.box(2.0 * np.asarray(box.half)).export(tmp_path / f"{track.name}.stl")
    request = RetargetRequest(hand="mimic_p050", method="sbr", preset="light", config=LIGHT)
    recipe = Recipe(request, with_objects=True)
    assert recipe.digest != Recipe(request).digest
    items = find_items([str(tmp_path)]).items
    read = [clip for item in items for clip in read_item(item, recipe)]
    blind, take = retarget_clips(
        [each.clip for each in read], recipe, [each.files for each in read]
    )
    figures = quality_figures(take)
    assert figures["right.contact_recall"] > 0.8
    assert figures["right.object_depth_mm"] < 2.0
    assert not any("contact" in name for name in quality_figures(blind))
    # the wrist belongs to the commands, and the mesh to the files that they rest on
    assert np.abs(take.T_world_wrist["right"] - blind.T_world_wrist["right"]).max() > 1e-3
    assert [file.path for file in read[1].files] == ["take.npz", f"{track.name}.stl"]
    half = robot_part(take, slice(0, len(take.clip) // 2))
    assert 0 <= quality_figures(half)["right.contact_recall"] <= 1
    with pytest.raises(ConfigError, match="smooth:offline"):
        Recipe(
            RetargetRequest(
                hand="mimic_p050", method="smooth", preset="teleop", config=method_config("smooth")
            ),
            with_objects=True,
        )


def test_a_wrist_that_may_not_move_and_a_preset_that_answers_frame_by_frame():
    hand = load_hand("mimic_p050")
    limits = ObjectCosts(hand, ObjectSettings(shift=0.0, turn=0.0)).limits
    assert not limits.any()
    with pytest.raises(ConfigError, match="smooth:offline"):
        whole_config(method_config("smooth"))
    with pytest.raises(RecordingError, match="mesh"):
        clip_scene(still_hand(np.zeros(3)))
