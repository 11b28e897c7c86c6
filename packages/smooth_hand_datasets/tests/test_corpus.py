"""Many clips: written in parts, resumed after kills, and run on Ray."""

import hashlib
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from two_hands import LAYOUT, PAIRS, save_pairs

from smooth_hand_datasets.pipeline import writing
from smooth_hand_datasets.pipeline.run import DatasetRequest, make_dataset
from smooth_hand_datasets.pipeline.sources import find_items
from smooth_operator.formats.clip import ReadingOptions
from smooth_operator.formats.registry import READERS
from smooth_operator.reporter import Reporter

pytestmark = pytest.mark.usefixtures("compiled_once")
CLIPS = 8


@pytest.fixture(autouse=True)
def small_parts_and_no_pages(monkeypatch) -> None:
    """No page of a report is drawn: ``test_dataset_pipeline.py`` looks at them."""
    monkeypatch.setattr(writing, "write_report", lambda *_: None)
    monkeypatch.setattr(writing, "PART_FRAMES", 40)


@pytest.fixture(scope="module")
def source(tmp_path_factory) -> Path:
    return save_pairs(tmp_path_factory.mktemp("source") / "hands", CLIPS)


def request(source: Path, output: Path, **more: Any) -> DatasetRequest:
    options: dict[str, Any] = {
        "no_limits": True,
        "format": "parquet",
        "workers": 0,
        "layout": LAYOUT,
        "hand": "mimic_p050",
        "method": "joint_angle",  # the quickest to compile
    }
    return DatasetRequest(sources=(str(source),), output=output, **options | more)


def digests(output: Path) -> dict[str, str]:
    """Name -> digest of the files of a data set, and of the lines about its episodes."""
    files = [*(output / "dataset").rglob("*"), output / "episodes.jsonl"]
    return {
        path.relative_to(output).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(files)
        if path.is_file()
    }


@pytest.mark.parametrize(
    ("format", "workers"),
    [
        ("parquet", 0),
        ("webdataset", 0),
        pytest.param("parquet", 2, marks=pytest.mark.weekly),
        pytest.param("webdataset", 2, marks=pytest.mark.weekly),
    ],
)
def test_a_large_data_set_is_written_in_parts(tmp_path, source, format, workers, monkeypatch):
    parts = make_dataset(request(source, tmp_path / "parts", format=format, workers=workers))
    written = [name for name in digests(tmp_path / "parts") if "/part-" in name]
    shards = [name for name in written if "meta" not in name]
    assert len(shards) == len({name.split("part-")[1][:5] for name in shards}) > 2
    if workers:
        make_dataset(request(source, tmp_path / "alone", format=format))
        assert digests(tmp_path / "alone") == digests(tmp_path / "parts")
    monkeypatch.setattr(writing, "PART_FRAMES", 10**6)
    whole = make_dataset(request(source, tmp_path / "whole", format=format))
    assert replace(parts, output=whole.output) == whole
    lines = [(tmp_path / name / "episodes.jsonl").read_bytes() for name in ("whole", "parts")]
    assert lines[0] == lines[1]


def test_a_run_that_is_killed_while_it_writes_is_resumed(tmp_path, source):
    class Stop(Reporter):
        @contextmanager
        def counting(self, name: str, total: int, unit: str, **_: Any) -> Iterator[Any]:
            def advance(*_: Any, **more: Any) -> None:
                if unit == "clips written":
                    raise KeyboardInterrupt

            yield advance

    make_dataset(request(source, tmp_path / "whole"))
    stopped = request(source, tmp_path / "stopped")
    with pytest.raises(KeyboardInterrupt):
        make_dataset(stopped, Stop())
    (first,) = (tmp_path / "stopped" / "dataset" / "data").iterdir()
    before = first.stat().st_mtime_ns
    make_dataset(stopped)
    assert digests(tmp_path / "stopped") == digests(tmp_path / "whole")
    assert first.stat().st_mtime_ns == before  # what is whole is not written again


def test_a_file_that_hangs_its_reader_ends_its_worker_and_is_reported(tmp_path):
    source = save_pairs(tmp_path / "hands", 1)
    options = {"layout": "hanging_clips:HANGING", "workers": 1}
    summary = make_dataset(request(source, tmp_path / "out", **options))
    ((name, reason),) = summary.failed.items()
    assert name == "00"
    assert "exit status 1" in reason


def test_human_clips_of_parquet_files_are_read_as_they_were(tmp_path, source):
    make_dataset(request(source, tmp_path))
    packed = find_items([str(tmp_path / "dataset" / "data")]).items
    assert [each.ref.layout for each in packed if each.ref] == ["parquet"] * CLIPS
    reader, options = READERS.load("parquet"), ReadingOptions()
    for before, after in zip(find_items([str(source)], layout=LAYOUT).items, packed, strict=True):
        want, found = PAIRS.read(before.ref, options), reader.read(after.ref, options)
        assert (found.name, found.task, found.layout) == (before.name, want.task, "pairs")
        np.testing.assert_array_equal(found.stamps, want.stamps)
        assert found.meta.items() >= want.meta.items()
        for side, hand in want.hands.items():
            own = found.hands[side]
            np.testing.assert_array_equal(own.landmarks, hand.landmarks.astype(np.float32))
            np.testing.assert_allclose(own.T_world_wrist, hand.T_world_wrist, atol=1e-6)
            np.testing.assert_array_equal(found.confidence[side], want.confidence[side])


@pytest.mark.weekly
def test_on_ray_a_killed_worker_loses_nothing(tmp_path, source, monkeypatch):
    pytest.importorskip("ray.data", reason="needs ray: in the clone, pip install '.[cluster]'")
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(sys.path))
    fatal = {"layout": "hanging_clips:FATAL"}
    ray = request(source, tmp_path / "on_ray", workers=1, cluster="local", **fatal)
    summary = make_dataset(ray)
    assert (source / "killed").exists()
    assert (summary.clips, summary.episodes, summary.failed) == (CLIPS, CLIPS, {})
    make_dataset(request(source, tmp_path / "here", **fatal))
    assert digests(tmp_path / "on_ray") == digests(tmp_path / "here")
