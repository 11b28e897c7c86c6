"""Many clips: written in parts, resumed after kills, and run on Ray."""

import hashlib
import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import made_clips
import numpy as np
import pytest
from made_clips import CLIPS, LAYOUT

from smooth_operator.datasets import pipeline, writing
from smooth_operator.datasets.pipeline import DatasetRequest, make_dataset
from smooth_operator.datasets.sources import Item, find_items
from smooth_operator.formats.clip import ClipRef, ReadingOptions
from smooth_operator.formats.registry import READERS
from smooth_operator.reporter import Reporter

NEEDS_ARROW = "needs pyarrow: in the clone, pip install '.[cluster]'"
OPTIONS = ReadingOptions()


@pytest.fixture(autouse=True)
def no_pages(monkeypatch) -> None:
    """No page of a report is drawn: ``test_dataset_pipeline.py`` looks at them."""
    monkeypatch.setattr(writing, "write_report", lambda *_: None)


@pytest.fixture
def source(tmp_path) -> Path:
    return made_clips.write(tmp_path / "hands.made.json", 10, (0.3, 1.0), lost=0.5)


def items(source: Path, layout: str | None = LAYOUT) -> list[Item]:
    return [*find_items([str(source)], layout=layout).items]


def request(source: Path, output: Path, **more: Any) -> DatasetRequest:
    options: dict[str, Any] = {
        "no_limits": True,
        "format": "parquet",
        "workers": 0,
        "layout": LAYOUT,
        "hand": "leap_hand",
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
        ("parquet", (0,)),
        ("webdataset", (0,)),
        pytest.param("parquet", (0, 2), marks=pytest.mark.weekly),
        pytest.param("webdataset", (0, 2), marks=pytest.mark.weekly),
    ],
)
def test_workers_write_the_parts_of_a_large_data_set(
    tmp_path, source, format, workers, monkeypatch
):
    pytest.importorskip("pyarrow", reason=NEEDS_ARROW)
    options: dict[str, Any] = {"format": format}
    whole = make_dataset(request(source, tmp_path / "whole", **options))
    monkeypatch.setattr(writing, "PART_FRAMES", 60)
    parts = [
        make_dataset(request(source, tmp_path / f"{count}", workers=count, **options))
        for count in workers
    ]
    for summary in parts:
        assert replace(summary, output=whole.output) == whole
    last = f"{workers[-1]}"
    assert digests(tmp_path / "0") == digests(tmp_path / last)
    written = [name for name in digests(tmp_path / "0") if "/part-" in name and "meta" not in name]
    assert len(written) == len({name.split("part-")[1][:5] for name in written}) > 2
    lines = [(tmp_path / name / "episodes.jsonl").read_bytes() for name in ("whole", last)]
    assert lines[0] == lines[1]


def test_a_run_that_is_killed_while_it_writes_is_resumed(tmp_path, source, monkeypatch):
    pytest.importorskip("pyarrow", reason=NEEDS_ARROW)

    class Stop(Reporter):
        @contextmanager
        def counting(self, name: str, total: int, unit: str, **_: Any) -> Iterator[Any]:
            def advance(*_: Any, **more: Any) -> None:
                if unit == "clips written":
                    raise KeyboardInterrupt

            yield advance

    monkeypatch.setattr(writing, "PART_FRAMES", 60)
    make_dataset(request(source, tmp_path / "whole"))
    stopped = request(source, tmp_path / "stopped")
    with pytest.raises(KeyboardInterrupt):
        make_dataset(stopped, Stop())
    (first,) = (tmp_path / "stopped" / "dataset" / "data").iterdir()
    before = first.stat().st_mtime_ns
    make_dataset(stopped)
    assert digests(tmp_path / "stopped") == digests(tmp_path / "whole")
    assert first.stat().st_mtime_ns == before  # what is whole is not written again


def test_a_file_that_hangs_its_reader_ends_its_worker_and_is_reported(tmp_path, monkeypatch):
    pytest.importorskip("pyarrow", reason=NEEDS_ARROW)
    monkeypatch.setattr(pipeline, "_FEW_ITEMS", 1)  # each clip is a task
    source = made_clips.write(tmp_path / "hands.made.json", 4, (0.3, 0.5))
    options = {"layout": "hanging_clips:CLIPS", "workers": 1}
    summary = make_dataset(request(source, tmp_path / "out", **options))
    assert summary.episodes == 3
    (name, reason), *more = summary.failed.items()
    assert not more
    assert name == "made/0002"
    assert "exit status 1" in reason


def test_human_clips_of_parquet_files_are_read_as_they_were(tmp_path, source):
    pytest.importorskip("pyarrow", reason=NEEDS_ARROW)
    make_dataset(request(source, tmp_path))
    packed = items(tmp_path / "dataset" / "data", None)
    assert [each.ref.layout for each in packed if each.ref] == ["parquet"] * 10
    reader = READERS.load("parquet")
    for before, after in zip(items(source), packed, strict=True):
        want, found = CLIPS.read(before.ref, OPTIONS), reader.read(after.ref, OPTIONS)
        assert (found.name, found.task, found.layout) == (before.name, want.task, "made")
        np.testing.assert_array_equal(found.stamps, want.stamps)
        for side, hand in want.hands.items():
            own = found.hands[side]
            np.testing.assert_array_equal(own.landmarks, hand.landmarks.astype(np.float32))
            np.testing.assert_allclose(own.T_world_wrist, hand.T_world_wrist, atol=1e-6)
            np.testing.assert_array_equal(found.confidence[side], want.confidence[side])
        assert found.meta.items() >= want.meta.items()


class Fatal:
    """A reader that kills the process which first reads its fourth clip."""

    what, expects = CLIPS.what, CLIPS.expects
    matches = CLIPS.matches

    def clips(self, path: Path) -> Iterator[ClipRef]:
        return (replace(ref, layout="test_corpus:FATAL") for ref in CLIPS.clips(path))

    def read(self, ref: Any, options: ReadingOptions) -> Any:
        mark = ref.path.with_name("killed")
        if ref.key == "3" and not mark.exists():
            mark.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return CLIPS.read(ref, options)


FATAL = Fatal()


@pytest.mark.weekly
def test_on_ray_a_killed_worker_loses_nothing(tmp_path, source, monkeypatch):
    pytest.importorskip("ray.data", reason="needs ray: in the clone, pip install '.[cluster]'")
    monkeypatch.setattr(writing, "PART_FRAMES", 60)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(sys.path))
    options: dict[str, Any] = {"layout": "test_corpus:FATAL"}
    ray = request(source, tmp_path / "on_ray", workers=1, cluster="local", **options)
    summary = make_dataset(ray)
    assert source.with_name("killed").exists()
    assert (summary.clips, summary.episodes, summary.failed) == (10, 10, {})
    make_dataset(request(source, tmp_path / "here", **options))
    assert digests(tmp_path / "on_ray") == digests(tmp_path / "here")
