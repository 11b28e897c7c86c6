"""WebDataset: tar files of samples, one a clip, ``KEY.json`` and ``KEY.npz`` next to each other.

The arrays are those of ``smooth_operator.lab.datasets.writers.arrays``. The headers hold no time,
no owner and no number of a process, so the same clips give the same bytes.
"""

from __future__ import annotations

import io
import tarfile
from pathlib import Path
from typing import IO, Any, Final

import numpy as np

from smooth_operator.formats.jsonable import to_json
from smooth_operator.lab.datasets.clip import RobotClip
from smooth_operator.lab.datasets.writers.arrays import (
    LOST,
    clip_arrays,
    clip_document,
    resampled,
    unique_slug,
)
from smooth_operator.lab.datasets.writers.registry import WritingOptions
from smooth_operator.lab.datasets.writers.shards import (
    ShardedWriter,
    close_quietly,
    hidden,
    publish,
    remove,
)


class TarShards(ShardedWriter):
    """Shards that are tar files with deterministic headers."""

    folder = "shards"

    def path(self, number: int) -> Path:
        """Path of a shard."""
        return self.output / self.folder / f"{self.shard_name(number)}.tar"

    def _begin(self, number: int) -> None:
        path = self.path(number)
        path.parent.mkdir(exist_ok=True)
        self._file: IO[bytes] = hidden(path).open("wb")
        self._tar = tarfile.TarFile(fileobj=self._file, mode="w", format=tarfile.PAX_FORMAT)

    def add_file(self, name: str, content: bytes) -> None:
        """Adds a member to the shard that is open."""
        header = tarfile.TarInfo(name)
        header.size, header.mode = len(content), 0o644
        self._tar.addfile(header, io.BytesIO(content))

    def _size(self) -> int:
        return self._file.tell()

    def _end(self, number: int) -> dict[str, Any]:
        path = self.path(number)
        self._tar.close()
        self._file.close()
        publish(path)
        return {"shard": path.relative_to(self.output).as_posix()}

    def _drop(self) -> None:
        close_quietly(self._file)
        remove(hidden(self.path(self._number)))

    def _clean(self, number: int) -> None:
        remove(self.path(number))


def npz_bytes(arrays: dict[str, np.ndarray]) -> bytes:
    """A NumPy archive, not packed; the same bytes for the same arrays."""
    content = io.BytesIO()
    np.savez(content, allow_pickle=False, **arrays)
    return content.getvalue()


class _Writer(TarShards):
    def _add(self, clip: RobotClip, entry: dict[str, Any]) -> None:
        if self.options.rate is not None:
            clip = resampled(clip, self.options.rate)
        key = unique_slug(clip.clip.name, entry["key"])
        document = clip_document(clip, entry["key"], self.configuration(clip))
        self.add_file(f"{key}.json", to_json(document).encode())
        self.add_file(f"{key}.npz", npz_bytes(clip_arrays(clip)))
        entry["sample"] = key
        entry["frames"] = len(clip.clip)


class _WebDataset:
    what = "WebDataset tar shards"
    parallel = True
    loses = LOST

    def open(self, output: Path, options: WritingOptions) -> _Writer:
        return _Writer(output, options, "webdataset", 256.0, {"rate": options.rate})


WEBDATASET: Final = _WebDataset()
