"""A hand as the simple shapes that keep its parts from touching, in place of its meshes."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import trimesh

from smooth_operator.hand_files.menagerie import has_meshes
from smooth_operator.hand_files.stand_ins import stand_ins
from smooth_operator.hands.collision import solid_shapes
from smooth_operator.hands.hand import Hand
from smooth_operator.hands.solids import Capsule, shape_capsules
from smooth_operator.teleop.pages.meshes import body_meshes


def simple_meshes(hand: Hand) -> dict[int, trimesh.Trimesh]:
    """The surfaces of a hand's simple shapes, by body, each in its body's frame [m].

    A model without meshes is drawn as it is. Of one with meshes, as a user's own, or with links
    that lack shapes, the capsules are drawn that self-collision is judged by; each mesh is about
    one capsule.

    Args:
        hand: the robot hand.
    """
    estimated = stand_ins(hand)
    if not has_meshes(hand) and not estimated.capsules:
        return body_meshes(hand.model, hand.bodies)
    part = hand.model.body_weldid[hand.model.geom_bodyid]
    shapes = solid_shapes(hand) & ~np.isin(part, list(estimated.replaced))
    capsules = [
        capsule
        for geom in np.flatnonzero(shapes)
        for capsule in shape_capsules(hand.model, int(geom))
    ]
    parts: dict[int, list[trimesh.Trimesh]] = {}
    for capsule in [*capsules, *estimated.capsules]:
        parts.setdefault(capsule.body, []).append(_surface(capsule))
    merged: dict[int, trimesh.Trimesh] = {}
    for body, pieces in parts.items():
        whole: Any = trimesh.util.concatenate(pieces)  # of meshes, it returns a mesh
        merged[body] = whole
    return merged or body_meshes(hand.model, hand.bodies)


def _surface(capsule: Capsule) -> trimesh.Trimesh:
    first, second = capsule.ends
    axis, length = second - first, float(np.linalg.norm(second - first))
    mesh = trimesh.creation.capsule(height=length, radius=capsule.radius, count=[16, 16])
    mesh.apply_translation(-mesh.bounds.mean(axis=0))
    if length > 0:
        turn, wxyz, matrix = np.eye(4), np.empty(4), np.empty(9)
        mujoco.mju_quatZ2Vec(wxyz, axis / length)
        mujoco.mju_quat2Mat(matrix, wxyz)
        turn[:3, :3] = matrix.reshape(3, 3)
        mesh.apply_transform(turn)
    mesh.apply_translation((first + second) / 2)
    return mesh
