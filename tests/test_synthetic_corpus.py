"""The synthetic corpus: clips that are made when they are read, from a description alone."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from smooth_operator import poses
from smooth_operator.errors import ConfigError, RecordingError
from smooth_operator.lab.datasets.readers.synthetic import SYNTHETIC, SyntheticCorpus
from smooth_operator.lab.datasets.registry import DATASETS, ReadingOptions

OPTIONS = ReadingOptions()
SMALL = SyntheticCorpus(clips=10, shortest=0.3, longest=1.0, people=1, lost=0.5)


@pytest.fixture
def source(tmp_path: Path) -> Path:
    path = tmp_path / "hands.synthetic.json"
    SMALL.write(path)
    return path


def test_the_description_is_recognised(source: Path) -> None:
    reader = DATASETS.load("synthetic")
    assert reader.matches(source)
    assert not reader.matches(source.with_name("other.json"))


def test_a_synthetic_clip_is_a_function_of_its_number(source: Path) -> None:
    refs = list(SYNTHETIC.clips(source))
    assert [ref.key for ref in refs] == [str(k) for k in range(10)]
    first, again, other = (SYNTHETIC.read(ref, OPTIONS) for ref in (refs[3], refs[3], refs[4]))
    assert set(first.hands) == {"right", "left"}
    for side in ("right", "left"):
        ours, same = first.hands[side], again.hands[side]
        np.testing.assert_array_equal(ours.landmarks, same.landmarks)
        assert ours.landmarks.shape != other.hands[side].landmarks.shape or not np.array_equal(
            ours.landmarks, other.hands[side].landmarks
        )


def test_lengths_rates_and_lost_hands_of_synthetic_clips(source: Path) -> None:
    clips = [SYNTHETIC.read(ref, OPTIONS) for ref in SYNTHETIC.clips(source)]
    seconds = [len(clip) / 30.0 for clip in clips]
    assert min(seconds) >= 0.25
    assert max(seconds) <= 1.05
    assert max(seconds) > min(seconds)
    assert {round(1.0 / np.diff(clip.stamps).mean()) for clip in clips} == {30}
    lost = [np.isnan(clip.hands["right"].landmarks).any() for clip in clips]
    assert 0 < sum(lost) < len(clips)
    for clip in clips:
        for side, hand in clip.hands.items():
            unseen = np.isnan(hand.landmarks).all(axis=(1, 2))
            np.testing.assert_array_equal(clip.confidence[side] == 0.0, unseen)


def test_the_wrist_of_a_synthetic_clip_has_our_axes(source: Path) -> None:
    """x to the base of the middle finger, z out of the back of the hand, in both hands."""
    clip = replace(SMALL, lost=0.0).clip(0)
    for hand in clip.hands.values():
        wrist = hand.T_world_wrist
        assert wrist is not None
        turn = poses.rotation_matrices(wrist[:, 3:])
        to_middle = hand.landmarks[:, 9] - hand.landmarks[:, 0]
        to_middle /= np.linalg.norm(to_middle, axis=-1, keepdims=True)
        assert (np.einsum("ti,ti->t", turn[:, :, 0], to_middle) > 0.9).all()
        found = poses.wrist_from_landmarks(hand.landmarks, hand.side)
        apart = poses.separation(wrist, found)
        assert apart[:, 0].max() < 1e-9  # at the wrist landmark
        assert apart[:, 1].max() < 0.5  # the palm's own frame is made of other points


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("{", "not the description"),
        ("[]", "expected a JSON object"),
        ('{"format": "smooth-operator synthetic corpus 1", "clip": 3}', "unknown clip"),
        ('{"format": "smooth-operator synthetic corpus 1", "clips": 0}', "clips must be"),
        ('{"format": "smooth-operator synthetic corpus 1", "sides": ["up"]}', "side must be"),
        ('{"format": "smooth-operator synthetic corpus 1", "longest": 1}', "longest must be"),
        ('{"format": "smooth-operator synthetic corpus 1", "clips": "9"}', "clips"),
    ],
)
def test_descriptions_that_are_none(tmp_path: Path, content: str, said: str) -> None:
    path = tmp_path / "x.synthetic.json"
    path.write_text(content, encoding="utf-8")
    with pytest.raises(RecordingError, match=said):
        list(SYNTHETIC.clips(path))


def test_a_clip_that_is_not_in_the_corpus(source: Path) -> None:
    ref = next(SYNTHETIC.clips(source))
    with pytest.raises(RecordingError, match="no clip '10'"):
        SYNTHETIC.read(replace(ref, key="10"), OPTIONS)
    with pytest.raises(ConfigError, match=r"must end in \.synthetic\.json"):
        SMALL.write(source.with_name("x.json"))
