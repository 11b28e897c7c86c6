"""Creates sources and sinks from strings such as ``replay:glove.npz,speed=2``.

Sources and sinks are frozen dataclasses of settings in separate modules; a registry maps names to
them.
"""

from __future__ import annotations

import dataclasses
import types
from pathlib import Path
from typing import (
    TYPE_CHECKING,
    Any,
    Final,
    Literal,
    Union,
    cast,
    get_args,
    get_origin,
    get_type_hints,
)

from smooth_operator.errors import ConfigError, UnknownNameError
from smooth_operator.extras import DEVICES
from smooth_operator.plugins import Entry, Registry
from smooth_operator.settings import LARGEST

if TYPE_CHECKING:
    from smooth_operator.teleop.sinks.feedback import Feedback
    from smooth_operator.teleop.sinks.sink import Sink
    from smooth_operator.teleop.sources.live import LiveSource
    from smooth_operator.teleop.sources.stream import Hands

_TRUE, _FALSE = ("true", "yes", "on", "1"), ("false", "no", "off", "0")


def build_component(registry: Registry, text: str) -> Any:
    """Creates the source or sink that a string such as ``replay:FILE`` describes.

    Args:
        registry: the parts by name, dataclasses whose first positional field is the argument.
        text: ``NAME``, ``NAME:ARGUMENT``, ``NAME:ARGUMENT,setting=value,...`` or
            ``NAME,setting=value,...``; the argument is the value of the class's first positional
            field, and may be omitted if that field has a default. ``package.module:Class`` may
            replace the name.

    Raises:
        UnknownNameError: there is no such name, or the class has no such setting.
        ConfigError: the class can't be imported or is not a part of this kind, a value can't be
            converted to its field's type, or a required value is missing.
    """
    kind = registry.kind
    word, rest = registry.split(text)
    if word not in registry and word not in registry.elsewhere:
        if Path(f"{word}.py").is_file():
            more = (
                f"{word}.py is in the current folder: add the name of its class, as in "
                f"{word}:CLASS."
            )
            raise UnknownNameError(kind, word, registry, more)
        if rest[:1].isupper():
            more = f"To use your own class, start in the folder that contains {word}.py."
            raise UnknownNameError(kind, word, registry, more)
    part = registry.load(word)
    if not (isinstance(part, type) and dataclasses.is_dataclass(part)):
        raise ConfigError(
            f"{registry.find(word).target} can't be a {kind}: it must be a dataclass, whose fields "
            "are the settings"
        )
    registry.check(word, part)
    component = settings_from_text(part, rest, kind, word)
    registry.check(word, component)
    return component


def settings_from_text(settings_class: type[Any], text: str, kind: str, word: str) -> Any:
    """Creates an object of a settings class from a string.

    Args:
        settings_class: a dataclass.
        text: ``ARGUMENT,setting=value,...``; see ``build_component``.
        kind: kind of part, for messages.
        word: name that the user wrote, for messages.

    Raises:
        UnknownNameError: the class has no such setting.
        ConfigError: a value can't be converted to its field's type, or a required value is missing.
    """
    hints = get_type_hints(settings_class)
    fields = {f.name: f for f in dataclasses.fields(settings_class) if f.init}
    values: dict[str, Any] = {}
    for position, part in enumerate(text.split(",") if text else ()):
        name, sign, value = part.partition("=")
        if position == 0 and not (sign and name.isidentifier()):  # an address may hold a '='
            positional = (name for name, field in fields.items() if not field.kw_only)
            name, value = next(positional, ""), part
        if name not in fields:
            raise UnknownNameError(f"setting of {kind} {word!r}:", name, fields)
        if name in values:
            raise ConfigError(f"{text!r} sets {name!r} twice")
        values[name] = _read(value, hints[name], f"{kind} {word!r}: {name}")
    needed = [
        name
        for name, field in fields.items()
        if name not in values
        and field.default is dataclasses.MISSING
        and field.default_factory is dataclasses.MISSING
    ]
    if needed:
        raise ConfigError(
            f"{kind} {word!r} needs {', '.join(needed)}: write {word}:{needed[0].upper()}"
            + "".join(f",{name}=..." for name in needed[1:])
        )
    return settings_class(**values)


def _read(text: str, hint: Any, what: str) -> Any:
    """Converts the text of a setting to its field's type."""
    options = get_args(hint) if get_origin(hint) in (Union, types.UnionType) else (hint,)
    if type(None) in options and text.lower() == "none":
        return None
    for option in options:
        if option is type(None):
            continue
        try:
            return _as(text, option)
        except ValueError:
            continue
    expected = " or ".join(_named(option) for option in options if option is not type(None))
    raise ConfigError(f"{what} must be {expected}, not {text!r}")


