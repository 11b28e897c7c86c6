"""Where the landmarks of the catalogue are on the real models, by their own names.

Written down from the vendors' files, and apart from the catalogue, so that a slip in a model or in
a description of ours shows.
"""

from dataclasses import dataclass

At = tuple[str, tuple[float, ...]]
"""Body, offset in its frame [m]."""
Finger = list[At | None]


@dataclass(frozen=True)
class RealHand:
    """A published model.

    Attributes:
        file: below the folder of real hands.
        palm: body whose frame is our palm frame.
        wrist: body or place in the palm frame; None where it is ours to choose.
        fingers: base to tip; None where the finger has no such joint.
        moving: fingers whose base is moved by a joint; ours is where it lies in the neutral pose.
    """

    file: str
    palm: str
    wrist: At | None
    fingers: dict[str, Finger]
    moving: tuple[str, ...] = ()


def at(text: str) -> At:
    """A point from ``BODY`` or ``BODY:x,y,z``."""
    body, _, offset = text.partition(":")
    return body, tuple(float(number) for number in (offset or "0,0,0").split(","))


def finger(text: str) -> Finger:
    """Four points from base to tip; ``-`` is a joint that the finger has not got."""
    return [None if word == "-" else at(word) for word in text.split()]


LONG = ("index", "middle", "ring", "pinky")
SHADOW = ("ff", "mf", "rf", "lf")


def shadow(p: str, side: str) -> RealHand:
    fingers = {"thumb": finger(f"{p}thbase {p}thhub {p}thdistal {p}thdistal:0,0,0.0275")}
    for name, f in zip(LONG, SHADOW, strict=True):
        tip = f"{p}{f}distal:0,0,0.026"
        fingers[name] = finger(f"{p}{f}knuckle {p}{f}middle {p}{f}distal {tip}")
    file = f"hands/shadow_hand/{side}_hand.xml"
    return RealHand(file, f"{p}palm", at(f"{p}palm"), fingers, moving=("pinky",))


def allegro(side: str) -> RealHand:
    fingers = {"thumb": finger("th_base th_medial th_distal th_distal:0,0,0.0543")}
    for name, f in zip(LONG[:3], SHADOW[:3], strict=True):
        fingers[name] = finger(f"{f}_proximal {f}_medial {f}_distal {f}_distal:0,0,0.0387")
    file = f"hands/wonik_allegro_hand/{side}_hand.xml"
    return RealHand(file, "palm", at("palm:0,0,-0.095"), fingers)


def leap_right() -> RealHand:
    thumb = "thumb_temp_base thumb_dip:0,0,-0.015 thumb_fingertip:0,0,-0.015 thumb_tip_head"
    fingers = {"thumb": finger(thumb)}
    for name, k in (("index", ""), ("middle", "_2"), ("ring", "_3")):
        bones = f"mcp_joint{k}:0,0,0.0145 dip{k}:0,0,0.015 fingertip{k}:0,0,0.015"
        fingers[name] = finger(f"{bones} {name}_tip_head")
    return RealHand("hands/leap_hand/right_hand.xml", "palm_lower", at("base"), fingers)


def leap_left() -> RealHand:
    thumb = "th_mp th_px:0,0,-0.015 th_ds:0,0,-0.015 th_ds:0,-0.06,-0.015"
    fingers = {"thumb": finger(thumb)}
    for name, f in (("index", "if"), ("middle", "mf"), ("ring", "rf")):
        tip = f"{f}_ds:0,-0.048,0.015"
        fingers[name] = finger(f"{f}_bs:0,0,0.0145 {f}_md:0,0,0.015 {f}_ds:0,0,0.015 {tip}")
    return RealHand("hands/leap_hand/left_hand_kinematics_only.xml", "palm", None, fingers)


