"""Corpora in shards: clips made on the fly, packed, resumed after kills, and run on Ray."""

from __future__ import annotations

import hashlib
import json
import os
import signal
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from smooth_operator.errors import ConfigError, OutputError
from smooth_operator.lab.datasets.readers.synthetic import SYNTHETIC, SyntheticCorpus
from smooth_operator.lab.datasets.registry import DATASETS, ReadingOptions
from smooth_operator.lab.datasets.sources import Item, each_item
from smooth_operator.lab.ray.manifest import shard_items, write_manifest
from smooth_operator.lab.ray.settings import CorpusSettings
from smooth_operator.lab.ray.shards import Journal

NEEDS_ARROW = "needs pyarrow: in the clone, pip install '.[cluster]'"
OPTIONS = ReadingOptions()
SMALL = SyntheticCorpus(clips=10, shortest=0.3, longest=1.0, people=1, lost=0.5)


@pytest.fixture
def source(tmp_path: Path) -> Path:
    path = tmp_path / "hands.synthetic.json"
    SMALL.write(path)
    return path


def items(source: Path) -> list[Item]:
    return [each for each in each_item([str(source)]) if isinstance(each, Item)]


# The list of clips, and what is done of a shard.


def test_the_list_of_clips_is_read_shard_by_shard(tmp_path: Path, source: Path) -> None:
    listed = items(source)
    remote = Item("a", None, "s3://b/a.hdf5", (3, "tag"), task="pour", side="left", rate=30.0)
    path = tmp_path / "list"
    count, digest = write_manifest(path, [*listed, remote, remote], 5)
    assert count == 12
    assert [each for shard in range(2) for each in shard_items(path, shard)] == listed
    assert shard_items(path, 2) == [remote, replace(remote, name="a~2")]
    assert write_manifest(path, [*listed, remote], 5)[1] != digest
    assert write_manifest(path, [*listed, remote, remote], 6)[1] != digest
    (path / "000001.json").write_bytes((path / "000001.json").read_bytes()[:100])
    for shard in (1, 7):
        with pytest.raises(OutputError, match="start the run again"):
            shard_items(path, shard)


def test_what_attempts_began_in_vain_is_counted(tmp_path: Path) -> None:
    for _ in range(2):
        journal = Journal(tmp_path / "0", "run")
        journal.repeated({})
        journal.begin(["bad", "good"])
    journal = Journal(tmp_path / "0", "run")
    pack: Any = object()
    assert journal.repeated({"good": pack}) == 1
    assert journal.deaths == {"bad": 2, "good": 1}
    other = Journal(tmp_path / "0", "another run")
    assert not other.deaths
    assert list((tmp_path / "0").iterdir()) == []


# The pipeline.


def packing(**more: Any) -> CorpusSettings:
    return CorpusSettings({"hand": "leap_hand"}, retarget=False, clips_per_shard=4, group=2, **more)


def digests(output: Path) -> dict[str, str]:
    return {
        path.relative_to(output).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(output.rglob("*"))
        if path.is_file() and ".corpus" not in path.parts and path.name != "summary.json"
    }


class Stop(Exception):
    pass


