"""Where the landmarks of the catalogue are on the real models, by their own names.

Written down from the vendors' files, and apart from the catalogue, so that a slip in a model or in
a description of ours shows.
"""

from dataclasses import dataclass

At = tuple[str, tuple[float, float, float]]
"""Body, offset in its frame [m]."""
Finger = tuple[At | None, At | None, At | None, At | None]


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


def at(body: str, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> At:
    return body, (x, y, z)


LONG = ("index", "middle", "ring", "pinky")


def shadow(p: str, side: str) -> RealHand:
    def finger(f: str) -> Finger:
        return (
            at(f"{p}{f}knuckle"),
            at(f"{p}{f}middle"),
            at(f"{p}{f}distal"),
            at(f"{p}{f}distal", z=0.026),
        )

    thumb = (at(f"{p}thbase"), at(f"{p}thhub"), at(f"{p}thdistal"), at(f"{p}thdistal", z=0.0275))
    fingers = {n: finger(f) for n, f in zip(LONG, ("ff", "mf", "rf", "lf"), strict=True)}
    return RealHand(
        f"hands/shadow_hand/{side}_hand.xml",
        f"{p}palm",
        at(f"{p}palm"),
        {"thumb": thumb} | fingers,
        moving=("pinky",),
    )


def allegro(side: str) -> RealHand:
    def finger(f: str, tip: float, base: str) -> Finger:
        return at(f"{f}_{base}"), at(f"{f}_medial"), at(f"{f}_distal"), at(f"{f}_distal", z=tip)

    fingers = {
        n: finger(f, 0.0387, "proximal") for n, f in zip(LONG[:3], ("ff", "mf", "rf"), strict=True)
    }
    thumb = (at("th_base"), at("th_medial"), at("th_distal"), at("th_distal", z=0.0543))
    return RealHand(
        f"hands/wonik_allegro_hand/{side}_hand.xml",
        "palm",
        at("palm", z=-0.095),
        {"thumb": thumb} | fingers,
    )


def leap_right() -> RealHand:
    def finger(k: str, tip: str) -> Finger:
        return (
            at(f"mcp_joint{k}", z=0.0145),
            at(f"dip{k}", z=0.015),
            at(f"fingertip{k}", z=0.015),
            at(f"{tip}_tip_head"),
        )

    thumb = (
        at("thumb_temp_base"),
        at("thumb_dip", z=-0.015),
        at("thumb_fingertip", z=-0.015),
        at("thumb_tip_head"),
    )
    return RealHand(
        "hands/leap_hand/right_hand.xml",
        "palm_lower",
        at("base"),
        {
            "thumb": thumb,
            "index": finger("", "index"),
            "middle": finger("_2", "middle"),
            "ring": finger("_3", "ring"),
        },
    )


def leap_left() -> RealHand:
    def finger(f: str) -> Finger:
        return (
            at(f"{f}_bs", z=0.0145),
            at(f"{f}_md", z=0.015),
            at(f"{f}_ds", z=0.015),
            at(f"{f}_ds", y=-0.048, z=0.015),
        )

    thumb = (
        at("th_mp"),
        at("th_px", z=-0.015),
        at("th_ds", z=-0.015),
        at("th_ds", y=-0.06, z=-0.015),
    )
    return RealHand(
        "hands/leap_hand/left_hand_kinematics_only.xml",
        "palm",
        None,
        {"thumb": thumb, "index": finger("if"), "middle": finger("mf"), "ring": finger("rf")},
    )


def wuji() -> RealHand:
    fingers = {}
    for k, name in enumerate(("thumb", *LONG), 1):
        f = f"right_finger{k}_"
        fingers[name] = (at(f + "link1"), at(f + "link3"), at(f + "link4"), at(f + "tip_link"))
    return RealHand(
        "hands/wuji_hand/right_hand.xml", "right_palm_link", at("right_palm_link"), fingers
    )


def dexee() -> RealHand:
    fingers = {}
    for k, name in ((0, "thumb"), (2, "index"), (1, "middle")):
        f = f"F{k}/finger_"
        fingers[name] = (
            at(f + "proximal"),
            at(f + "middle"),
            at(f + "distal"),
            at(f + "distal", y=-0.0062, z=0.04),
        )
    return RealHand(
        "hands/shadow_dexee_hand/shadow_dexee.xml",
        "hand_base",
        None,
        fingers,
        moving=("thumb", "index", "middle"),
    )


def orca() -> RealHand:
    def finger(base: str, tip: str) -> Finger:
        return at(f"right_{base}"), at(f"right_{tip}"), None, at(f"right_{tip}", x=-0.0125, z=0.035)

    tip = "FingerTipAssembly_"
    return RealHand(
        "hands/orca_v2_hand/right_hand_kinematics_only.xml",
        "right_R-Carpals_8d1f1041",
        None,
        {
            "thumb": (
                at("right_T-TP-R_1c2b802d"),
                at("right_T-PP_68395e98"),
                at("right_T-DP_b7429e50"),
                at("right_T-DP_b7429e50", x=-0.007, z=0.025),
            ),
            "index": finger("I-PP_bacbd481", f"I-{tip}ec49c16c"),
            "middle": finger("M-PP_08efa608", f"M-{tip}34afb748"),
            "ring": finger("M-PP_8660a1eb", f"M-{tip}424a8e75"),
            "pinky": finger("P-PP_1d411b9b", f"P-{tip}cd219176"),
        },
        moving=LONG,
    )


def ability(side: str) -> RealHand:
    fingers: dict[str, Finger] = {
        n: (at(f"{n}_L1"), at(f"{n}_L2"), None, at(f"{n}_tip")) for n in ("thumb", *LONG)
    }
    return RealHand(
        f"hands_urdf/ability_hand/ability_hand_{side}.urdf", "base", at("base"), fingers
    )


def inspire(side: str) -> RealHand:
    fingers: dict[str, Finger] = {
        n: (at(f"{n}_proximal"), at(f"{n}_intermediate"), None, at(f"{n}_tip")) for n in LONG
    }
    thumb = (
        at("thumb_proximal_base"),
        at("thumb_intermediate"),
        at("thumb_distal"),
        at("thumb_tip"),
    )
    return RealHand(
        f"hands_urdf/inspire_hand/inspire_hand_{side}.urdf",
        "hand_base_link",
        None,
        {"thumb": thumb} | fingers,
    )


def svh(side: str) -> RealHand:
    def finger(letters: str, tip: str) -> Finger:
        a, b, c = (at(f"{side}_hand_{x}") for x in letters)
        return a, b, c, at(tip)

    fingers = {
        "thumb": finger("abc", "thtip"),
        "index": finger("lpt", "fftip"),
        "middle": finger("kos", "mftip"),
        "ring": finger("jnr", "rftip"),
        "pinky": finger("imq", "lftip"),
    }
    return RealHand(
        f"hands_urdf/schunk_hand/schunk_svh_hand_{side}.urdf",
        f"{side}_hand_e1",
        at(f"{side}_hand_e1"),
        fingers,
        moving=("ring", "pinky"),
    )


REAL: dict[tuple[str, str], RealHand] = {
    ("shadow_hand", "right"): shadow("rh_", "right"),
    ("shadow_hand", "left"): shadow("lh_", "left"),
    ("leap_hand", "right"): leap_right(),
    ("leap_hand", "left"): leap_left(),
    ("wuji_hand", "right"): wuji(),
    ("shadow_dexee", "right"): dexee(),
    ("orca_v2", "right"): orca(),
    **{
        (f"{name}", side): make(side)
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