def wuji() -> RealHand:
    fingers = {}
    for k, name in enumerate(("thumb", *LONG), 1):
        f = f"right_finger{k}_"
        fingers[name] = finger(f"{f}link1 {f}link3 {f}link4 {f}tip_link")
    palm = "right_palm_link"
    return RealHand("hands/wuji_hand/right_hand.xml", palm, at(palm), fingers)


def dexee() -> RealHand:
    fingers = {}
    for k, name in ((0, "thumb"), (2, "index"), (1, "middle")):
        f = f"F{k}/finger_"
        fingers[name] = finger(f"{f}proximal {f}middle {f}distal {f}distal:0,-0.0062,0.04")
    file = "hands/shadow_dexee_hand/shadow_dexee.xml"
    return RealHand(file, "hand_base", None, fingers, moving=("thumb", "index", "middle"))


def orca() -> RealHand:
    r, tip = "right_", "FingerTipAssembly_"
    thumb = f"{r}T-TP-R_1c2b802d {r}T-PP_68395e98 {r}T-DP_b7429e50"
    fingers = {"thumb": finger(f"{thumb} {r}T-DP_b7429e50:-0.007,0,0.025")}
    for name, base, last in (
        ("index", "I-PP_bacbd481", f"I-{tip}ec49c16c"),
        ("middle", "M-PP_08efa608", f"M-{tip}34afb748"),
        ("ring", "M-PP_8660a1eb", f"M-{tip}424a8e75"),
        ("pinky", "P-PP_1d411b9b", f"P-{tip}cd219176"),
    ):
        fingers[name] = finger(f"{r}{base} {r}{last} - {r}{last}:-0.0125,0,0.035")
    file = "hands/orca_v2_hand/right_hand_kinematics_only.xml"
    return RealHand(file, "right_R-Carpals_8d1f1041", None, fingers, moving=LONG)


def ability(side: str) -> RealHand:
    fingers = {name: finger(f"{name}_L1 {name}_L2 - {name}_tip") for name in ("thumb", *LONG)}
    file = f"hands_urdf/ability_hand/ability_hand_{side}.urdf"
    return RealHand(file, "base", at("base"), fingers)


def inspire(side: str) -> RealHand:
    thumb = "thumb_proximal_base thumb_intermediate thumb_distal thumb_tip"
    fingers = {"thumb": finger(thumb)}
    fingers |= {n: finger(f"{n}_proximal {n}_intermediate - {n}_tip") for n in LONG}
    file = f"hands_urdf/inspire_hand/inspire_hand_{side}.urdf"
    return RealHand(file, "hand_base_link", None, fingers)


def svh(side: str) -> RealHand:
    h = f"{side}_hand_"
    fingers = {
        name: finger(f"{h}{a} {h}{b} {h}{c} {tip}tip")
        for name, (a, b, c), tip in (
            ("thumb", "abc", "th"),
            ("index", "lpt", "ff"),
            ("middle", "kos", "mf"),
            ("ring", "jnr", "rf"),
            ("pinky", "imq", "lf"),
        )
    }
    file = f"hands_urdf/schunk_hand/schunk_svh_hand_{side}.urdf"
    return RealHand(file, f"{h}e1", at(f"{h}e1"), fingers, moving=("ring", "pinky"))


REAL: dict[tuple[str, str], RealHand] = {
    ("shadow_hand", "right"): shadow("rh_", "right"),
    ("shadow_hand", "left"): shadow("lh_", "left"),
    ("leap_hand", "right"): leap_right(),
    ("leap_hand", "left"): leap_left(),
    ("wuji_hand", "right"): wuji(),
    ("shadow_dexee", "right"): dexee(),
    ("orca_v2", "right"): orca(),
    **{
        (name, side): make(side)
        for name, make in (
            ("allegro_hand", allegro),
            ("ability_hand", ability),
            ("inspire_hand", inspire),
            ("schunk_svh", svh),
        )
        for side in ("right", "left")
    },
}
"""The published models by our name and side; the mimic hand has its own tests."""
