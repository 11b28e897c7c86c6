"""The published definitions of the metrics, and the fit that goes with them."""

import mujoco
import numpy as np
import pytest
from metrics_cases import WRIST, human_motion, make_trace, rotation

from smooth_operator import assemble_trace, load_hand, read_recording
from smooth_operator.landmarks import FINGERS, TIPS
from smooth_operator.metrics import evaluate, published
from smooth_operator.types import CommandTrajectory


def test_paper_headlines_are_medians():
    human = human_motion(50)
    tips = human[:, list(TIPS)].copy()
    tips[:20] = WRIST - 1.5 * (tips[:20] - WRIST)  # 40 % of the frames are upside down
    trace = make_trace(human, tips)
    assert evaluate(trace, "paper")["cosine_similarity"] == pytest.approx(1, abs=1e-4)
    assert evaluate(trace, "paper")["scale_ratio"] == pytest.approx(1, abs=1e-5)
    assert evaluate(trace, "sound")["cosine_similarity"] == pytest.approx(0.2, abs=1e-9)
    assert evaluate(trace, "sound")["scale_ratio"] == pytest.approx(1.2, abs=1e-9)


def test_paper_motion_preservation_of_a_perfect_copy_is_below_one():
    step = 1e-4  # as area, |dh| |dr| equals the published epsilon
    human = np.tile(human_motion(1), (30, 1, 1))
    human[:, 1:] += np.arange(30)[:, None, None] * np.array([step, 0, 0])
    assert evaluate(make_trace(human), "paper")["motion_preservation"] == pytest.approx(0.5)


def test_paper_fits_the_human_to_the_robots_pose():
    robot = human_motion(40, seed=1)
    rng = np.random.default_rng(2)
    human = np.empty_like(robot)
    for t in range(40):  # a different frame, size and place of the human hand every time
        turn = rotation(rng.normal(size=3), rng.uniform(0, 3))
        human[t] = 1.3 * robot[t] @ turn.T + rng.normal(size=3)
    missing = np.isin(np.arange(21), (3, 7, 11, 15, 19, 1, 2))  # 14 remain
    landmarks = np.where(missing[:, None], np.nan, robot)
    tips = robot[:, list(TIPS)]
    result = evaluate(make_trace(human, tips, robot_landmarks=landmarks), "paper")
    assert result["human_fit"] == "robot pose"
    assert result["cosine_similarity_all"] == pytest.approx(1, abs=1e-4)
    assert result["scale_ratio"] == pytest.approx(1, abs=1e-5)
    assert result["motion_preservation"] > 0.95
    unfitted = evaluate(make_trace(human, tips), "paper")
    assert unfitted["human_fit"] == "palm"
    assert unfitted["cosine_similarity_all"] < 0.9


def test_fit_is_a_rotation_and_refuses_degenerate_frames():
    human = human_motion(4)
    mirrored = human * np.array([-1.0, 1, 1])
    np.testing.assert_allclose(published.fit_to_robot(human, human), human, atol=1e-12)
    fitted = published.fit_to_robot(human, mirrored)
    assert np.abs(fitted - mirrored).max() > 0.02  # no reflection can explain it away
    before, after = (np.linalg.det(p[0, [4, 8, 12]] - p[0, 16]) for p in (human, fitted))
    assert before * after > 0  # the same handedness
    line = human.copy()
    line[1] = np.outer(np.arange(21), [1.0, 2, 3])  # collinear
    line[2, 2:] = np.nan  # two landmarks only
    with np.errstate(all="raise"):
        fitted = published.fit_to_robot(human, line)
    assert np.isfinite(fitted[[0, 3]]).all()
    assert np.isnan(fitted[[1, 2]]).all()


def test_landmarks_outside_the_fit_do_not_count():
    human = human_motion(20)
    robot = human.copy()
    robot[:, [2, 6, 9, 10, 13, 14, 18]] += 0.05  # the seven that the authors' hand model has not
    tips = human[:, list(TIPS)]
    result = evaluate(make_trace(human, tips, robot_landmarks=robot), "paper")
    assert result["scale_ratio"] == pytest.approx(1, abs=1e-6)
    robot[:, 19] += 0.05  # last joint of the pinky: in the fit
    assert evaluate(make_trace(human, tips, robot_landmarks=robot), "paper")[
        "scale_ratio"
    ] != pytest.approx(1, abs=1e-3)


