"""The part of LeRobot that the robot and the teleoperator build on, for machines without LeRobot.

Where LeRobot is installed, the plug-ins get the real one.
"""

import abc
import contextlib
import enum
import importlib.metadata
import importlib.util
import os
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any, ClassVar

import pytest

PACKAGES = Path(__file__).resolve().parents[1] / "packages"
TELEOPERATOR = "lerobot_teleoperator_smooth_operator"
CAMERA = "lerobot_camera_smooth_hand"
ROBOT = "lerobot_robot_smooth_hand"
ENVIRONMENT = "lerobot_env_smooth_hand"

REAL = importlib.util.find_spec("lerobot") is not None
"""Whether LeRobot is installed."""


@contextlib.contextmanager
def plugins() -> Iterator[pytest.MonkeyPatch]:
    """Makes the plug-ins of devices importable, on LeRobot or on the stand-in."""
    with pytest.MonkeyPatch.context() as patch:
        for name in (TELEOPERATOR, CAMERA, ROBOT):
            patch.syspath_prepend(str(PACKAGES / name))
        if not REAL:
            for name, module in _modules().items():
                patch.setitem(sys.modules, name, module)
        yield patch
    if not REAL:
        for name in [n for n in sys.modules if n.startswith((TELEOPERATOR, CAMERA, ROBOT))]:
            del sys.modules[name]  # they hold the classes of a stand-in that is gone


def needs_lerobot(*distributions: str) -> list[pytest.MarkDecorator]:
    """Marks of tests that need LeRobot itself, and other distributions beside it."""
    installed = {str(each.metadata["Name"]) for each in importlib.metadata.distributions()}
    lacking = sorted({"lerobot", *distributions} - installed)
    skip = pytest.mark.skipif(bool(lacking), reason=f"not installed: {', '.join(lacking)}")
    return [pytest.mark.lerobot, skip]


def offline(folder: Path) -> dict[str, str]:
    """Variables of LeRobot's programs: no network, and a folder for what they store."""
    home = {"HF_HUB_OFFLINE": "1", "HF_HOME": str(folder / "huggingface")}
    return {**os.environ, **home, "JAX_PLATFORMS": "cpu"}


def load_dataset(root: Path) -> Any:
    """A data set as LeRobot's own class opens it."""
    os.environ["HF_HUB_OFFLINE"] = "1"
    from lerobot.datasets import LeRobotDataset

    return LeRobotDataset(f"test/{root.name}", root=root)


def with_lerobot(test: Any) -> Any:
    """Decorates a test that needs LeRobot itself."""
    for mark in needs_lerobot():
        test = mark(test)
    return test


@dataclass(kw_only=True)
class _Config:
    id: str | None = None
    calibration_dir: Path | None = None

    registered: ClassVar[dict[str, type]] = {}

    @classmethod
    def register_subclass(cls, name: str) -> Any:
        def register(subclass: type) -> type:
            cls.registered[name] = subclass
            return subclass

        return register


class _Device:
    """What LeRobot's base classes of devices do themselves."""

    def __init__(self, config: Any) -> None:
        self.id, self.calibration_dir = config.id, config.calibration_dir


def _abstract(*names: str) -> type:
    members = {name: abc.abstractmethod(lambda self: None) for name in names}
    return abc.ABCMeta("Device", (_Device,), members)


_COMMON = ("is_connected", "is_calibrated", "connect", "calibrate", "configure", "disconnect")


def _modules() -> dict[str, ModuleType]:
    class NotConnected(ConnectionError):
        pass

    class AlreadyConnected(ConnectionError):
        pass

    class TeleoperatorConfig(_Config):
        registered: ClassVar[dict[str, type]] = {}

    class RobotConfig(_Config):
        registered: ClassVar[dict[str, type]] = {}

    @dataclass(kw_only=True)
    class CameraConfig(_Config):
        fps: int | None = None
        width: int | None = None
        height: int | None = None

        registered: ClassVar[dict[str, type]] = {}

    teleoperator = _abstract(
        *_COMMON, "action_features", "feedback_features", "get_action", "send_feedback"
    )
    robot = _abstract(
        *_COMMON, "action_features", "observation_features", "get_observation", "send_action"
    )
    camera = _abstract("is_connected", "connect", "read", "async_read", "disconnect")

    class Registry:
        register = staticmethod(lambda name: lambda step: step)

    @dataclass
    class PolicyFeature:
        type: str
        shape: tuple[int, ...]

    action = {"ACTION": "ACTION"}
    contents: dict[str, dict[str, object]] = {
        "lerobot": {},
        "lerobot.configs": {},
        "lerobot.configs.types": {
            "FeatureType": SimpleNamespace(**action),
            "PipelineFeatureType": SimpleNamespace(**action),
            "PolicyFeature": PolicyFeature,
        },
        "lerobot.processor": {
            "ProcessorStepRegistry": Registry,
            "RobotActionProcessorStep": abc.ABC,
            "TransitionKey": SimpleNamespace(OBSERVATION="observation"),
        },
        "lerobot.cameras": {"CameraConfig": CameraConfig},
        "lerobot.cameras.camera": {"Camera": camera},
        "lerobot.cameras.utils": {"make_cameras_from_configs": lambda configs: {}},
        "lerobot.teleoperators": {},
        "lerobot.teleoperators.config": {"TeleoperatorConfig": TeleoperatorConfig},
        "lerobot.teleoperators.utils": {
            "TeleopEvents": enum.Enum(
                "TeleopEvents", "SUCCESS FAILURE RERECORD_EPISODE IS_INTERVENTION TERMINATE_EPISODE"
            )
        },
        "lerobot.teleoperators.teleoperator": {"Teleoperator": teleoperator},
        "lerobot.robots": {},
        "lerobot.robots.config": {"RobotConfig": RobotConfig},
        "lerobot.robots.robot": {"Robot": robot},
        "lerobot.utils": {},
        "lerobot.utils.errors": {
            "DeviceNotConnectedError": NotConnected,
            "DeviceAlreadyConnectedError": AlreadyConnected,
        },
    }
    modules = {}
    for name, content in contents.items():
        modules[name] = ModuleType(name)
        vars(modules[name]).update(content)
    return modules
