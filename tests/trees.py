"""Random kinematic trees and small hand models, for more than one test file."""

import contextlib
from pathlib import Path

import jax
import mujoco
import numpy as np

from smooth_operator.hands.spec import FingerSpec, HandSpec, Point


def float64() -> contextlib.AbstractContextManager[object]:
    """JAX in float64 inside a ``with``, whatever the version of JAX spells it."""
    switch = getattr(jax, "enable_x64", None)
    if switch is not None and hasattr(switch, "__call__"):  # noqa: B004
        return switch(True)
    from jax.experimental import enable_x64

    return enable_x64()


def random_rotations(rng: np.random.Generator, *batch: int) -> np.ndarray:
    """(..., 3, 3) uniform proper rotations."""
    w, x, y, z = np.moveaxis(unit(rng.standard_normal((*batch, 4))), -1, 0)
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)),
        (2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)),
        (2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)),
    )
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def random_model(seed: int, bodies: int = 12) -> mujoco.MjModel:
    """A tree that has all that a model may: branches, hinges and slides with any axis and anchor,
    several joints on a body, non-zero references, bodies fixed to bodies, parallel axes."""
    rng = np.random.default_rng(seed)
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    spec.compiler.autolimits = True
    made = [spec.worldbody.add_body(name="root")]
    made[0].add_geom(size=[0.01, 0, 0])
    made[0].add_joint(name="arm", axis=[0.3, 0.2, 0.9], range=[-1, 1])
    for b in range(bodies):
        # mostly the newest body, so that chains grow long
        parent = made[-1] if rng.random() < 0.6 else made[rng.integers(len(made))]
        aligned = rng.random() < 0.3  # parallel axes take their own path through the reduction
        body = parent.add_body(
            name=f"b{b}",
            pos=rng.normal(0, 0.05, 3),
            quat=[1, 0, 0, 0] if aligned else unit(rng.standard_normal(4)),
        )
        body.add_geom(size=[0.01, 0, 0])
        for j in range(rng.choice(4, p=[0.2, 0.5, 0.2, 0.1])):
            middle, half = rng.uniform(-0.5, 0.5), rng.uniform(0.2, 1.5)
            slide = rng.random() < 0.25
            body.add_joint(
                name=f"b{b}j{j}",
                type=mujoco.mjtJoint.mjJNT_SLIDE if slide else mujoco.mjtJoint.mjJNT_HINGE,
                axis=rng.choice([-1.0, 1.0]) * np.eye(3)[rng.integers(3)]
                if aligned
                else rng.standard_normal(3),
                pos=rng.normal(0, 0.02, 3),
                ref=rng.choice([0.0, rng.uniform(-1, 1) * (0.05 if slide else 1)]),
                range=[middle - half, middle + half],
            )
        made.append(body)
    return spec.compile()


def random_palm(model: mujoco.MjModel, rng: np.random.Generator) -> tuple[int, list[int]]:
    """A body, other than the world, with at least three bodies under it, and those bodies."""
    under: dict[int, list[int]] = {b: [] for b in range(model.nbody)}
    for b in range(1, model.nbody):
        above = model.body_parentid[b]
        while above > 0:
            under[int(above)].append(b)
            above = model.body_parentid[above]
    palm = int(rng.choice([b for b in range(1, model.nbody) if len(under[b]) >= 3]))
    return palm, under[palm]


def mujoco_points(
    model: mujoco.MjModel, palm: int, points: list[tuple[int, np.ndarray]], q: np.ndarray
) -> np.ndarray:
    """(T, k, 3) what MuJoCo says of points on bodies, in the palm frame, for (T, n) joints."""
    data, out = mujoco.MjData(model), []
    for row in q:
        data.qpos[:] = row
        mujoco.mj_kinematics(model, data)
        at = [data.xpos[b] + data.xmat[b].reshape(3, 3) @ offset for b, offset in points]
        out.append((np.array(at) - data.xpos[palm]) @ data.xmat[palm].reshape(3, 3))
    return np.array(out)


def limited_poses(rng: np.random.Generator, limits: np.ndarray, count: int) -> np.ndarray:
    """(count, n) uniform within limits."""
    return rng.uniform(limits[:, 0], limits[:, 1], (count, len(limits)))


PINCER = """
<mujoco>
  <compiler angle="radian" autolimits="true"/>
  <worldbody>
    <body name="palm">
      <geom size="0.02"/>
      <body name="t1" pos="0.03 0 0.01"><joint name="t1" axis="0 1 0" {t1}/><geom size="0.01"/>
        <body name="t2" pos="0 0 0.03"><joint name="t2" axis="1 0 0" {t2}/><geom size="0.01"/>
        </body>
      </body>
      <body name="i1" pos="0 0.01 0.05"><joint name="i1" axis="1 0 0" {i1}/><geom size="0.01"/>
        <body name="i2" pos="0 0 0.03"><joint name="i2" axis="1 0 0" {i2}/><geom size="0.01"/>
          <body name="i3" pos="0 0 0.02"><joint name="i3" axis="1 0 0" {i3}/><geom size="0.01"/>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>{actuators}</actuator>
  <equality>{equality}</equality>
</mujoco>
"""


def pincer(
    folder: Path,
    *,
    equality: str = "",
    actuated: tuple[str, ...] = ("t1", "t2", "i1", "i2"),
    **joints: str,
) -> HandSpec:
    """A hand of two fingers and five hinges as an MJCF file; keywords are joints' attributes."""
    attributes = dict.fromkeys(("t1", "t2", "i1", "i2", "i3"), 'range="-1 2"') | joints
    motors = "".join(f'<position joint="{name}"/>' for name in actuated)
    path = folder / "pincer.xml"
    path.write_text(PINCER.format(actuators=motors, equality=equality, **attributes))
    return pincer_spec(path)


def pincer_spec(path: Path) -> HandSpec:
    thumb = FingerSpec("thumb", (Point("t1"), None, None, Point("t2", (0.0, 0.0, 0.02))))
    index = FingerSpec(
        "index", (Point("i1"), Point("i2"), Point("i3"), Point("i3", (0.0, 0.0, 0.02)))
    )
    return HandSpec(
        name="pincer",
        side="right",
        model=path,
        palm="palm",
        wrist=Point("palm", (0.01, -0.02, -0.03)),
        fingers=(thumb, index),
        align=("wrist", "thumb", "index"),
    )
