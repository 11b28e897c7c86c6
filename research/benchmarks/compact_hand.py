"""Makes the compact model and the description of a built-in hand from a maker's model.

    python research/benchmarks/compact_hand.py dexhand021 --checkout FOLDER [--output FOLDER]

``compact_hands.toml`` has an entry for each hand: its repository, commit and licence, the model
file of each side, and what the analysis of ``smooth-operator hands add`` has to be told. FOLDER is
a checkout of that repository at that commit. ``right_base`` and ``left_base`` give points of the
palm for the bases of fingers.

The model keeps link frames, joint limits, couplings and the maker's torques. Capsules replace the
meshes: those with which the program fills meshes for its self-collision term, or estimates along
the bones of links whose meshes are missing. An entry asks for estimates (``estimate``, beginnings
of the names of links) where a capsule can't follow a mesh, such as that of a palm which is hollow
around the thumb, or gives the capsules of a link itself (``shapes``). It also names pairs of links
that may overlap (``exclude``), as makers' MJCFs do, and gives joints the limits that a URDF leaves
out (``limits``).
"""

from __future__ import annotations

import argparse
import re
import tempfile
import tomllib
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from copy import copy
from dataclasses import replace
from pathlib import Path
from typing import Any, Final
from xml.etree import ElementTree

import mujoco
import numpy as np

from smooth_operator.cli.hands_add import Add, _overrules
from smooth_operator.hand_discovery.discover import discover
from smooth_operator.hand_discovery.loops import opened
from smooth_operator.hand_files.spec_writer import write_hand_spec
from smooth_operator.hands.capsules import hand_capsules
from smooth_operator.hands.collision import Capsule
from smooth_operator.hands.hand import Hand, load_hand_spec
from smooth_operator.hands.loading import MODELS, merged_couplings
from smooth_operator.hands.spec import Coupling, FingerSpec, HandSpec, Point
from smooth_operator.types import Side

RECIPES: Final = Path(__file__).with_name("compact_hands.toml")

_HEAD: Final = """\
<!-- {title}, {side} hand: a compact kinematic model with simple shapes.
     Figures (link frames, joint limits, couplings) are those of the published model; shapes are \
ours. -->
<mujoco model="{name}_{side}">
  <compiler angle="radian" autolimits="true"/>
  <option gravity="0 0 0" integrator="implicitfast"/>
  <default>
    <joint damping="0.2" armature="0.001" frictionloss="0.01"/>
    <position kp="3" inheritrange="1"/>
    <geom type="capsule" density="900" rgba="0.72 0.74 0.77 1"/>
    <site size="0.003" rgba="0.1 0.6 0.9 1"/>
  </default>
  <worldbody>
"""
_MOST_TORQUE: Final = 20.0  # a URDF's larger effort is no figure of a finger's motor [N m]
_LOCKED: Final = 0.01  # range of a joint that stands still [rad]
_TINY: Final = 1e-9