def test_a_stopped_run_goes_on_and_ends_in_the_same_files(tmp_path: Path, source: Path) -> None:
    from smooth_operator.lab.ray.corpus import Progress, retarget_corpus

    pytest.importorskip("pyarrow", reason=NEEDS_ARROW)
    whole = tmp_path / "whole"
    seen: list[tuple[int, int]] = []

    def note(so_far: Progress) -> None:
        seen.append((so_far.done, so_far.shards_done))

    def stop(so_far: Progress) -> None:
        raise Stop

    here: dict[str, Any] = {"cluster": None, "workers": 0}
    summary = retarget_corpus(items(source), whole, packing(), progress=note, **here)
    assert seen == [(4, 1), (8, 2), (10, 3)]
    assert {k: summary[k] for k in ("clips", "made", "failed", "episodes")} == {
        "clips": 10, "made": 10, "failed": 0, "episodes": 10,
    }  # fmt: skip
    assert len(list((whole / "data").iterdir())) == 3  # packed: a file a shard
    output = tmp_path / "stopped"
    with pytest.raises(Stop):
        retarget_corpus(items(source), output, packing(), progress=stop, **here)
    # A worker that died in the middle of the second shard has left this.
    run = json.loads((output / ".corpus" / "shards" / "000000.json").read_bytes())["run"]
    names = [item.name for item in items(source)[4:8]]
    left = Journal(output / ".corpus" / "packs" / "000001", run)
    left.failed[names[0]] = "as an attempt before found"
    left.begin(names[1:2])
    summary = retarget_corpus(items(source), output, packing(), **here)
    this = summary["this_run"]
    assert (this["computed"], this["kept_clips"]) == (5, 4)
    assert (this["recovered"], this["repeated"]) == (1, 1)
    assert summary["failed"] == 1
    (lost,) = (json.loads(line) for line in (output / "report.jsonl").read_text().splitlines())
    assert lost == {"clip": names[0], "failed": "as an attempt before found"}
    assert not list((output / ".corpus" / "packs").iterdir())
    same = [name for name, found in digests(whole).items() if digests(output).get(name) == found]
    assert [name for name in same if name.startswith("data/")] == [
        "data/part-00000-000000.parquet",
        "data/part-00002-000000.parquet",
    ]
    with pytest.raises(OutputError, match="another retarget"):
        retarget_corpus(items(source), output, replace(packing(), retarget=True), **here)
    with pytest.raises(OutputError, match="another clips"):
        retarget_corpus(items(source)[:9], output, packing(), **here)
    with pytest.raises(ConfigError, match="no clips"):
        retarget_corpus([], tmp_path / "none", packing(), **here)


def test_a_clip_that_workers_die_of_is_given_up(tmp_path: Path, source: Path) -> None:
    from smooth_operator.lab.ray.corpus import retarget_corpus

    pytest.importorskip("pyarrow", reason=NEEDS_ARROW)
    output = tmp_path / "out"

    def stop(so_far: Any) -> None:
        raise Stop

    here: dict[str, Any] = {"cluster": None, "workers": 0}
    with pytest.raises(Stop):
        retarget_corpus(items(source), output, packing(), progress=stop, **here)
    run = json.loads((output / ".corpus" / "shards" / "000000.json").read_bytes())["run"]
    bad = items(source)[5].name
    for _ in range(4):
        left = Journal(output / ".corpus" / "packs" / "000001", run)
        left.repeated({})
        left.begin([bad])
    summary = retarget_corpus(items(source), output, packing(), **here)
    assert (summary["made"], summary["failed"]) == (9, 1)
    (lost,) = (json.loads(line) for line in (output / "report.jsonl").read_text().splitlines())
    assert lost["clip"] == bad
    assert "WorkerDied: 4 times" in lost["failed"]


def test_packed_clips_are_read_as_they_were(tmp_path: Path, source: Path) -> None:
    from smooth_operator.lab.ray.corpus import retarget_corpus

    pytest.importorskip("pyarrow", reason=NEEDS_ARROW)
    output = tmp_path / "packed"
    retarget_corpus(items(source), output, packing(), cluster=None, workers=0)
    packed = [each for each in each_item([str(output / "data")]) if isinstance(each, Item)]
    assert [each.ref.layout for each in packed if each.ref] == ["parquet"] * 10
    reader = DATASETS.load("parquet")
    for before, after in zip(items(source), packed, strict=True):
        assert before.ref is not None
        assert after.ref is not None
        want, found = SYNTHETIC.read(before.ref, OPTIONS), reader.read(after.ref, OPTIONS)
        assert (found.name, found.task, found.layout) == (before.name, want.task, "synthetic")
        np.testing.assert_array_equal(found.stamps, want.stamps)
        for side, hand in want.hands.items():
            own = found.hands[side]
            np.testing.assert_array_equal(own.landmarks, hand.landmarks.astype(np.float32))
            assert own.T_world_wrist is not None
            assert hand.T_world_wrist is not None
            np.testing.assert_allclose(own.T_world_wrist, hand.T_world_wrist, atol=1e-6)
            np.testing.assert_array_equal(found.confidence[side], want.confidence[side])
        assert found.meta == want.meta