def _as(text: str, hint: Any) -> Any:
    if get_origin(hint) is Literal:
        for choice in get_args(hint):
            if text == str(choice):
                return choice
        raise ValueError(text)
    if hint is bool:
        if text.lower() not in (*_TRUE, *_FALSE):
            raise ValueError(text)
        return text.lower() in _TRUE
    if hint is float and not abs(float(text)) <= LARGEST:
        raise ValueError(text)
    if hint in (int, float, str, Path):
        return hint(text)
    raise ValueError(text)


def _named(hint: Any) -> str:
    if get_origin(hint) is Literal:
        return " or ".join(map(str, get_args(hint)))
    names = {
        int: "a whole number",
        float: f"a number up to {LARGEST:g}",
        bool: "true or false",
        Path: "a path",
    }
    return names.get(hint, "a text")


_SOURCES: Final = "smooth_operator.teleop.sources"

_ROS2: Final = "needs no ROS 2 installation"
_DEVICE_SOURCES: Final = {
    "angles": ("gloves that report joint angles: angles:deg, angles:rad", ""),
    "bvh": ("motion capture that sends BVH over UDP; FILE gives its skeleton: bvh:FILE", ""),
    "isaac": ("hands from any Isaac Teleop device", "isaac"),
    "oak": ("a Luxonis OAK-D depth camera, tracked by MediaPipe", "oak"),
    "openxr": ("hands from this computer's OpenXR runtime (SteamVR, Monado)", "openxr"),
    "realsense": ("a RealSense depth camera, tracked by MediaPipe", "realsense"),
    "rokoko": ("gloves or a suit, through Rokoko Studio", "rokoko"),
    "ros2": (f"hand poses from ROS 2 topics; {_ROS2}", "ros2"),
}
_DEVICE_SINKS: Final = {
    "ros2": (f"ROS 2 topics; {_ROS2}", "ros2"),
    "rerun": ("the Rerun viewer, or a file for it", "rerun"),
    "dynamixel": ("a hand of Dynamixel servos, described by a table file", "dynamixel"),
    "leap": ("the LEAP hand", "dynamixel"),
    "feetech": ("a hand of Feetech servos, described by a table file", "feetech"),
    "orca": ("the ORCA hand", "orca"),
    "inspire": ("an Inspire RH56 hand", "inspire"),
    "linker": ("a LinkerHand: O6, L6, L7, L10, L20, L21, L25, G20", "linker"),
    "allegro": ("an Allegro Hand V4 or V5", "allegro"),
    "ability": ("an Ability Hand", "ability"),
    "wuji": ("a Wuji Hand", "wuji"),
    "revo2": ("a BrainCo Revo2", "revo2"),
    "aero": ("an Aero Hand Open", "aero"),
    "dex3": ("a Unitree Dex3-1", "dex3"),
    "xhand": ("a RobotEra XHand 1", ""),
    "dexhand021": ("a DexRobot DexHand021", "dexhand021"),
    "wuji2": ("a Wuji Hand 2", "wuji2"),
    "revo3": ("a BrainCo Revo 3", "revo3"),
    "rohand": ("an OYMotion ROHand", "rohand"),
}
"""Sources and sinks of the devices distribution: name -> (summary, extra or ``""``). They are
listed here because an entry point has no summary and is known only if the distribution is
installed."""


def devices_command(extra: str = "") -> str:
    """Command that installs the devices distribution with an extra, from a clone."""
    folder = "./packages/smooth_operator_devices"
    return 'python -m pip install ".[teleop]" ' + (f'"{folder}[{extra}]"' if extra else folder)


def _summary(text: str, extra: str) -> str:
    return f"{text} ({extra} extra)" if extra else text


def _advice(extra: str) -> str:
    return (
        f"in the distribution {DEVICES}, which is not installed; in a clone of the repository, "
        f"run: {devices_command(extra)}"
    )


SOURCES: Final = Registry(
    "source",
    {
        "replay": Entry(
            f"{_SOURCES}.played:Replay", "a recording, played at its original rate: replay:FILE"
        ),
        "synthetic": Entry(
            f"{_SOURCES}.played:SyntheticSource", "a synthetic human hand; needs no tracker"
        ),
        "webcam": Entry(
            f"{_SOURCES}.webcam.webcam_source:Webcam",
            "a camera, tracked by MediaPipe (webcam extra)",
        ),
        "video": Entry(
            f"{_SOURCES}.webcam.webcam_source:Video",
            "a video file, tracked by MediaPipe: video:FILE",
        ),
        "webxr": Entry(
            f"{_SOURCES}.webxr:WebXr",
            "a headset's browser: Quest, Vision Pro, PICO (webxr extra)",
        ),
        "hts": Entry(
            f"{_SOURCES}.programs:HtsSource",
            "the Quest app Hand Tracking Streamer: hts:0.0.0.0",
        ),
        "avp": Entry(
            f"{_SOURCES}.programs:AvpSource",
            "the Vision Pro app Tracking Streamer: avp:ADDRESS (avp extra)",
        ),
        "pico": Entry(f"{_SOURCES}.programs:PicoSource", "the PICO app XRoboToolkit: pico:0.0.0.0"),
        "manus": Entry(
            f"{_SOURCES}.programs:ManusStream",
            "MANUS gloves, through a ZeroMQ bridge program (zmq extra)",
        ),
        "zmq": Entry(f"{_SOURCES}.programs:ZmqSource", "landmarks over ZeroMQ (zmq extra)"),
        "udp": Entry(f"{_SOURCES}.programs:UdpSource", "landmarks over UDP: udp:PORT"),
    },
    needs=("label", "start", "stop", "health"),
    elsewhere={name: _advice(extra) for name, (_, extra) in _DEVICE_SOURCES.items()},
    summaries={name: _summary(*part) for name, part in _DEVICE_SOURCES.items()},
)
"""Registry of sources: dataclasses of settings (``LiveSource``)."""


