"""MJCF texts of small hands whose last joints follow by polynomials or by bars."""

_FINGERS = {"index": 0.03, "middle": 0.009, "ring": -0.012, "pinky": -0.033}
_THUMB = """
  <body name="thumb_1" pos="0.04 -0.01 0.03"><joint name="thumb_cmc" axis="0 0 1" range="-0.2 1.6"/>
    <geom type="capsule" fromto="0 0 0 0.03 0 0.02" size="0.006" mass="0.01"/>
    <body name="thumb_2" pos="0.03 0 0.02"><joint name="thumb_mcp" axis="0 1 0" range="-1.2 0.6"/>
      <geom type="capsule" fromto="0 0 0 0.02 0 0.04" size="0.006" mass="0.01"/>
      <site name="thumb_tip" pos="0.022 0 0.045"/></body></body>"""
_FINGER = """
  <body name="{name}_proximal" pos="{x} 0 0.09"><joint name="{name}_mcp" axis="1 0 0" {mcp}/>
    <geom type="capsule" fromto="0 0 0 0 0 0.04" size="0.006" mass="0.01"/>
    <site name="{name}_horn" pos="0 0.024 0.031"/>
    <body name="{name}_distal" pos="0 0 0.04"><joint name="{name}_pip" axis="1 0 0" {pip}/>
      <geom type="capsule" fromto="0 0 0 0 0 0.03" size="0.005" mass="0.01"/>
      <site name="{name}_tip" pos="0 0 0.035"/></body></body>"""
_CRANK = """
  <body name="{name}_crank" pos="{x} 0.012 0.085">
    <joint name="{name}_motor" axis="1 0 0" range="-0.2 1.5"/>
    <geom type="capsule" fromto="0 0 0 0 0.012 0.006" size="0.002" mass="0.001"/>
    <body name="{name}_rod" pos="0 0.012 0.006"><joint name="{name}_rod" axis="1 0 0"/>
      <geom type="capsule" fromto="0 0 0 0 0 0.03" size="0.002" mass="0.001"/>
      <site name="{name}_rod_end" pos="0 0 0.03"/></body></body>"""


def polynomial_hand(polycoef: str = "0 0.75 0.2 0 0") -> str:
    """A thumb and four fingers; the PIP joints follow the MCP joints by a polynomial."""
    return _hand(
        "".join(
            _FINGER.format(name=name, x=x, mcp='range="0 1.5"', pip='range="-0.1 1.7"')
            for name, x in _FINGERS.items()
        ),
        "".join(
            f'<joint joint1="{name}_pip" joint2="{name}_mcp" polycoef="{polycoef}"/>'
            for name in _FINGERS
        ),
        [f"{name}_mcp" for name in _FINGERS],
    )


def crank_hand(leads: str = "mcp") -> str:
    """A thumb and four fingers that a motor's crank and a rod move; the rod's end is connected to
    the finger by a ``connect``, and the PIP joints follow the MCP joints, or the cranks
    (``motor``), by a line."""
    return _hand(
        "".join(
            (_CRANK + _FINGER).format(name=name, x=x, mcp="", pip="")
            for name, x in _FINGERS.items()
        ),
        "".join(
            f'<connect site1="{name}_rod_end" site2="{name}_horn"/>'
            f'<joint joint1="{name}_pip" joint2="{name}_{leads}" polycoef="0 0.9 0 0 0"/>'
            for name in _FINGERS
        ),
        [f"{name}_motor" for name in _FINGERS],
    )


def _hand(fingers: str, equalities: str, motors: list[str]) -> str:
    driven = "".join(f'<position joint="{j}"/>' for j in (*motors, "thumb_cmc", "thumb_mcp"))
    return (
        '<mujoco><compiler angle="radian"/><worldbody><body name="palm">'
        '<geom type="box" size="0.04 0.01 0.045" pos="0 0 0.045" mass="0.1"/>'
        f"{fingers}{_THUMB}</body></worldbody>"
        f"<equality>{equalities}</equality><actuator>{driven}</actuator></mujoco>"
    )


