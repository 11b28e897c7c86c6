"""The list of the clips of a run: a file for each shard, which any worker reads."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Iterable
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any, Final

from smooth_operator.atomic_files import atomic_write, output_error
from smooth_operator.errors import DocumentError, OutputError
from smooth_operator.formats.jsonable import to_json
from smooth_operator.io.documents import read_json
from smooth_operator.lab.datasets.registry import ClipRef
from smooth_operator.lab.datasets.sources import Item

_MOST_BYTES: Final = 1_000_000_000


def write_manifest(folder: Path, items: Iterable[Item], per_shard: int) -> tuple[int, str]:
    """Writes the items, one file for each shard; holds one shard in memory.

    Args:
        folder: folder of the files; made if need be.
        items: clips in the order of their shards.
        per_shard: clips in a shard.

    Returns:
        number of clips, and the digest of all of them.

    Raises:
        OutputError: a file can't be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise output_error(folder, error) from error
    count, shard, digest = 0, 0, hashlib.sha256(str(per_shard).encode())
    left = iter(items)
    while texts := [to_json(_absolute(item)) for item in islice(left, per_shard)]:
        with atomic_write(folder / f"{shard:06d}.json") as file:
            file.write(f"[{', '.join(texts)}]".encode())
        digest.update("\n".join(texts).encode())
        count, shard = count + len(texts), shard + 1
    return count, digest.hexdigest()


def shard_items(folder: Path, shard: int) -> list[Item]:
    """Clips of a shard; the second of a name has ``~2`` after it.

    Raises:
        OutputError: the list can't be read.
    """
    path = folder / f"{shard:06d}.json"
    try:
        items = [_item(values) for values in read_json(path, most_bytes=_MOST_BYTES)]
    except (OSError, DocumentError, KeyError, TypeError) as error:
        raise OutputError(
            f"{path}: can't be read ({error}); start the run again, which writes it"
        ) from error
    counts: Counter[str] = Counter()
    for position, item in enumerate(items):
        counts[item.name] += 1
        if counts[item.name] > 1:
            items[position] = replace(item, name=f"{item.name}~{counts[item.name]}")
    return items


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