def build_source(text: str, hands: Hands | None = None) -> LiveSource:
    """Creates a source from a string such as ``replay:glove.npz,speed=2``.

    Args:
        text: name and settings.
        hands: hands to track. Used if the source has a setting for them and the text does not
            contain it.

    Raises:
        UnknownNameError: there is no such source or setting.
        ConfigError: a setting can't be read, the text is the name of a file, or the class can't be
            imported or is not a source.
    """
    if text.partition(":")[0] not in SOURCES:
        word = _word_for(Path(text.partition(",")[0]))
        if word is not None:
            raise ConfigError(
                f"{text!r} is a file; a source is written NAME:ARGUMENT, so write {word}:{text}"
            )
    source = build_component(SOURCES, text)
    from smooth_operator.teleop.sources.stream import Hands

    if hands is not None and get_type_hints(type(source)).get("side") == Hands:
        settings = SOURCES.split(text)[1].split(",")
        if not any(part.startswith("side=") for part in settings):
            source = dataclasses.replace(source, side=hands)
    return cast("LiveSource", source)


def _word_for(path: Path) -> str | None:
    """Name of the source that reads a file, by the file's name; None if no source reads it."""
    from smooth_operator.formats.registry import recording_suffixes
    from smooth_operator.teleop.sources.webcam.camera import is_video

    if is_video(path):
        return "video"
    return "replay" if path.suffix.lower() in recording_suffixes() else None


_SINKS: Final = "smooth_operator.teleop.sinks"

SINKS: Final = Registry(
    "sink",
    {
        "mujoco": Entry(
            f"{_SINKS}.simulation:Simulation",
            "simulated physics with position actuators, shown on the page",
        ),
        "zmq": Entry(f"{_SINKS}.zmq_sink:ZmqSink", "commands over ZeroMQ (zmq extra)"),
        "record": Entry(f"{_SINKS}.record:RecordSink", "an MCAP log: record:FILE"),
        "table": Entry(f"{_SINKS}.table:TableSink", "a table in the terminal"),
    },
    needs=("label", "open", "send", "stalled", "close", "simulation"),
    advice="derive the class from smooth_operator.teleop.Sink",
    elsewhere={name: _advice(extra) for name, (_, extra) in _DEVICE_SINKS.items()},
    summaries={name: _summary(*part) for name, part in _DEVICE_SINKS.items()},
)
"""Registry of sinks: dataclasses of settings (``Sink``)."""


FEEDBACK: Final = Registry(
    "feedback",
    {
        "zmq": Entry(
            f"{_SINKS}.feedback:ZmqFeedback", "messages for a glove over ZeroMQ (zmq extra)"
        ),
        "udp": Entry(
            f"{_SINKS}.feedback:UdpFeedback", "messages for a glove over UDP: udp:HOST:PORT"
        ),
        "webxr": Entry(
            f"{_SINKS}.feedback:WebXrFeedback", "vibration of the headset's controllers"
        ),
    },
    needs=SINKS.needs,
    advice="derive the class from smooth_operator.teleop.Sink",
    elsewhere={"isaac": _advice("isaac")},
    summaries={"isaac": _summary("vibration of Isaac Teleop's controllers or gloves", "isaac")},
)
"""Registry of outputs of feedback: dataclasses of settings (``Feedback``)."""


def build_feedback(text: str) -> Feedback:
    """Creates a feedback output from a string such as ``udp:127.0.0.1:9000,strength=0.3``; raises
    the same errors as ``build_sink``."""
    return cast("Feedback", build_component(FEEDBACK, text))


def build_sink(text: str) -> Sink:
    """Creates a sink from a string such as ``zmq:tcp://127.0.0.1:5556`` or
    ``mylab.driver:MySink,port=7``.

    Raises:
        UnknownNameError: there is no such sink or setting.
        ConfigError: a setting can't be read, or the class can't be imported or is not a sink.
    """
    return cast("Sink", build_component(SINKS, text))
