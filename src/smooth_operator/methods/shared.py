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

import threading
from collections import OrderedDict
from typing import Final, NamedTuple

from smooth_operator.hands.hand import Hand, fingerprint, load_hand_spec
from smooth_operator.methods.method import Method, MethodConfig
from smooth_operator.methods.program import Program, frame_program

_KEPT: Final = 16
_programs: OrderedDict[tuple[str, MethodConfig, bool], SharedProgram] = OrderedDict()
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
        cache: True to read it from the user's cache, and to store it there.

    Raises:
        SmoothOperatorError: the method can't serve the hand.
    """
    if not config.shareable:
        return _built(hand, config, False, cache)
    reflects = hand.spec.mirror
    served = load_hand_spec(hand.spec.mirrored) if reflects else hand
    key = (fingerprint(served), config, cache)
    try:
        with _lock:
            stored = _programs.get(key)
    except TypeError:  # a configuration of the user's own that has no hash
        return _built(served, config, reflects, cache)
    program = (stored or _built(served, config, reflects, cache))._replace(reflects=reflects)
    with _lock:
        _programs[key] = program
        _programs.move_to_end(key)
        while len(_programs) > _KEPT:
            _programs.popitem(last=False)
    return program


def _built(hand: Hand, config: MethodConfig, reflects: bool, cache: bool) -> SharedProgram:
    method = config.build(hand)
    return SharedProgram(method, frame_program(method, config, cache), reflects, threading.Event())