_BAR = """
  <body name="{name}_bar" pos="{x} -0.006 0.094"><joint name="{name}_bar" axis="1 0 0"/>
    <geom type="capsule" fromto="0 0 0 {end}" size="0.002" mass="0.002"/>
    <site name="{name}_bar_end" pos="{end}"/>
    <site name="{name}_bar_end_x" pos="0.02{tail}"/></body>"""


def four_bar_hand(y: float = 0.006, z: float = -0.002, most: float = 1.2) -> str:
    """A thumb and four fingers whose motors are at the MCP joints; a bar between palm and distal
    link bends the PIP joints. Two ``connect`` on a line join bar and link.

    Args:
        y: place of the pin on the distal link, behind the PIP joint [m].
        z: the same along the link [m].
        most: upper limit of the MCP joints [rad].
    """
    fingers, tail = "", f" {y + 0.006} {z + 0.036}"
    for name, x in _FINGERS.items():
        finger = _FINGER.format(name=name, x=x, mcp=f'range="-0.2 {most}"', pip="")
        pins = "".join(
            f'<site name="{name}_pin{more}" pos="{x} {y} {z}"/>'
            for more, x in (("", 0), ("_x", 0.02))
        )
        fingers += finger.replace(f'<site name="{name}_tip"', f'{pins}<site name="{name}_tip"')
        fingers += _BAR.format(name=name, x=x, end=f"0{tail}", tail=tail)
    connections = "".join(
        f'<connect site1="{name}_bar_end{more}" site2="{name}_pin{more}"/>'
        for name in _FINGERS
        for more in ("", "_x")
    )
    return _hand(fingers, connections, [f"{name}_mcp" for name in _FINGERS])


_HANGING = """
  <site name="{name}_mcp_1" pos="{x} 0 0.09"/><site name="{name}_mcp_1x" pos="{xx} 0 0.09"/>
  <body name="{name}_crank" pos="{x} 0.012 0.085">
    <joint name="{name}_motor" axis="1 0 0" range="-0.2 1.5"/>
    <geom type="capsule" fromto="0 0 0 0 0.012 0.006" size="0.002" mass="0.001"/>
    <body name="{name}_rod" pos="0 0.012 0.006"><joint name="{name}_rod" type="ball"/>
      <geom type="capsule" fromto="0 0 0 0 0 0.03" size="0.002" mass="0.001"/>
      <body name="{name}_proximal" pos="0 -0.024 -0.001">
        <joint name="{name}_ball" type="ball" pos="0 0.024 0.031"/>
        <geom type="capsule" fromto="0 0 0 0 0 0.04" size="0.006" mass="0.01"/>
        <site name="{name}_mcp_2" pos="0 0 0"/><site name="{name}_mcp_2x" pos="0.02 0 0"/>
        <body name="{name}_distal" pos="0 0 0.04">
          <joint name="{name}_pip" axis="1 0 0" range="0 1.7"/>
          <geom type="capsule" fromto="0 0 0 0 0 0.03" size="0.005" mass="0.01"/>
          <site name="{name}_tip" pos="0 0 0.035"/></body></body></body></body>"""


def rod_hand() -> str:
    """A thumb and four fingers that hang, in the file, from the rods that move them, by ball
    joints; two ``connect`` on a line are the MCP joint."""
    return _hand(
        "".join(_HANGING.format(name=n, x=x, xx=x + 0.02) for n, x in _FINGERS.items()),
        "".join(
            f'<connect site1="{name}_mcp_1{more}" site2="{name}_mcp_2{more}"/>'
            for name in _FINGERS
            for more in ("", "x")
        ),
        [f"{name}_{joint}" for name in _FINGERS for joint in ("motor", "pip")],
    )
