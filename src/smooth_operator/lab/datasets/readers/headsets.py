"""Clips of both hands from what headset apps record."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from smooth_operator.formats.registry import AVP, HTS, Reader
from smooth_operator.headsets.recordings import read_both_hands
from smooth_operator.lab.datasets.clip import Clip
from smooth_operator.lab.datasets.readers.both_hands import checked_hands, on_common_stamps
from smooth_operator.lab.datasets.registry import ClipRef, ReadingOptions

_HEAD_BYTES: Final = 128


@dataclass(frozen=True)
class HeadsetRecording:
    """A format of one app: one file, one clip.

    Attributes:
        layout: its name.
        what: kind of its files.
        expects: expected content of a file.
        forms: name -> how a file is recognised; the names are those of ``read_both_hands``.
    """

    layout: str
    what: str
    expects: str
    forms: dict[str, Reader]

    def matches(self, path: Path) -> bool:
        """True if a file begins as those of the app do."""
        return path.is_file() and self._form(path) is not None

    def clips(self, path: Path) -> Iterator[ClipRef]:
        """The file."""
        yield ClipRef(path.stem, path, layout=self.layout, size=path.stat().st_size)

    def read(self, ref: ClipRef, options: ReadingOptions) -> Clip:
        """Its hands on common stamps; where the app had nothing new of one, it is NaN.

        Raises:
            RecordingError: there is no hand in it; it has no stamps and there is no rate; units,
                order or side are wrong.
        """
        form = self._form(ref.path) or next(iter(self.forms))
        hands = read_both_hands(ref.path, options.rate, form)
        where = str(ref.path)
        checked = checked_hands(on_common_stamps(hands, where), where, self.expects)
        return Clip(ref.name, checked, self.layout, (ref.path,), meta={"form": form})

    def _form(self, path: Path) -> str | None:
        suffixes = {suffix for reader in self.forms.values() for suffix in reader.suffixes}
        if path.suffix.lower() not in suffixes:
            return None
        with path.open("rb") as stream:
            head = stream.read(_HEAD_BYTES)
        forms = (name for name, reader in self.forms.items() if reader.recognises(path, head))
        return next(forms, None)


AVP_RECORDING: Final = HeadsetRecording(
    "avp",
    AVP.what,
    "lines of JSON with 'timestamp', 'leftHand' and 'rightHand', the hands with 'wrist' and 24 "
    "joints of 16 numbers each",
    {"avp": AVP},
)
HTS_RECORDING: Final = HeadsetRecording(
    "hts",
    HTS.what,
    "lines 'Right wrist:, ...' and 'Right landmarks:, ...', or the same of 'Left'",
    {"hts": HTS},
)
