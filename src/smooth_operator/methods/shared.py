"""One compiled program for all retargeters that would compile the same one.

Compiling takes seconds, so what has been compiled in this process is kept a while: for a second
retargeter of the same hand and configuration, and for a hand that is described as the mirror image
of another, which is served by the other's program with the landmarks reflected. By construction it
then has equal joint positions for mirrored poses, bit for bit.

Hands of one structure but other figures (left and right as published) have their own programs.
Figures as arguments instead of constants would let them share one: tried by lifting all 5,900 of
``realtime`` and 1,900 of ``paper`` out of the program, which then took 3.5 and 2.1 times as long
per frame, since the compiler could no longer fold them, nor fuse across them.
"""

from __future__ import annotations

import hashlib
import threading
from collections import OrderedDict
from collections.abc import Callable
from typing import Any, Final, NamedTuple

import numpy as np

from smooth_operator.hands.hand import Hand, load_hand_spec
from smooth_operator.methods.method import Method, MethodConfig
from smooth_operator.methods.program import Program, frame_program
from smooth_operator.plugins import Entry

_COMPILED_PROGRAM = Entry("smooth_operator.compilation.compiled_program:CompiledProgram")
_KEPT: Final = 16
_SHAPES: Final = (
    "body_parentid", "body_pos", "body_quat", "geom_bodyid", "geom_type", "geom_size", "geom_pos",
    "geom_quat", "geom_aabb", "geom_margin", "geom_contype", "geom_conaffinity", "mesh_vert",
    "exclude_signature",
)  # fmt: skip
"""Arrays of a model that say which of its parts can meet, and where."""
_known: OrderedDict[tuple[str, MethodConfig, bool], SharedProgram] = OrderedDict()
_lock = threading.Lock()


class SharedProgram(NamedTuple):
    """A program, and whose it is.

    Attributes:
        method: the method that it was made from.
        run: the program of one frame.
        reflects: it is that of the hand's mirror image, and takes landmarks reflected.
        compiled: set once it has answered a frame.
    """

    method: Method
    run: Program
    reflects: bool
    compiled: threading.Event


def shared_program(hand: Hand, config: MethodConfig, cache: bool = True) -> SharedProgram:
    """The program of a frame for a hand, or for its mirror image if it is described as one.

    Args:
        hand: the robot hand.
        config: the method's settings.
        cache: whether it is read from the user's cache, and kept there.

    Raises:
        SmoothOperatorError: the method can't serve the hand.
    """
    if not config.shareable:
        return _made(hand, config, False, cache)
    reflects = hand.spec.mirror
    served = load_hand_spec(hand.spec.mirrored) if reflects else hand
    key = (fingerprint(served), config, cache)
    try:
        with _lock:
            known = _known.get(key)
    except TypeError:  # a configuration of the user's own that has no hash
        return _made(served, config, reflects, cache)
    made = (known or _made(served, config, reflects, cache))._replace(reflects=reflects)
    with _lock:
        _known[key] = made
        _known.move_to_end(key)
        while len(_known) > _KEPT:
            _known.popitem(last=False)
    return made


def fingerprint(hand: Hand) -> str:
    """A digest of all of a hand that a program holds: its figures, not its name or its file."""
    tree = hand.tree
    digest = hashlib.sha256()
    parts: list[object] = [
        hand.spec.side,
        hand.fingers,
        hand.align_indices,
        hand.actuated_names,
        hand.joint_names,
        hand.unreadable,
        tuple(tree.names),
        [(j.parent, j.offset, j.source, j.slide) for j in tree.joints],
        [(name, point.joint) for name, point in tree.keypoints.items()],
        [(m.joint, m.offset, sorted(m.gains.items())) for m in hand.spec.joint_map],
    ]
    arrays = [
        hand.limits,
        hand.neutral,
        hand.coupling_matrix,
        hand.coupling_offset,
        tree.limits,
        hand.align_points,
        *(j.rotation for j in tree.joints),
        *(j.translation for j in tree.joints),
        *(point.position for point in tree.keypoints.values()),
        # two hands that move alike may be of other shapes, and keep clear of themselves otherwise
        *(getattr(hand.model, name) for name in _SHAPES),
    ]
    digest.update(repr(parts).encode())
    for array in arrays:
        digest.update(np.ascontiguousarray(array, np.float64).tobytes())
    return digest.hexdigest()


def _made(hand: Hand, config: MethodConfig, reflects: bool, cache: bool) -> SharedProgram:
    method = config.build(hand)

    def compiling(function: Callable[..., Any], name: str = "frame") -> Callable[..., Any]:
        of: Any = {"constants": method.constants, "cached": cache}
        program: Callable[..., Any] = _COMPILED_PROGRAM.load()(function, hand, config, name, **of)
        return program

    run = frame_program(method, config.alignment, compiling)
    return SharedProgram(method, run, reflects, threading.Event())
