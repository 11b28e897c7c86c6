"""DexYCB: a hand that grasps one of several objects, MANO and poses for each sequence.

Source: Chao et al., *DexYCB: A Benchmark for Capturing Hand Grasping of Objects*, CVPR 2021, and
https://github.com/NVlabs/dex-ycb-toolkit. A folder of a sequence has ``meta.yml`` and ``pose.npz``;
the shape of the hand and the cameras are in ``calibration`` of the data set's folder. The clip's
world is that of the AprilTag on the table, whose z points up.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np

from smooth_hand_datasets.mano_model import load_model
from smooth_hand_datasets.scene import Scene, Thing, checked_count, nearby, rigid
from smooth_hand_datasets.unpickle import array, table
from smooth_operator import poses
from smooth_operator.errors import DocumentError, RecordingError, require
from smooth_operator.formats.arrays import open_arrays
from smooth_operator.formats.checks import stamps_from_rate
from smooth_operator.formats.clip import Clip, ClipRef, ReadingOptions
from smooth_operator.io.plain_files import read_text
from smooth_operator.types import Side, as_side

RATE_HZ: Final = 30.0
_MOST_BYTES: Final = 100_000  # of a .yml, which is read slowly
_CLASSES: Final = (
    "002_master_chef_can",
    "003_cracker_box",
    "004_sugar_box",
    "005_tomato_soup_can",
    "006_mustard_bottle",
    "007_tuna_fish_can",
    "008_pudding_box",
    "009_gelatin_box",
    "010_potted_meat_can",
    "011_banana",
    "019_pitcher_base",
    "021_bleach_cleanser",
    "024_bowl",
    "025_mug",
    "035_power_drill",
    "036_wood_block",
    "037_scissors",
    "040_large_marker",
    "051_large_clamp",
    "052_extra_large_clamp",
    "061_foam_brick",
)
"""The YCB objects in the order of their numbers, from 1."""


class DexYcb:
    """Reader of DexYCB's sequences, folders with ``SUBJECT/TIME/pose.npz``."""

    what = "a sequence of DexYCB"
    expects = (
        "meta.yml and pose.npz with pose_m (T, hands, 51) and pose_y (T, objects, 7), and "
        "calibration/ in the data set's folder"
    )

    def matches(self, path: Path) -> bool:
        """True if a path is the folder of a sequence."""
        return (path / "meta.yml").is_file() and (path / "pose.npz").is_file()

    def clips(self, path: Path) -> Iterator[ClipRef]:
        """List the sequence."""
        name = path.resolve().name
        yield ClipRef(name, path, layout="dexycb", size=(path / "pose.npz").stat().st_size)

    def read(self, ref: ClipRef, options: ReadingOptions) -> Clip:
        """Read the hands, the objects and the master camera."""
        path = ref.path / "pose.npz"
        meta = _yaml(ref.path / "meta.yml", ("mano_sides", "mano_calib", "ycb_ids", "extrinsics"))
        root = nearby(ref.path.resolve(), "calibration")
        if root is None:
            raise RecordingError(
                f"{ref.path}: the data set's folder lacks calibration/, which contains the shapes "
                "of the hands and the cameras; keep sequences in SUBJECT/TIME below that folder"
            )
        stored = open_arrays(path)
        missing = [name for name in ("pose_m", "pose_y") if name not in stored]
        if missing:
            raise RecordingError(f"{path}: it lacks {missing[0]}; it has {stored.describe()}")
        hands = array(stored["pose_m"].load(), f"{path}, 'pose_m'", (None, None, 51))
        objects = array(stored["pose_y"].load(), f"{path}, 'pose_y'", (None, None, 7))
        count = checked_count({"pose_m": len(hands), "pose_y": len(objects)}, str(path))

        sides = _texts(meta["mano_sides"], f"{ref.path}/meta.yml, mano_sides")
        shapes = _texts(meta["mano_calib"], f"{ref.path}/meta.yml, mano_calib")
        if not len(sides) == len(shapes) == hands.shape[1] or len(set(sides)) < len(sides):
            raise RecordingError(
                f"{path}: it has {hands.shape[1]} hands, but meta.yml lists the sides {sides[:4]}"
            )
        placed, shape = {}, {}
        for number, (text, betas) in enumerate(zip(sides, shapes, strict=True)):
            side: Side = as_side(text)
            hand = hands[:, number].copy()
            hand[(hand == 0.0).all(axis=1)] = np.nan  # no hand in that frame
            shape[side] = _shape(root, betas)
            model = load_model(options.mano, side)
            turns = model.rotations(hand[:, :3], hand[:, 3:48], pca=True, flat_hand_mean=False)
            placed[side] = model.place(turns, shape[side], hand[:, 48:], tips="manopth")
        cameras, master = _cameras(root, str(meta["extrinsics"])[:80])
        models = options.objects or root.parent / "models"
        things = list(_things(objects, meta["ycb_ids"], models, path))
        grasped = meta.get("ycb_grasp_ind")
        kept_meta: dict[str, Any] = {"camera": master}
        task = None
        if isinstance(grasped, int) and 0 <= grasped < len(things):
            kept_meta["grasped"] = things[grasped].name
            task = f"pick up the {_words(things[grasped].name)}"
        return Scene(
            placed,
            stamps_from_rate(count, options.rate or RATE_HZ, str(path)),
            "dexycb/apriltag",
            (path, ref.path / "meta.yml"),
            poses.invert(cameras["apriltag"]),
            shape,
            cameras[master],
            things,
            task,
            meta=kept_meta,
        ).clip(ref, "dexycb", self.expects)


