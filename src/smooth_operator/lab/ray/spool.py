"""What is done of a shard, on disk clip by clip, so that a worker's death costs one clip."""

from __future__ import annotations

import contextlib
import json
import os
import secrets
import struct
import zlib
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any, Final, Literal, TypeAlias

from smooth_operator.atomic_files import output_error
from smooth_operator.errors import OutputError

State: TypeAlias = Literal["made", "dropped", "failed"]

_HEADER: Final = struct.Struct("<4sIQI")  # mark, bytes of JSON, bytes of payload, their CRC-32
_MARK: Final = b"SOP1"
_MOST_TEXT: Final = 64_000_000


@dataclass(frozen=True)
class Done:
    """The result of one clip.

    Attributes:
        name: of the clip.
        state: ``made``: it gave one episode at least; ``dropped``: by filters; ``failed``.
        reasons: what was dropped, and why; or why it failed.
        frames: of the clip.
        hand_frames: frames of all its hands.
        sizes: bytes of each of its episodes.
        file: where they are, one after the other.
        offset: of the first.
    """

    name: str
    state: State
    reasons: tuple[str, ...] = ()
    frames: int = 0
    hand_frames: int = 0
    sizes: tuple[int, ...] = ()
    file: Path = field(default=Path(), compare=False)
    offset: int = field(default=0, compare=False)

    def episodes(self) -> Iterator[bytes]:
        """Their bytes, read when asked for."""
        with self.file.open("rb") as file:
            file.seek(self.offset)
            for size in self.sizes:
                yield file.read(size)


class Spool:
    """Appended records of one shard: which clips were begun, and the results of those done.

    Each attempt at a shard writes a file of its own and reads those of the attempts before it. A
    record that is cut off, as a killed process leaves it, ends its file.

    Args:
        folder: of the spools of a run.
        shard: number of the shard.
        digest: of the run; files of another one are deleted.

    Attributes:
        done: name -> result, of earlier attempts and of this one.
        begun: name -> how many attempts began it, reading included, and did not finish it.
        retargeted: those of them that were at least being retargeted, so that work was lost.
        recovered: how many results are of earlier attempts.

    Raises:
        OutputError: the file can't be written.
    """

    def __init__(self, folder: Path, shard: int, digest: str) -> None:
        self.done: dict[str, Done] = {}
        self.begun: Counter[str] = Counter()
        self.retargeted: set[str] = set()
        self._earlier: list[Path] = []
        for path in sorted(folder.glob(f"{shard:06d}.*.part")):
            self._take(path, digest)
        for name in self.done:
            del self.begun[name]
        self.retargeted -= self.done.keys()
        self.recovered = len(self.done)
        self._path = folder / f"{shard:06d}.{secrets.token_hex(4)}.part"
        try:
            self._file: IO[bytes] = self._path.open("xb")
        except OSError as error:
            raise output_error(self._path, error) from error
        self._append({"run": digest})

    def begin(self, name: str) -> None:
        """Notes that a clip is worked on, before anything can go wrong with it."""
        self._append({"begin": name})

    def retarget(self, name: str) -> None:
        """Notes that a clip is read, and the long work begins."""
        self._append({"retarget": name})

    def finish(
        self,
        name: str,
        state: State,
        reasons: Sequence[str] = (),
        frames: int = 0,
        hand_frames: int = 0,
        episodes: Sequence[bytes] = (),
    ) -> None:
        """Keeps a result."""
        fields: dict[str, Any] = {
            "name": name,
            "state": state,
            "reasons": tuple(reasons),
            "frames": frames,
            "hand_frames": hand_frames,
            "sizes": tuple(map(len, episodes)),
        }
        payload = b"".join(episodes)
        end = self._append(fields, payload)
        self.done[name] = Done(**fields, file=self._path, offset=end - len(payload))

    def close(self, *, remove: bool) -> None:
        """Closes this attempt's file.

        Args:
            remove: delete it and those of earlier attempts, since the shard is whole.
        """
        self._file.close()
        if remove:
            for path in (self._path, *self._earlier):
                with contextlib.suppress(OSError):
                    path.unlink()

    def _append(self, fields: dict[str, Any], payload: bytes = b"") -> int:
        text = json.dumps(fields).encode()
        crc = zlib.crc32(payload, zlib.crc32(text))
        header = _HEADER.pack(_MARK, len(text), len(payload), crc)
        try:
            self._file.write(header + text + payload)
            self._file.flush()  # to the system, which keeps it when this process is killed
            return self._file.tell()
        except OSError as error:
            raise output_error(self._path, error) from error

    def _take(self, path: Path, digest: str) -> None:
        """The records of an earlier attempt."""
        try:
            with path.open("rb") as file:
                records = _records(file)
                first = next(records, None)
                if first is None or first[0].get("run") != digest:
                    path.unlink()
                    return
                self._earlier.append(path)
                for fields, offset in records:
                    if "begin" in fields:
                        self.begun[fields["begin"]] += 1
                    elif "retarget" in fields:
                        self.retargeted.add(fields["retarget"])
                    else:
                        fields["reasons"] = tuple(fields["reasons"])
                        fields["sizes"] = tuple(fields["sizes"])
                        self.done[fields["name"]] = Done(**fields, file=path, offset=offset)
        except FileNotFoundError:  # another attempt has finished the shard meanwhile
            return
        except OSError as error:
            raise OutputError(f"{path}: can't be read: {error.strerror or error}") from error


def _records(file: IO[bytes]) -> Iterator[tuple[dict[str, Any], int]]:
    """(fields, offset of the payload) of the whole records from the start of a file."""
    size = os.fstat(file.fileno()).st_size
    while len(header := file.read(_HEADER.size)) == _HEADER.size:
        mark, text_bytes, payload_bytes, crc = _HEADER.unpack(header)
        at = file.tell()
        if mark != _MARK or text_bytes > _MOST_TEXT or at + text_bytes + payload_bytes > size:
            return
        text = file.read(text_bytes)
        payload = file.read(payload_bytes)
        if zlib.crc32(payload, zlib.crc32(text)) != crc:
            return
        yield json.loads(text), at + text_bytes
