"""Findings about a model, each with its confidence and reason, and what a user overrules."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

from smooth_operator.errors import HandModelError
from smooth_operator.hands.loading import Coupling
from smooth_operator.hands.spec import HandSpec, Point
from smooth_operator.landmarks import FINGERS

SURE: Final = 0.8
"""A finding of at least this confidence needs no second look."""
UNSURE: Final = 0.5
"""A finding below this confidence is little better than a guess, and is to be said so."""


@dataclass(frozen=True)
class Finding:
    """One thing that was found.

    Attributes:
        subject: the subject: ``side``, ``palm``, ``thumb``, ``order``, ``tip of index``...
        value: the finding, as a text for a person.
        confidence: 0 (a guess) to 1 (the model says so).
        evidence: the reasons, in words.
        overrule: option that replaces it, of ``smooth-operator hands add``.
    """

    subject: str
    value: str
    confidence: float
    evidence: tuple[str, ...]
    overrule: str


@dataclass(frozen=True)
class FoundFinger:
    """A finger as found.

    Attributes:
        name: the human finger that drives it.
        tip_body: body that the fingertip is fixed to.
        tip_offset: (3,) fingertip in that body's frame [m].
        joints: all joints that move the tip, palm to tip, coupled ones included.
        confidence: the lower one of the name's and the tip's.
    """

    name: str
    tip_body: str
    tip_offset: tuple[float, float, float]
    joints: tuple[str, ...]
    confidence: float


@dataclass(frozen=True)
class FoundCoupling:
    """A coupled joint as found, and how sure that is."""

    coupling: Coupling
    confidence: float


@dataclass(frozen=True)
class Discovery:
    """All that was found in a model.

    Attributes:
        spec: the description, ready for ``load_hand_spec``.
        findings: with confidence and evidence, in the order of a checklist.
        fingers: thumb first, then from the thumb's side across the palm.
        coupled: joints of the hand that follow another.
        notes: other facts for a person, such as missing meshes.
    """

    spec: HandSpec
    findings: tuple[Finding, ...]
    fingers: tuple[FoundFinger, ...]
    coupled: tuple[FoundCoupling, ...]
    notes: tuple[str, ...] = ()

    @property
    def unsure(self) -> tuple[Finding, ...]:
        """Findings that a person should look at, least sure first."""
        doubtful = [finding for finding in self.findings if finding.confidence < SURE]
        return tuple(sorted(doubtful, key=lambda finding: finding.confidence))

    def to_json(self) -> dict[str, Any]:
        """The whole as one object of plain lists, numbers and strings.

        Returns:
            ``side`` and ``palm`` (strings), ``fingers`` (``name``, ``tip_body``, ``tip_offset``
            [m], ``joints``, ``confidence``), ``coupled`` (``joint``, ``follows``, ``multiplier``,
            ``offset`` [rad], ``confidence``), ``confidence`` (subject -> number, with ``side`` and
            ``palm``), ``evidence`` (subject -> reasons), and the rest of the description.
        """
        spec = self.spec
        return {
            "name": spec.name,
            "model": str(spec.model),
            "side": spec.side,
            "palm": spec.palm,
            "fingers": [
                {
                    "name": finger.name,
                    "tip_body": finger.tip_body,
                    "tip_offset": list(finger.tip_offset),
                    "joints": list(finger.joints),
                    "confidence": finger.confidence,
                }
                for finger in self.fingers
            ],
            "coupled": [
                {
                    "joint": coupling.coupling.joint,
                    "follows": coupling.coupling.follows,
                    "multiplier": coupling.coupling.multiplier,
                    "offset": coupling.coupling.offset,
                    "confidence": coupling.confidence,
                }
                for coupling in self.coupled
            ],
            "wrist": {"body": spec.wrist.body, "offset": list(spec.wrist.offset)},
            "align": list(spec.align),
            "neutral": dict(spec.neutral),
            "confidence": {f.subject: f.confidence for f in self.findings},
            "evidence": {f.subject: list(f.evidence) for f in self.findings},
            "unsure": [finding.subject for finding in self.unsure],
            "notes": list(self.notes),
        }


@dataclass(frozen=True)
class Overrules:
    """Findings that are given, not found.

    Attributes:
        palm: body from which the fingers branch.
        thumb: a body or joint of the thumb.
        fingers: (human finger, a body or joint of the robot finger that it drives) pairs; of a
            model with more than five fingers only these are used.
        tips: (human finger, fingertip) pairs.
        wrist: the wrist point.

    Raises:
        HandModelError: if a finger is not a human one, or is named twice.
    """

    palm: str | None = None
    thumb: str | None = None
    fingers: tuple[tuple[str, str], ...] = ()
    tips: tuple[tuple[str, Point], ...] = ()
    wrist: Point | None = None

    def __post_init__(self) -> None:
        for what, pairs in (("finger", self.fingers), ("tip", self.tips)):
            names = [name for name, _ in pairs]
            for name in names:
                if name not in FINGERS:
                    raise HandModelError(
                        f"--{what} names the finger {name!r}; expected one of {', '.join(FINGERS)}"
                    )
                if names.count(name) > 1:
                    raise HandModelError(
                        f"--{what} names {name!r} twice; give each finger one {what}"
                    )