def by_the_definition(model: mujoco.MjModel, nodes: np.ndarray, q: np.ndarray) -> list[float]:
    """Median cosine, median scale and motion preservation, by MuJoCo and an SVD, nothing of ours.

    Args:
        model: the published model of the hand.
        nodes: (T, 25, 3) MANUS nodes [m].
        q: (T, nq) commands [rad].
    """
    data, fits = mujoco.MjData(model), []
    bases = [model.joint(n).id for n in ("thumb_base2cmc", "index_base2mcp", "pinky_base2mcp")]
    wrist = model.body("wrist_link_virtual").id
    ends = [model.body(f"{f}_{part}").id for part in ("dp", "fingertip") for f in FINGERS]
    for pose, points in zip(q, nodes, strict=True):
        data.qpos[:] = pose
        mujoco.mj_kinematics(model, data)
        theirs = np.concatenate([data.xpos[[wrist]], data.xanchor[bases], data.xpos[ends]])
        ours = points[[0, 1, 6, 21, 3, 8, 13, 18, 23, 4, 9, 14, 19, 24]]
        a, b = ours - ours.mean(0), theirs - theirs.mean(0)
        u, d, vt = np.linalg.svd(b.T @ a)
        signs = np.array([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
        scale = (d * signs).sum() / (a * a).sum()
        fits.append((scale * a[-5:] @ ((u * signs) @ vt).T + theirs.mean(0), theirs[-5:]))
    h, r = np.moveaxis(fits, 1, 0)

    def cosines(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        sizes = np.linalg.norm(x, axis=-1) * np.linalg.norm(y, axis=-1)
        return (x * y).sum(-1) / (sizes + 1e-8)

    v, w = h[:, 1:] - h[:, :1], r[:, 1:] - r[:, :1]
    lengths = np.linalg.norm(w, axis=-1) / (np.linalg.norm(v, axis=-1) + 1e-8)
    motion = cosines(np.diff(h, axis=0), np.diff(r, axis=0))
    return [float(np.median(cosines(v, w))), float(np.median(lengths)), float(motion.mean())]


@pytest.mark.shared
@pytest.mark.parametrize(
    ("peer", "cosine", "scale", "motion"),
    [("dexpilot", 0.99383, 0.8896, 0.6983), ("sampling_based", 0.99760, 0.8690, 0.6873)],
)
def test_published_commands_get_the_published_codes_figures(shared, peer, cosine, scale, motion):
    """The figures are those of the authors' metric code on the same commands."""
    recording = read_recording(shared / "recordings/manus_right_subject-000_run-010.npz")[:500]
    commands = shared / f"peers/{peer}_subject-000_frames-0-500.npz"
    hand = load_hand("mimic_p050")
    with np.load(commands, allow_pickle=False) as archive:
        columns = [[str(n) for n in archive["joint_names"]].index(n) for n in hand.joint_names]
        q = archive["joint_positions"][:, columns].astype(float)
    trajectory = CommandTrajectory(
        q, hand.joint_names, recording.stamps, np.full(500, np.nan), np.zeros(500, int)
    )
    ours = evaluate(assemble_trace(recording, trajectory, hand, reach_samples=0), "paper")
    model = mujoco.MjModel.from_xml_path(str(shared / "hands/mimic_p050_hand/right_hand.xml"))
    order = [hand.joint_names.index(model.joint(j).name) for j in range(model.njnt)]
    with np.load(shared / "recordings/manus_right_subject-000_run-010.npz") as archive:
        nodes = archive["data"][:500, :, :3].astype(float)
    figures = [ours[n] for n in ("cosine_similarity", "scale_ratio", "motion_preservation")]
    assert figures == pytest.approx(by_the_definition(model, nodes, q[:, order]), abs=1e-6)
    assert ours["cosine_similarity"] == pytest.approx(cosine, abs=6e-6)
    assert ours["scale_ratio"] == pytest.approx(scale, abs=6e-5)
    assert ours["motion_preservation"] == pytest.approx(motion, abs=6e-5)