def test_episodes_of_the_pipeline_are_those_of_the_class_for_map_batches(tmp_path: Path) -> None:
    pa = pytest.importorskip("pyarrow", reason=NEEDS_ARROW)
    pq = pytest.importorskip("pyarrow.parquet")
    from smooth_operator.lab.ray.corpus import retarget_corpus
    from smooth_operator.lab.ray.retarget_clips import RetargetClips

    source = tmp_path / "x.synthetic.json"
    replace(SMALL, clips=3, shortest=0.8, lost=0.0).write(source)
    asked = {"hand": "leap_hand", "method": "joint_angle"}  # the quickest to compile
    # The first clip is shorter than the others, by its number.
    limits = {"min_seconds": 0.9, "min_reach": 0.0, "max_tip_error": 200.0, "max_collision": 1.0}
    settings = CorpusSettings(asked, limits=limits)
    summary = retarget_corpus(items(source), tmp_path / "out", settings, cluster=None, workers=0)
    (file,) = (tmp_path / "out" / "data").iterdir()
    written = pq.read_table(file)
    assert (summary["made"], summary["dropped"]) == (written.num_rows, 3 - written.num_rows)
    assert 0 < summary["dropped"] < 3

    retarget = RetargetClips(limits=limits, **asked)
    refs = [each.ref for each in items(source) if each.ref is not None]
    rows = [{"name": r.name, "path": str(r.path), "key": r.key, "layout": r.layout} for r in refs]
    rows.append({**rows[0], "key": "7"})
    table = retarget(pa.Table.from_pylist(rows))
    assert table["clip"].to_pylist()[:3] == [ref.name for ref in refs]
    kept = table.filter(table["kept"])
    assert kept["name"].to_pylist() == written["name"].to_pylist()
    for column in ("right_joints", "left_joints", "right_wrist", "figures", "stamps", "task"):
        assert kept[column].to_pylist() == written[column].to_pylist(), column
    reasons = [row["reason"] for row in table.to_pylist() if not row["kept"]]
    assert all("min_seconds" in reason for reason in reasons[:-1])
    assert "no clip '7'" in reasons[-1]
    # What Ray Data writes of it is a source again.
    pq.write_table(kept, tmp_path / "kept.parquet")
    found = [each.ref for each in items(tmp_path / "kept.parquet") if each.ref is not None]
    assert [(ref.name, ref.layout) for ref in found] == [
        (name, "parquet") for name in kept["name"].to_pylist()
    ]
    # From the arrays of a row in place of its file: the same commands, but for float32.
    again = retarget(written.select(["name", "stamps", "right_landmarks", "left_landmarks"]))
    assert again["kept"].to_pylist() == [True] * written.num_rows
    for row in range(written.num_rows):
        want, found = (np.array(t["right_joints"][row].as_py()) for t in (written, again))
        np.testing.assert_allclose(found, want, atol=1e-4)
    (reason,) = retarget(pa.table({"name": ["x"]}))["reason"].to_pylist()
    assert "a row needs 'stamps' and landmarks, or 'path' and 'layout'" in reason


# Ray.


class Fatal:
    """A reader that kills the process which first reads its fourth clip."""

    what, expects = SYNTHETIC.what, SYNTHETIC.expects
    matches, clips = SYNTHETIC.matches, SYNTHETIC.clips

    def read(self, ref: Any, options: ReadingOptions) -> Any:
        mark = ref.path.with_name("killed")
        if ref.key == "3" and not mark.exists():
            mark.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return SYNTHETIC.read(ref, options)


FATAL = Fatal()


@pytest.mark.weekly
def test_on_ray_a_killed_worker_loses_nothing(tmp_path: Path, source: Path) -> None:
    pytest.importorskip("ray.data", reason="needs ray: in the clone, pip install '.[cluster]'")
    from smooth_operator.lab.ray.corpus import retarget_corpus

    def fatal() -> Iterator[Item]:
        for item in items(source):
            assert item.ref is not None
            layout = "test_corpus:FATAL"
            yield replace(item, ref=replace(item.ref, layout=layout), layout=layout)

    output = tmp_path / "on_ray"
    summary = retarget_corpus(fatal(), output, packing(), workers=1)
    assert source.with_name("killed").exists()
    assert (summary["clips"], summary["made"]) == (10, 10)
    here = tmp_path / "here"
    retarget_corpus(fatal(), here, packing(), cluster=None, workers=0)
    data = {name: found for name, found in digests(here).items() if name.startswith("data/")}
    assert data == {k: v for k, v in digests(output).items() if k.startswith("data/")}
