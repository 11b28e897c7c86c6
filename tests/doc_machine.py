"""What the command lines of the documentation need: recordings, a camera, real hands, modules."""

import os
import random
import re
import signal
from dataclasses import replace
from pathlib import Path
from typing import Final

import dataset_files
import numpy as np
import pytest
from discovery_hands import make_hand, urdf
from dynamixel_bank import ServoBank
from hand_rigs import RIGS, Rig, missing
from pictures import opencv_or_skip
from study_writers import due
from test_headset_recordings import avp_lines, hts_lines

from smooth_operator import SyntheticOperator
from smooth_operator.cli import main
from smooth_operator.hands.registry import hand_names
from smooth_operator.teleop.sources.webcam import picture_tracker
from smooth_operator.teleop.sources.webcam.picture_tracker import SeenHand
from smooth_operator_study.commands import run as study_run
from smooth_operator_study.design.plan_file import read_plan, write_plan_files
from smooth_operator_study.store.export import export_study
from smooth_operator_study.store.study_store import open_study

_MODULES: Final = {
    "tracker": """
from dataclasses import dataclass
from smooth_operator.teleop import ThreadedSource

@dataclass(eq=False)
class Tracker(ThreadedSource):
    port: int = 0
    label = "my tracker"

    def run(self, running):
        running.stopping.wait()
""",
    "driver": """
from dataclasses import dataclass
from smooth_operator.teleop import Sink

@dataclass(eq=False)
class MySink(Sink):
    address: str = ""
    rate: float = 0.0
    label = "my robot"

    def open(self, hands, config):
        pass

    def send(self, tick):
        pass

    def close(self):
        pass
""",
    "hands": """
from smooth_operator.hands.registry import MODELS
SPEC = MODELS / "leap_hand.right.toml"
""",
    "methods": """
from smooth_operator.retargeting.presets import PRESETS as BUILT_IN
MyConfig = BUILT_IN["joint_angle"]["default"]
PRESETS = {"quick": MyConfig}
""",
}
"""Modules of the package ``mylab``, which pages name as the reader's own."""


