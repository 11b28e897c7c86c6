"""Options of ``smooth-operator hands add``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar

from tyro.conf import Positional, UseAppendAction, arg

from smooth_operator.cli.common_options import Common, HandSide, Page


@dataclass(frozen=True, kw_only=True)
class Add(Common, Page):
    """Your own hand: reads any URDF or MJCF, finds palm, fingers and tips, writes a spec file."""

    work: ClassVar[str] = "smooth_operator.cli.hands_add:add_hand"
    details: ClassVar[str] = """Finds palm, fingers, thumb, order, fingertips, side, coupled
joints, wrist and a neutral pose, from how the joints move and not from names. The output gives
confidence, reason and the option that overrides each; run it again with those options. The model
and its meshes are copied to the folder of the spec file, so the original may be moved or deleted;
after a change to it, run the command again.

Examples:
  smooth-operator hands add vendor/hand_right.urdf
  smooth-operator hands add two_hands.urdf --side left --name my_left
  smooth-operator hands add hand.xml --thumb link_12 --tip index=link_3:0,0,0.027 --overwrite
  smooth-operator hands add hand.urdf --json"""

    model: Annotated[Positional[Path], arg(metavar="PATH")]
    """URDF or MJCF file, with or without its meshes; an arm may be attached."""

    name: Annotated[str | None, arg(metavar="NAME")] = None
    """Name by which --hand will know it; from the file's name if left out."""

    side: Annotated[HandSide | None, arg(metavar="right|left")] = None
    """Which hand; found if left out. Of two hands in one file, the one to take."""

    palm: Annotated[str | None, arg(metavar="BODY")] = None
    """Body from which the fingers branch."""

    thumb: Annotated[str | None, arg(metavar="BODY")] = None
    """Any body or joint of the thumb."""

    finger: Annotated[UseAppendAction[tuple[str, ...]], arg(metavar="FINGER=BODY")] = ()
    """Human finger that drives the one with this body or joint; may be given several times."""

    tip: Annotated[UseAppendAction[tuple[str, ...]], arg(metavar="FINGER=BODY:x,y,z")] = ()
    """Fingertip: a body of the last link, and a point in its frame [m]; may be given several
    times."""

    wrist: Annotated[str | None, arg(metavar="BODY:x,y,z")] = None
    """Wrist: a body fixed to the palm, and a point in its frame [m]."""

    overwrite: bool = False
    """Replace a spec file of that name and side."""

    in_place: bool = False
    """Copy nothing: the spec file names the model where it is."""

    json: bool = False
    """One JSON object on standard output instead of the checklist, and no page."""

    no_view: bool = False
    """Open no page to look at the hand."""
