"""The list of the clips of a run, in one file from which any worker reads its part."""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from collections.abc import Iterable
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any

from smooth_operator.atomic_files import atomic_write
from smooth_operator.errors import MissingExtraError, OutputError
from smooth_operator.formats.jsonable import to_json
from smooth_operator.lab.datasets.registry import ClipRef
from smooth_operator.lab.datasets.sources import Item


def arrow() -> Any:
    """PyArrow.

    Raises:
        MissingExtraError: it is not installed.
    """
    try:
        import pyarrow
    except ImportError as error:
        raise MissingExtraError("a corpus in shards", "cluster") from error
    return pyarrow


def write_manifest(path: Path, items: Iterable[Item], per_shard: int) -> tuple[int, str]:
    """Writes the items, one record batch for each shard; holds one shard in memory.

    Args:
        path: of the file.
        items: in the order of their shards.
        per_shard: clips in a shard.

    Returns:
        how many there are, and the digest of all of them.

    Raises:
        OutputError: it can't be written.
    """
    pa = arrow()
    schema = pa.schema([("item", pa.string())])
    count, found = 0, hashlib.sha256(str(per_shard).encode())
    with atomic_write(path) as file, pa.ipc.new_file(file, schema) as writer:
        left = iter(items)
        while texts := [to_json(_absolute(item)) for item in islice(left, per_shard)]:
            writer.write_batch(pa.RecordBatch.from_arrays([pa.array(texts)], schema=schema))
            found.update("\n".join(texts).encode())
            count += len(texts)
    return count, found.hexdigest()


class Manifest:
    """The clips of a run, read shard by shard; nothing else of it is held in memory.

    Args:
        path: of the file.

    Raises:
        OutputError: there is none, or it is not whole.
    """

    def __init__(self, path: Path) -> None:
        pa = arrow()
        try:
            self._file = pa.ipc.open_file(pa.memory_map(str(path)))
        except (OSError, pa.ArrowInvalid) as error:
            raise OutputError(
                f"{path}: can't be read ({error}); start the run again, which writes it"
            ) from error

    def __len__(self) -> int:
        """Shards."""
        return int(self._file.num_record_batches)

    def items(self, shard: int) -> list[Item]:
        """Those of a shard; the second of a name has ``~2`` after it."""
        found: list[Item] = []
        taken: Counter[str] = Counter()
        for text in self._file.get_batch(shard)[0].to_pylist():
            item = _item(json.loads(text))
            taken[item.name] += 1
            again = taken[item.name]
            found.append(item if again == 1 else replace(item, name=f"{item.name}~{again}"))
        return found


def _absolute(item: Item) -> Item:
    """An item as a worker in another folder finds it."""
    ref = None if item.ref is None else replace(item.ref, path=item.ref.path.absolute())
    return replace(item, ref=ref, root=None if item.root is None else item.root.absolute())


def _item(values: dict[str, Any]) -> Item:
    ref = values["ref"]
    if ref is not None:
        ref = ClipRef(**{**ref, "path": Path(ref["path"])})
    root = None if values["root"] is None else Path(values["root"])
    return Item(**{**values, "ref": ref, "mark": tuple(values["mark"]), "root": root})