def _things(objects: np.ndarray, ids: Any, models: Path, path: Path) -> Iterator[Thing]:
    complete = isinstance(ids, list) and len(ids) == objects.shape[1]
    if not complete or not all(isinstance(i, int) and 1 <= i <= len(_CLASSES) for i in ids):
        raise RecordingError(
            f"{path}: it has {objects.shape[1]} objects; ycb_ids of meta.yml must name each by a "
            f"number from 1 to {len(_CLASSES)}"
        )
    for number, identity in enumerate(ids):
        turn, at = objects[:, number, :4], objects[:, number, 4:]
        pose = np.concatenate([at, turn[:, [3, 0, 1, 2]]], axis=1)
        unknown = (objects[:, number] == [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]).all(axis=1)
        pose[unknown] = np.nan
        name = _CLASSES[identity - 1]
        yield Thing(name, pose, models / name / "textured_simple.obj")


def _shape(calibration: Path, name: str) -> np.ndarray:
    path = calibration / f"mano_{Path(name).name}" / "mano.yml"
    return array(_yaml(path, ("betas",))["betas"], f"{path}, betas", (10,), finite=True)


def _cameras(calibration: Path, name: str) -> tuple[dict[str, np.ndarray], str]:
    """Poses of the master camera and of the tag in the data set's world, and the master's name."""
    path = calibration / f"extrinsics_{Path(name).name}" / "extrinsics.yml"
    held = _yaml(path, ("extrinsics", "master"))
    extrinsics = table(held["extrinsics"], f"{path}, extrinsics", ("apriltag", held["master"]))
    cameras = {}
    for camera in ("apriltag", held["master"]):
        rows = array(extrinsics[camera], f"{path}, {str(camera)[:40]}", (12,), finite=True)
        matrix = np.vstack([rows.reshape(3, 4), [0.0, 0.0, 0.0, 1.0]])
        cameras[str(camera)] = rigid(matrix, str(path))
    return cameras, str(held["master"])


def _texts(value: Any, where: str) -> list[str]:
    if not isinstance(value, list) or not all(isinstance(item, str) for item in value):
        raise RecordingError(f"{where}: expected a list of strings, not {type(value).__name__}")
    return value


def _yaml(path: Path, needs: tuple[str, ...]) -> dict[Any, Any]:
    require("reading DexYCB", "objects", "yaml")
    import yaml

    try:
        text = read_text(path, most_bytes=_MOST_BYTES)
        loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
        value = yaml.load(text, loader)
    except (OSError, DocumentError) as error:
        raise RecordingError(f"{path}: it can't be read: {error}") from error
    except RecursionError as error:
        raise RecordingError(f"{path}: its lists and tables are nested too deeply") from error
    except (yaml.YAMLError, ValueError, TypeError, LookupError) as error:
        reason = " ".join(str(error).split())[:160]
        raise RecordingError(f"{path}: it is not YAML: {reason}") from error
    return table(value, str(path), needs)


def _words(name: str) -> str:
    return name.split("_", 1)[-1].replace("_", " ")


DEXYCB: Final = DexYcb()
