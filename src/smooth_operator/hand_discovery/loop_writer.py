"""Writes a model whose loops were opened: an MJCF file with the new tree, and the meshes."""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final
from xml.etree import ElementTree

import mujoco
import numpy as np
from jaxtyping import Float

from smooth_operator.hand_discovery.linkages import Edge, LinkGraph, Loop
from smooth_operator.hands.spec import Coupling


@dataclass(frozen=True)
class OpenLoop:
    """A closed loop of links that was cut open, with its joints.

    Attributes:
        loop: the loop.
        leaders: name -> (2,) limits [rad].
        couplings: couplings of all other joints.
        ranges: name -> (2,) range of any joint [rad].
        reference: name -> position in the reference pose [rad].
    """

    loop: Loop
    leaders: Mapping[str, Float[np.ndarray, "2"]]
    couplings: tuple[Coupling, ...]
    ranges: Mapping[str, Float[np.ndarray, "2"]]
    reference: Mapping[str, float]


_REFERENCES: Final = {
    "body": ("body", "body1", "body2"),
    "joint": ("joint", "joint1", "joint2", "jointinparent"),
    "site": ("site", "site1", "site2", "refsite", "cranksite", "slidersite", "sidesite"),
    "geom": ("geom", "geom1", "geom2"),
    "tendon": ("tendon", "tendon1", "tendon2"),
}
"""Kind of element -> attributes that refer to such an element by name."""


def write_without_loops(
    spec: mujoco.MjSpec, graph: LinkGraph, solutions: Sequence[OpenLoop], folder: Path
) -> str:
    """Returns the model as MJCF with the new trees; copies its meshes into the folder."""
    root = ElementTree.fromstring(spec.to_xml())
    before = _names(root)
    bodies = {element.get("name", ""): element for element in root.iter("body")}
    joints = {element.get("name", ""): element for element in root.iter("joint")}
    above = {child: parent for parent in root.iter() for child in parent}
    for solution in solutions:
        loop = solution.loop
        moving = {b: bodies[graph.model.body(b).name] for b in loop.moving}
        for body, element in moving.items():
            if (childclass := _childclass(element, above)) is not None:
                element.set("childclass", childclass)
            edge = loop.joints.get(body)
            if edge is not None and edge.other(body) == graph.parent(body):
                _set_range(joints[edge.name], solution)
        placed = {b: e for b, e in loop.parents.items() if e.other(b) != graph.parent(b)}
        for body in {*placed, *loop.dropped}:
            above[moving[body]].remove(moving[body])
        for body, edge in placed.items():
            parent = edge.other(body)
            into = bodies[graph.model.body(parent).name] if parent else _world(root)
            into.append(moving[body])
            _place(moving[body], graph, body, edge, joints, solution)
    _tidy(root, before, solutions)
    _copy_assets(root, folder)
    return ElementTree.tostring(root, "unicode")


def _world(root: ElementTree.Element) -> ElementTree.Element:
    world = root.find("worldbody")
    assert world is not None
    return world


def _childclass(
    element: ElementTree.Element, above: Mapping[ElementTree.Element, ElementTree.Element]
) -> str | None:
    while element.get("childclass") is None and element in above:
        element = above[element]
    return element.get("childclass")


def _set_range(joint: ElementTree.Element, solution: OpenLoop) -> None:
    low, high = solution.ranges[joint.get("name", "")]
    joint.set("range", f"{float(low)!r} {float(high)!r}")
    joint.set("limited", "true")


def _place(
    element: ElementTree.Element,
    graph: LinkGraph,
    body: int,
    edge: Edge,
    joints: Mapping[str, ElementTree.Element],
    solution: OpenLoop,
) -> None:
    """Puts a body at its place in the frame of its new parent, with its new joint."""
    parent = edge.other(body)
    turn = graph.frames[parent].T @ graph.frames[body]
    place = graph.frames[parent].T @ (graph.places[body] - graph.places[parent])
    quat = np.empty(4)
    mujoco.mju_mat2Quat(quat, turn.ravel())
    element.set("pos", _text(place))
    element.set("quat", _text(quat))
    for old in element.findall("joint"):
        element.remove(old)
    if edge.axis is None or edge.anchor is None:
        return
    # a joint that turned the parent against this body turns it the other way round
    sign = -1.0 if edge.joint >= 0 else 1.0
    kept = joints[edge.name].attrib if edge.joint >= 0 else {}
    joint = ElementTree.Element("joint", {**kept, "name": edge.name, "type": edge.kind})
    joint.set("axis", _text(graph.frames[body].T @ edge.axis * sign))
    joint.set("pos", _text(graph.frames[body].T @ (edge.anchor - graph.places[body])))
    joint.set("ref", repr(solution.reference[edge.name]))
    _set_range(joint, solution)
    element.insert(0, joint)


def _text(values: np.ndarray) -> str:
    return " ".join(repr(float(value)) for value in values)


def _names(root: ElementTree.Element) -> dict[str, set[str]]:
    """Kind of element -> names of all of them."""
    world = {
        kind: {element.get("name", "") for element in _world(root).iter(kind)}
        for kind in ("body", "joint", "site", "geom")
    }
    tendons = root.find("tendon")
    world["tendon"] = {t.get("name", "") for t in ([] if tendons is None else tendons)}
    return world


def _tidy(
    root: ElementTree.Element, before: Mapping[str, set[str]], solutions: Sequence[OpenLoop]
) -> None:
    """Removes what refers to parts that are gone, and gives each leader a motor."""
    for section in ("sensor", "keyframe"):
        for element in root.findall(section):
            root.remove(element)
    followers = {c.joint for one in solutions for c in one.couplings}
    fitted = {name for one in solutions for name in one.ranges}
    leaders = [name for one in solutions for name in one.leaders]
    for section in ("tendon", "contact", "equality", "actuator"):  # actuators may be on tendons
        after = _names(root)
        gone = {kind: names - after[kind] for kind, names in before.items()}
        for group in root.findall(section):
            for element in list(group):
                named = [
                    (kind, part.get(attribute))
                    for part in element.iter()
                    for kind, attributes in _REFERENCES.items()
                    for attribute in attributes
                ]
                lost = any(name in gone[kind] for kind, name in named)
                led = (section == "actuator" and element.get("joint") in followers) or (
                    section == "equality"
                    and {element.get("joint1"), element.get("joint2")} <= fitted
                )
                if lost or led or element.tag in ("connect", "weld"):
                    group.remove(element)
    driven = {a.get("joint") for group in root.findall("actuator") for a in group}
    if any(root.findall("actuator")):
        motors = ElementTree.SubElement(root, "actuator")
        for name in leaders:
            if name not in driven:
                ElementTree.SubElement(motors, "position", joint=name, name=f"{name} motor")


def _copy_assets(root: ElementTree.Element, folder: Path) -> None:
    """Copies meshes and textures into the folder, and names them relative to it."""
    for compiler in root.iter("compiler"):
        for attribute in ("meshdir", "texturedir", "assetdir", "strippath"):
            compiler.attrib.pop(attribute, None)
    for assets in root.findall("asset"):
        for number, element in enumerate(assets):
            if (name := element.get("file")) is None:
                continue
            file = Path("assets") / f"{number}_{Path(name).name}"
            (folder / file.parent).mkdir(exist_ok=True)
            shutil.copyfile(name, folder / file)
            element.set("file", file.as_posix())
            element.attrib.setdefault("name", Path(name).stem)
