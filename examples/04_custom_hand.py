"""A hand of your own: any MJCF or URDF and a description of palm, fingers and landmarks."""

from pathlib import Path

from smooth_operator import FingerSpec, HandSpec, Point, Retargeter, SyntheticOperator, load_hand

# Three fingers of three hinges each, as MJCF. A real hand has a file from its vendor.
FINGERS = {"thumb": (0.02, 0.045, 0.03), "index": (0.0, 0.025, 0.09), "pinky": (0.0, -0.03, 0.085)}
LINK = 0.035  # m


def finger_xml(name: str, base: tuple[float, float, float]) -> str:
    tilt = "0.9 0 0.43 0" if name == "thumb" else "1 0 0 0"
    place = " ".join(map(str, base))
    xml, close = "", ""
    for i, axis in enumerate(("1 0 0", "0 1 0", "0 1 0")):
        pose = f'pos="{place}" quat="{tilt}"' if i == 0 else f'pos="0 0 {LINK if i == 2 else 0}"'
        span = "-0.5 0.5" if i == 0 else "-0.1 1.6"
        xml += f'<body name="{name}_{i}" {pose}>'
        xml += f'<joint name="{name}_{i}" axis="{axis}" range="{span}" limited="true"/>'
        xml += f'<geom type="capsule" size="0.007" fromto="0 0 0 0 0 {LINK if i else 0.001}"/>'
        close += "</body>"
    return xml + close


bodies = "".join(finger_xml(name, base) for name, base in FINGERS.items())
Path("claw.xml").write_text(
    '<mujoco><compiler angle="radian"/><worldbody><body name="palm">'
    '<geom type="box" size="0.01 0.035 0.04" pos="0 0 0.04"/>'
    f"{bodies}</body></worldbody></mujoco>"
)

spec = HandSpec(
    name="claw",
    side="right",
    model=Path("claw.xml"),
    palm="palm",
    wrist=Point("palm"),
    fingers=tuple(
        # Base, two joints, tip: the counterparts of the human finger's four landmarks.
        FingerSpec(
            name, (Point(f"{name}_0"), Point(f"{name}_2"), None, Point(f"{name}_2", (0, 0, LINK)))
        )
        for name in FINGERS
    ),
    align=("thumb", "index", "pinky"),
    neutral={f"{name}_1": 0.3 for name in FINGERS},
)
hand = load_hand(spec)
print(hand)

recording = SyntheticOperator(seed=4, rate_hz=30).record(duration=3.0)
commands, loss = Retargeter(hand).run(recording)
span = commands.joint_positions.max(axis=0) - commands.joint_positions.min(axis=0)
print(dict(zip(commands.joint_names, span.round(2).tolist(), strict=True)))
assert (span > 0.1).sum() >= 6, "the fingers should move"