def write_modules(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Writes the package ``mylab``."""
    (folder / "mylab").mkdir(exist_ok=True)
    for name, text in _MODULES.items():
        (folder / "mylab" / f"{name}.py").write_text(text)
    monkeypatch.syspath_prepend(folder)


def write_inputs(folder: Path, text: str) -> None:
    """Writes the recordings, data sets and models that pages name.

    Args:
        folder: where to write.
        text: the page.
    """
    recording = SyntheticOperator(seed=3, rate_hz=30.0).record(20.0)
    stamped = {"landmarks": recording.landmarks, "timestamps": recording.stamps, "side": "right"}
    (folder / "recordings").mkdir()
    for name in ("glove", "train", "recordings/a"):
        np.savez(folder / f"{name}.npz", **stamped)
    if "sample hand.npz" not in text:
        np.savez(folder / "hand.npz", **stamped)
    judge = SyntheticOperator(seed=5, rate_hz=30.0).record(10.0)
    np.savez(folder / "judge.npz", landmarks=judge.landmarks, timestamps=judge.stamps, side="right")
    np.savez(folder / "video.npz", recording.landmarks[:300])
    np.save(folder / "video.npy", recording.landmarks[300:])
    np.save(folder / "landmarks.npy", recording.landmarks * (-1, 1, 1))
    (folder / "tracking.jsonl").write_text("\n".join(avp_lines()) + "\n")
    (folder / "hands.hts").write_bytes(b"\n".join(hts_lines(True)) + b"\n")
    (folder / "my_hand.urdf").write_text(urdf(make_hand(0, turned=False).parts))
    (folder / "REPOSITORY").mkdir()
    (folder / "REPOSITORY" / "my_hand.urdf").write_text(urdf(make_hand(0, turned=False).parts))
    if "egodex" in text:
        for place in (folder / "egodex", folder / "nfs" / "egodex"):
            place.mkdir(parents=True)
            dataset_files.egodex_file(place / "0.hdf5")
    for draft in re.findall(r"```toml\n(format = 1\nname = .*?)```", text, re.DOTALL):
        (folder / "draft.toml").write_text(draft)


def prepare(words: list[str]) -> None:
    """Makes what somebody has made before a command: a take, a profile, an added hand, a study.

    Args:
        words: the arguments of the command.
    """
    before: list[list[str]] = []
    for word in words:
        take = re.search(r"takes/(take-001[.\w]*)", word)
        if take and not (path := Path("takes") / take[1]).exists():
            path.parent.mkdir(exist_ok=True)
            sink = f"record:{path}"
            seconds = "3" if words[0] == "edit" else "1"
            before.append(["teleop", "--sink", sink, "--duration", seconds, "--no-view"])
        if word == "operator.json" and "--operator" in words and not Path(word).exists():
            before.append(["calibrate", "glove.npz", "--output", word])
    if "my_hand" in words and "add" not in words and "my_hand" not in hand_names():
        before.append(["hands", "add", "my_hand.urdf"])
    if words[:2] == ["study", "power"] and not Path("my-study").exists():
        before.append(["study", "new", "my-study", "--from", "draft.toml"])
    if words[0] == "study" and words[1] not in ("new", "power"):
        do_study(Path("my-study"))
    for command in before:
        assert main(command) == 0, command


def do_study(folder: Path) -> None:
    """Has all operators of a study do their trials; makes the study if there is none.

    Its forms are left out, which nobody is here to fill in.
    """
    if not folder.exists():
        assert main(["study", "new", str(folder), "--tasks", "A:3", "pivot:3"]) == 0
    plan = None
    if not (folder / "study.db").exists():
        plan = read_plan(folder / "study.toml")
        plan = replace(plan, protocol=replace(plan.protocol, forms=()))
        write_plan_files(plan, folder)
    with open_study(folder, plan) as store:
        for code in store.plan.codes:
            draw = random.Random(code)
            while (event := due(store.progress(code), draw)) is not None:
                store.append(code, event)
        export_study(store, Path())


class Landmarker:
    """Sees the built-in operator's hand in every picture, in place of MediaPipe."""

    def __init__(self, *_: object, **__: object) -> None:
        self._recording = SyntheticOperator(seed=3, rate_hz=30.0).record(2.0)
        self._count = 0

    def find(self, picture: np.ndarray, time: float) -> list[SeenHand]:
        points = self._recording.landmarks[self._count % len(self._recording)]
        self._count += 1
        return [SeenHand("right", 0.9, points, points + 0.5, np.ones(21, bool))]

    def close(self) -> None:
        pass


class Camera:
    """A camera that gives black pictures, in place of ``cv2.VideoCapture``."""

    def __init__(self, name: object) -> None:
        self.name = name

    def isOpened(self) -> bool:
        return True

    def set(self, *_: object) -> None:
        pass

    def read(self) -> tuple[bool, np.ndarray]:
        return True, np.zeros((64, 96, 3), np.uint8)

    def release(self) -> None:
        pass


def show_hand_to_camera(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Puts a camera, a video and a tracker in place that see the built-in operator."""
    cv2 = opencv_or_skip()
    writer = cv2.VideoWriter(
        str(folder / "clip.mp4"), cv2.VideoWriter_fourcc(*"mp4v"), 30.0, (96, 64)
    )
    for level in range(60):
        writer.write(np.full((64, 96, 3), level, np.uint8))
    writer.release()
    video = cv2.VideoCapture
    monkeypatch.setattr(
        cv2, "VideoCapture", lambda name: (video if str(name).endswith("mp4") else Camera)(name)
    )
    monkeypatch.setattr(picture_tracker, "HandLandmarker", Landmarker)
    monkeypatch.setattr(picture_tracker, "hand_model", lambda given: given)


def end_study_when_served(monkeypatch: pytest.MonkeyPatch) -> None:
    """Sends Ctrl-C to ``study run`` once it serves its pages."""
    told = study_run.print_note

    def telling(note: str) -> None:
        told(note)
        if note.startswith("Ctrl-C ends"):
            os.kill(os.getpid(), signal.SIGINT)

    monkeypatch.setattr(study_run, "print_note", telling)


_SERVOS: Final = {"leap": range(16), "dynamixel": range(1, 13)}
_RIGS: Final = {
    "ability": "ability",
    "allegro": "allegro-v5",
    "inspire": "inspire",
    "linker": "linker-l20",
    "revo2": "revo2",
    "wuji": "wuji",
}


class Devices:
    """Simulators of real hands, started when a command line names them."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self._folder, self._monkeypatch = folder, monkeypatch
        self._banks: dict[str, ServoBank] = {}
        self._rigs: dict[str, Rig] = {}

    def put(self, word: str) -> str:
        """A sink with the port of its simulator; other words as they are."""
        match = re.fullmatch(r"(\w+)(?::([^,=]*(?:,|$))?(.*))?", word)
        if match is None or match[1] not in (*_SERVOS, *_RIGS):
            return word
        port, settings = self._port(match[1]), match[3] or ""
        names = {setting.partition("=")[0] for setting in settings.split(",")}
        given = [s for s in port.split(",")[1:] if s.partition("=")[0] not in names]
        return ",".join([port.split(",")[0], *given, *filter(None, [settings])])

    def _port(self, driver: str) -> str:
        if driver in _SERVOS:
            if driver not in self._banks:
                self._banks[driver] = ServoBank(list(_SERVOS[driver]))
            return f"{driver}:{self._banks[driver].path}"
        name = _RIGS[driver]
        if reason := missing(name):
            pytest.skip(reason)
        if driver not in self._rigs:
            self._rigs[driver] = RIGS[name](self._folder, self._monkeypatch)
        return self._rigs[driver].sink

    def close(self) -> None:
        """Ends the simulators."""
        for bank in self._banks.values():
            bank.unplug()
        for rig in self._rigs.values():
            rig.close()