class CompactModel:
    """MJCF of a hand's moving links below the palm, one body per link.

    Bodies that are fixed to one another become one. A link is named after its finger and its number
    from the palm; joints keep the maker's names.

    Attributes:
        names: body of the maker's model -> name of the link that it belongs to.
    """

    def __init__(self, hand: Hand, estimate: tuple[str, ...] = ()) -> None:
        self.hand, self.model = hand, hand.model
        self.data = mujoco.MjData(self.model)
        mujoco.mj_kinematics(self.model, self.data)
        self.palm = self.model.body(hand.spec.palm).id
        self.names = {self.palm: "palm"}
        for finger in hand.spec.fingers:
            chain = []
            body = self._link(self.model.body(finger.tip.body).id)
            while body != self.palm:
                chain.insert(0, body)
                body = self._link(self.model.body_parentid[body])
            fresh = [body for body in chain if body not in self.names]
            shared = len(fresh) < len(chain)
            for k, body in enumerate(fresh):
                self.names[body] = f"{finger.name}_{k + 1 + shared * (len(chain) - len(fresh))}"
        self.capsules = self._shapes(hand)
        if estimate:
            guess = self._shapes(_without_shapes(hand))
            chosen = {body for body, name in self.names.items() if name.startswith(estimate)}
            self.capsules |= {body: guess[body] for body in chosen}

    def replace_capsules(self, shapes: Mapping[str, Sequence[Sequence[float]]]) -> None:
        """Takes the capsules of links from a recipe: both ends and the radius [m], in the frame of
        the link."""
        for body, name in self.names.items():
            if name in shapes:
                rows = np.array(shapes[name])
                ends = rows[:, :6].reshape(-1, 2, 3)
                self.capsules[body] = [
                    Capsule(-1, body, pair, float(row[6]))
                    for pair, row in zip(ends, rows, strict=True)
                ]

    def _shapes(self, hand: Hand) -> defaultdict[int, list[Capsule]]:
        """Link -> its capsules."""
        out: defaultdict[int, list[Capsule]] = defaultdict(list)
        for capsule in hand_capsules(hand):
            out[self._link(capsule.body)].append(capsule)
        return out

    def _link(self, body: int) -> int:
        """The moving body, or the palm, to which a body is fixed."""
        while body not in (self.palm, 0) and not self._moves(body):
            body = int(self.model.body_parentid[body])
        # what is fixed to the palm's own parent is the palm, too
        return self.palm if body == 0 else int(body)

    def _moves(self, body: int) -> bool:
        """Whether a joint of the body has a range; some models lock a joint by its limits."""
        model, first = self.model, self.model.body_jntadr[body]
        joints = range(first, first + model.body_jntnum[body])
        return any(np.ptp(model.jnt_range[joint]) > _LOCKED for joint in joints)

    def moved(self, point: Point) -> Point:
        """A landmark in the frame of its link."""
        body = self.model.body(point.body).id
        link = self._link(body)
        if link not in self.names:
            raise SystemExit(f"no finger holds the body {point.body!r} of a landmark")
        local = self._local(link, self._world(body, np.array(point.offset)))
        return Point(self.names[link], tuple(float(v) for v in local.round(6) + 0.0))

    def _world(self, body: int, local: np.ndarray) -> np.ndarray:
        out: np.ndarray = local @ self.data.xmat[body].reshape(3, 3).T + self.data.xpos[body]
        return out

    def _local(self, link: int, points: np.ndarray) -> np.ndarray:
        out: np.ndarray = (points - self.data.xpos[link]) @ self.data.xmat[link].reshape(3, 3)
        return out

    def text(self, title: str, exclude: Sequence[str]) -> str:
        """The file."""
        spec = self.hand.spec
        head = _HEAD.format(title=title, name=spec.name, side=spec.side)
        kept = [name for name in self.hand.joint_names if self._body(name) in self.names]
        lines = ["  </worldbody>", "  <actuator>"]
        lines += [
            f'    <position name="{name}" joint="{name}"/>'
            for name in self.hand.actuated_names
            if name in kept
        ]
        lines.append("  </actuator>")
        if exclude:
            pairs = [pair.split() for pair in exclude]
            rows = [f'    <exclude body1="{one}" body2="{other}"/>' for one, other in pairs]
            lines += ["  <contact>", *rows, "  </contact>"]
        couplings = [one for one in self.hand.couplings if one.joint in kept]
        if couplings:
            lines += ["  <equality>", *map(_equality, couplings), "  </equality>"]
        return head + "\n".join([*self._lines(self.palm, "    "), *lines, "</mujoco>", ""])

    def _body(self, joint: str) -> int:
        return int(self.model.joint(joint).bodyid[0])

    def _lines(self, link: int, pad: str) -> Iterator[str]:
        name = self.names[link]
        place = ""
        if link != self.palm:
            parent = self._link(self.model.body_parentid[link])
            turn = np.empty(4)
            local = self.data.xmat[parent].reshape(3, 3).T @ self.data.xmat[link].reshape(3, 3)
            mujoco.mju_mat2Quat(turn, local.ravel())
            place = f' pos="{_numbers(self._local(parent, self.data.xpos[link]), 7)}"'
            if abs(turn[0]) < 1 - _TINY:
                place += f' quat="{_numbers(turn, 9)}"'
        yield f'{pad}<body name="{name}"{place}>'
        first, count = self.model.body_jntadr[link], self.model.body_jntnum[link]
        for joint in range(first, first + count) if link != self.palm else ():
            yield self._joint(joint, pad)
        for joint_name in self.hand.spec.wrist_joints if link == self.palm else ():
            yield self._wrist_joint(joint_name, pad)
        rows = self.capsules[link]
        for k, capsule in enumerate(rows):
            label = name if len(rows) == 1 else f"{name}_{'abcdefghijklmnopqrstuvwxyz'[k % 26]}"
            label += "" if k < 26 else str(k // 26)
            ends = self._local(link, self._world(capsule.body, capsule.ends))
            size = f'size="{_numbers([capsule.radius], 5)}"'
            if np.linalg.norm(ends[1] - ends[0]) < 1e-4:
                shape = f'type="sphere" {size} pos="{_numbers(ends[0], 5)}"'
            else:
                shape = f'{size} fromto="{_numbers(ends.ravel(), 5)}"'
            yield f'{pad}  <geom name="{label}" {shape}/>'
        if link == self.palm:
            at = self.moved(self.hand.spec.wrist).offset
            yield f'{pad}  <site name="wrist" pos="{_numbers(at, 6)}"/>'
        for finger in self.hand.spec.fingers:
            tip = self.moved(finger.tip)
            if tip.body == name:
                site = f'{pad}  <site name="{finger.name}_tip" pos="{_numbers(tip.offset, 6)}"/>'
                yield site
        for child in self.names:
            if child != self.palm and self._link(self.model.body_parentid[child]) == link:
                yield from self._lines(child, pad + "  ")
        yield f"{pad}</body>"

    def _joint(self, joint: int, pad: str) -> str:
        model, name = self.model, self.model.joint(joint).name
        kind = "slide" if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE else ""
        low, high = self.hand.joint_limits[self.hand.joint_names.index(name)]
        text = f'{pad}  <joint name="{name}"' + (f' type="{kind}"' if kind else "")
        if np.linalg.norm(model.jnt_pos[joint]) > _TINY:
            text += f' pos="{_numbers(model.jnt_pos[joint], 7)}"'
        ref = float(model.qpos0[model.jnt_qposadr[joint]])
        if abs(ref) > _TINY:
            text += f' ref="{_numbers([ref], 6)}"'
        axis = _numbers(model.jnt_axis[joint], 6)
        return f'{text} axis="{axis}" range="{_numbers([low, high], 6)}"/>'

    def _wrist_joint(self, name: str, pad: str) -> str:
        """A joint between forearm and palm, which the compact model has on the palm itself."""
        joint, turn = self.data.joint(name), self.data.xmat[self.palm].reshape(3, 3)
        place = _numbers(self._local(self.palm, joint.xanchor), 7)
        axis, ends = _numbers(joint.xaxis @ turn, 6), _numbers(self.model.joint(name).range, 6)
        return f'{pad}  <joint name="{name}" pos="{place}" axis="{axis}" range="{ends}"/>'

    def spec(self, folder: Path, source: str) -> HandSpec:
        """The description with the compact model's names of bodies."""
        spec = self.hand.spec

        def moved(point: Point | None) -> Point | None:
            return None if point is None else self.moved(point)

        fingers = tuple(
            FingerSpec(f.name, tuple(moved(point) for point in f.points)) for f in spec.fingers
        )
        efforts = _efforts(self.hand)
        torque = {k: v for k, v in efforts.items() if self._body(k) in self.names} or spec.torque
        neutral = {
            name: round(float(value), 3) + 0.0
            for name, value in zip(self.hand.actuated_names, self.hand.neutral, strict=True)
            if self._body(name) in self.names
        }
        return replace(
            spec,
            model=folder / f"{spec.name}_{spec.side}.xml",
            palm="palm",
            wrist=self.moved(spec.wrist),
            fingers=fingers,
            neutral=neutral,
            torque=torque,
            couplings=(),
            source=source,
        )


def _without_shapes(hand: Hand) -> Hand:
    """The hand as if its model had no shapes, so that all capsules are estimates."""
    model = copy(hand.model)
    model.geom_contype[:] = model.geom_conaffinity[:] = 0
    model.geom_group[:] = 0
    return replace(hand, model=model)


def _efforts(hand: Hand) -> dict[str, float]:
    """Joint -> the maker's torque limit [N m], where the model states a believable one."""
    model, out = hand.model, {}
    for name in hand.actuated_names:
        joint = model.joint(name).id
        low, high = model.jnt_actfrcrange[joint]
        if model.jnt_actfrclimited[joint] and 0.01 < high < _MOST_TORQUE and -low == high:
            out[name] = round(float(high), 3)
    return out


def _equality(coupling: Coupling) -> str:
    coefficients = [*coupling.coefficients, 0, 0, 0, 0][:5]
    return (
        f'    <joint joint1="{coupling.joint}" joint2="{coupling.follows}" '
        f'polycoef="{_numbers(coefficients, 6)}"/>'
    )


def _numbers(values: np.ndarray | list[float] | tuple[float, ...], digits: int) -> str:
    return " ".join(f"{round(float(v), digits) + 0.0:.{digits + 1}g}" for v in values)


def compact(name: str, side: Side, recipe: Mapping[str, Any], checkout: Path, output: Path) -> None:
    """Writes model and description of one side."""

    def words(key: str) -> tuple[str, ...]:
        texts = [recipe[key]] if isinstance(recipe.get(key), str) else recipe.get(key, [])
        return tuple(text.format(side=side, s=side[0], S=side[0].upper()) for text in texts)

    file = recipe[side]
    source = (
        f"{recipe['title']}, {side} hand: {recipe['repository']} at {recipe['commit'][:12]}, "
        f"{file}, {recipe['licence']}"
    )
    macro = recipe.get("macro", "").format(side=side)
    with (
        _expanded(checkout / file, macro, checkout) as urdf,
        _limited(urdf, recipe.get("limits", {})) as path,
    ):
        add = Add(
            model=path,
            palm=next(iter(words("palm")), None),
            thumb=next(iter(words("thumb")), None),
            wrist=next(iter(words("wrist")), None),
            finger=words("finger"),
            tip=words("tip"),
            couple=words("couple"),
            gripper=recipe.get("gripper"),
        )
        with opened(path) as model:
            overrules = _overrules(add)
            if model.path != path:
                couplings = merged_couplings(model.couplings, overrules.couplings)
                overrules = replace(overrules, couplings=couplings)
            found = discover(model.path, side=side, name=name, overrules=overrules)
            for finding in found.unsure:
                print("unsure:", finding.subject, finding.value)
            for note in (*model.notes, *found.notes):
                print("note:", note)
            hand = load_hand_spec(found.spec)
            short = CompactModel(hand, words("estimate"))
            short.replace_capsules(recipe.get("shapes", {}))
            spec = short.spec(output, source + recipe.get("remark", ""))
            if "torque" in recipe:
                spec = replace(spec, torque=recipe["torque"])
            if "neutral" in recipe:
                own = {key.format(s=side[0], side=side): v for key, v in recipe["neutral"].items()}
                spec = replace(spec, neutral={**spec.neutral, **own})
            spec.model.write_text(short.text(recipe["title"], words("exclude")), encoding="utf-8")
    _compare(hand, load_hand_spec(spec))
    for finger, base in recipe.get(f"{side}_base", {}).items():
        moved = Point("palm", tuple(base))
        fingers = tuple(
            replace(one, points=(moved, *one.points[1:])) if one.name == finger else one
            for one in spec.fingers
        )
        spec = replace(spec, fingers=fingers)
    write_hand_spec(spec, output / f"{name}.{side}.toml")


@contextmanager
def _expanded(path: Path, macro: str, checkout: Path) -> Iterator[Path]:
    """The path, or that of a temporary URDF that a xacro file, or a macro of it, makes."""
    if path.suffix != ".xacro":
        yield path
        return
    import xacro

    whole = (
        '<robot name="hand" xmlns:xacro="http://www.ros.org/wiki/xacro">'
        f'<xacro:include filename="{path}"/><link name="world"/><joint name="fix" type="fixed">'
        f'<parent link="world"/><child link="{macro}_base"/></joint>'
        f'<xacro:{macro} prefix=""/></robot>'
    )
    with tempfile.TemporaryDirectory(dir=path.parent) as folder:

        def located(text: str) -> str:
            """The text with copies of packages in place of those that ROS would find."""
            return re.sub(r"\$\(find (\w+)\)", rf"{folder}/\1", text)

        for package in (found.parent for found in checkout.rglob("package.xml")):
            for file in sorted(package.rglob("*.xacro")):
                copied = Path(folder) / package.name / file.relative_to(package)
                copied.parent.mkdir(parents=True, exist_ok=True)
                copied.write_text(located(file.read_text(encoding="utf-8")), encoding="utf-8")
        main = Path(folder) / "hand.urdf.xacro"
        text = whole if macro else located(path.read_text(encoding="utf-8"))
        main.write_text(text, encoding="utf-8")
        urdf = Path(folder) / "hand.urdf"
        urdf.write_text(xacro.process_file(str(main)).toxml(), encoding="utf-8")
        yield urdf


@contextmanager
def _limited(path: Path, limits: Mapping[str, Sequence[float]]) -> Iterator[Path]:
    """The path, or that of a temporary copy of a URDF whose joints have the limits [rad]."""
    if not limits:
        yield path
        return
    tree = ElementTree.parse(path)
    for name, (low, high) in limits.items():
        joint = tree.find(f"joint[@name='{name}']")
        if joint is None:
            raise SystemExit(f"{path} has no joint {name!r}")
        joint.set("type", "revolute")
        for limit in joint.findall("limit"):
            joint.remove(limit)
        ElementTree.SubElement(
            joint, "limit", lower=str(low), upper=str(high), effort="0", velocity="0"
        )
    copied = path.with_name(f"limited_{path.name}")
    tree.write(copied)
    yield copied
    copied.unlink()


def _compare(hand: Hand, short: Hand) -> None:
    """Stops if the landmarks of the compact model differ from those of the maker's."""
    q = np.random.default_rng(0).uniform(*short.limits.T, (50, len(short.actuated)))
    wide = np.tile(hand.neutral, (50, 1))
    wide[:, np.ptp(hand.limits, axis=1) < _LOCKED] = 0.0
    for k, name in enumerate(short.actuated_names):
        wide[:, hand.actuated_names.index(name)] = q[:, k]
    gap = np.abs(hand.landmark_positions(wide) - short.landmark_positions(q)).max()
    if gap > 2e-5:
        raise SystemExit(f"landmarks of the compact model differ by {1e3 * gap:.3f} mm")


def main() -> None:
    """Reads the options and writes the files."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("name")
    parser.add_argument("--checkout", type=Path, required=True)
    parser.add_argument("--output", type=Path, default=MODELS)
    options = parser.parse_args()
    recipe = tomllib.loads(RECIPES.read_text(encoding="utf-8"))[options.name]
    sides: tuple[Side, ...] = ("right", "left")
    for side in sides:
        if side in recipe:
            compact(options.name, side, recipe, options.checkout, options.output)


if __name__ == "__main__":
    main()
