"""Settings on which the retargeted clips depend: fingers, operator, wrist joints."""

import sys
from dataclasses import replace

import numpy as np
import pytest
from test_calibration import KNOWN, THREE
from test_wrist_joints import recording

from smooth_hand_datasets.pipeline.request import DatasetRequest
from smooth_hand_datasets.pipeline.retargeting import Recipe, retarget_clips
from smooth_hand_datasets.pipeline.writers.lerobot_columns import RobotLayout
from smooth_hand_datasets.pipeline.writers.registry import WritingOptions
from smooth_operator import load_hand
from smooth_operator.calibration.operator_file import OperatorProfile
from smooth_operator.errors import MissingExtraError, UnknownNameError
from smooth_operator.formats.clip import Clip
from smooth_operator.planning import make_request


def test_a_folder_is_made_again_for_other_fingers_or_another_operator():
    def digest(fingers: str | None, operator: OperatorProfile | None, **more: object) -> str:
        asked = make_request(method="joint_angle", fingers=fingers, operator=operator, **more)
        return Recipe(asked).digest

    other = replace(KNOWN, pinch_gaps={"index": 0.09})
    several = {digest(THREE, KNOWN), digest(None, None), digest(THREE, None), digest(THREE, other)}
    several |= {digest(THREE, KNOWN, pinch_gaps="off"), digest("thumb,index,ring", KNOWN)}
    assert len(several) == 6
    assert digest(THREE, KNOWN) in several
    with pytest.raises(UnknownNameError, match="unknown finger 'toe'"):
        digest("thumb,toe", None)


def test_retargeting_with_objects_names_its_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "igl", None)
    install = r"needs the extra 'objects': python -m pip install .*\[objects\]"
    with pytest.raises(MissingExtraError, match=install):
        Recipe(make_request(method="smooth", preset="offline"), with_objects=True)


def test_a_data_set_has_the_wrist_joints_only_if_they_are_asked_for(tmp_path):
    hand = load_hand("shadow_hand")
    clip = Clip("take", {"right": recording(hand, np.full((10, 2), 0.1))}, "files")
    request = DatasetRequest(
        sources=("x",), output=tmp_path, hand="shadow_hand", method="joint_angle"
    )
    for choice, more in (("auto", ()), ("on", ("rh_WRJ2", "rh_WRJ1"))):
        (result,) = retarget_clips([clip], Recipe.of(replace(request, wrist_joints=choice)))
        names = RobotLayout.of(result, WritingOptions(), 100.0).layout()["action"]
        joints = [name for name in names if name.startswith("right_rh_")]
        assert len(joints) == len(hand.joint_names) + len(more)
        assert [f"right_{name}.pos" in joints for name in ("rh_WRJ2", "rh_WRJ1")] == [
            bool(more)
        ] * 2
