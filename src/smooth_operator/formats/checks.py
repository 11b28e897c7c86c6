"""Checks recordings (units, timestamps and side), and selects frames by a text such as ``100:500``.

The message of each check names the likely cause and a remedy."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import replace
from typing import Final

import numpy as np
from jaxtyping import Bool, Float

from smooth_operator.errors import ConfigError, RecordingError, listed
from smooth_operator.io.anatomy import OF_A_PICTURE, PALM_RANGE_M, keeps_lengths, of_a_picture
from smooth_operator.io.landmark_order import doubt, layout_order, remedy
from smooth_operator.landmarks import TIPS, WRIST, index
from smooth_operator.settings import RATE_RANGE_HZ, check_frame_rate
from smooth_operator.types import HandRecording, Side, as_side

LONGEST_S: Final = 1e9
"""Longest time from the first to the last timestamp of a recording or of commands [s]: 32 years."""

STIFF_M: Final = 3e-3
"""Motion of the fingers up to which they count as not moving [m]; see ``finger_motion``."""

JUDGED_MOTION_S: Final = 2.0
"""Shortest recording in which the motion of the fingers is checked [s], because a pose may be
held."""

_TYPICAL_PALM_M = 0.095
_PALM_RATIO = 2.0  # of a frame's palm to the usual one, up or down: trackers stay within 1.3
_REACH = 3.0  # palm lengths from the wrist; a straight middle finger ends at 2
_FARTHEST_M = 1e7  # no tracker's world is larger, and float64 still has 2 nm there
_TYPICAL_RATE_HZ = 60.0
_LENGTH_UNITS = {
    "micrometres": 1e-6,
    "millimetres": 1e-3,
    "centimetres": 1e-2,
    "decimetres": 1e-1,
    "inches": 0.0254,
    "feet": 0.3048,
}
_TIME_UNITS = {"milliseconds": 1e-3, "microseconds": 1e-6, "nanoseconds": 1e-9, "minutes": 60.0}


def check_recording(recording: HandRecording, where: str) -> None:
    """Refuses a recording that is empty, has no valid landmarks, or has wrong timestamps or units.
    Single missing landmarks are accepted and stay flagged as invalid. The RecordingError names the
    reason and the file, ``where``."""
    if not len(recording):
        raise RecordingError(f"{where}: the recording contains no frames")
    check_stamps(recording.stamps, where, recording.landmarks)
    assert recording.valid is not None  # filled in by HandRecording
    check_units(recording.landmarks, recording.valid, where)


def check_anatomy(recording: HandRecording, where: str, *, side: Side | None) -> None:
    """Refuses a recording whose shape is that of the other hand or of another landmark order.

    The message calls it ``where`` and depends on ``asked``, the side that the caller asked for.
    """
    layout = recording.meta.get("layout")
    as_it_came = np.argsort(layout_order(layout))
    assert recording.valid is not None  # filled in by HandRecording
    points, valid = recording.landmarks[:, as_it_came], recording.valid[:, as_it_came]
    suspicion = doubt(points, recording.side, valid, layout=layout)
    if suspicion is None:
        return
    labelled = (
        suspicion.side is not None and side is None and not recording.meta.get("side_assumed")
    )
    advice = (
        f"the file says {recording.side} hand: correct the side, or mirror the points back: "
        "points * (-1, 1, 1)"
        if labelled
        else remedy(suspicion)
    )
    raise RecordingError(f"{where}: {suspicion.what}; {advice}")


def check_units(
    landmarks: Float[np.ndarray, "T 21 3"], valid: Bool[np.ndarray, "T 21"], where: str
) -> None:
    """Refuses landmarks that are not in metres, judging by the size of the palm.

    Args:
        landmarks: (T, 21, 3) positions.
        valid: (T, 21) mask of the landmarks to use.
        where: the file, for the message.

    Raises:
        RecordingError: the median distance from wrist to middle MCP is outside ``PALM_RANGE_M``
            (the message gives the likely unit and factor, or says that they are image landmarks);
            the wrist is farther than 10,000 km from the origin; or no frame has both landmarks.
    """
    if not valid.any():
        raise RecordingError(
            f"{where}: no landmark of any frame is finite; the tracker never saw the hand"
        )
    middle = index("middle_mcp")
    both = valid[:, WRIST] & valid[:, middle]
    if not both.any():
        raise RecordingError(
            f"{where}: no frame has both the wrist and the middle finger's MCP, so the units "
            "and the palm can't be determined; record again with the whole hand in view"
        )
    place = float(np.median(np.abs(landmarks[both, WRIST]).max(axis=1)))
    if place > _FARTHEST_M:
        raise RecordingError(
            f"{where}: the wrist is {place:.3g} m from the origin (median), but no tracker covers "
            f"more than {_FARTHEST_M:g} m; the numbers are damaged, or in another unit"
        )
    palm = float(
        np.median(np.linalg.norm(landmarks[both, middle] - landmarks[both, WRIST], axis=1))
    )
    low, high = PALM_RANGE_M
    if low <= palm <= high:
        return
    whole = landmarks[valid.all(axis=1)]
    if of_a_picture(whole):
        raise RecordingError(f"{where}: {OF_A_PICTURE.what}; {OF_A_PICTURE.mend}")
    hint = _length_hint(palm) if keeps_lengths(whole) else "the hand's bone lengths also change"
    raise RecordingError(
        f"{where}: the median distance from the wrist to the middle finger's MCP is {palm:.4g}, "
        f"but in metres it is {low} to {high}; {hint}"
    )


def check_palm(
    landmarks: Float[np.ndarray, "21 3"], valid: Bool[np.ndarray, "21"], where: str
) -> None:
    """Checks the units of one frame of a live stream. A hand without a visible palm is not checked.

    Raises:
        RecordingError: as ``check_units``.
    """
    if not (valid[WRIST] and valid[index("middle_mcp")]):
        return
    palm = math.dist(landmarks[WRIST].tolist(), landmarks[index("middle_mcp")].tolist())
    if not PALM_RANGE_M[0] <= palm <= PALM_RANGE_M[1]:
        check_units(landmarks[None], valid[None], where)  # it has the words


def _length_hint(palm: float) -> str:
    if palm <= 0.0:
        return "the landmarks coincide: the tracker never saw the hand"
    metres = {unit: palm * factor for unit, factor in _LENGTH_UNITS.items()}
    units = _plausible(metres, PALM_RANGE_M, _TYPICAL_PALM_M)
    if units:
        likely = " or ".join(f"{unit} (multiply by {_LENGTH_UNITS[unit]:g})" for unit in units)
        return f"it looks like {likely}"
    return (
        "no common unit fits. Landmarks in fractions of the hand's size must be scaled to the "
        f"operator's hand (for a palm of {_TYPICAL_PALM_M} m: multiply by "
        f"{_TYPICAL_PALM_M / palm:.3g}); landmarks in image coordinates can't be used; otherwise "
        "check the order of the landmarks"
    )


def without_outliers(recording: HandRecording) -> HandRecording:
    """Flags implausible frames and landmarks of a recording in metres as invalid.

    A frame is flagged if its palm is less than half or more than twice the usual length, for
    example because of another unit, or if it is farther than 10,000 km from the origin. A landmark
    is flagged if it is more than three palm lengths from the wrist. ``meta["implausible_frames"]``
    is the number of affected frames, if there are any. A wrist pose that is farther than 10,000 km
    from the origin becomes NaN.
    """
    points, valid = recording.landmarks, recording.valid
    assert valid is not None  # filled in by HandRecording
    with np.errstate(over="ignore", invalid="ignore"):
        from_wrist = np.linalg.norm(points - points[:, :1], axis=-1)
    palms = np.where(valid[:, WRIST] & valid[:, index("middle_mcp")], from_wrist[:, 9], np.nan)
    if np.isnan(palms).all():
        return recording
    usual = float(np.nanmedian(palms))
    with np.errstate(invalid="ignore"):
        frame = (palms < usual / _PALM_RATIO) | (palms > usual * _PALM_RATIO)
        frame |= np.any(valid[..., None] & (np.abs(points) > _FARTHEST_M), axis=(1, 2))
        far = valid & (from_wrist > _REACH * usual) & valid[:, :1]
    wrist = recording.T_world_wrist
    if wrist is not None:
        gone = np.any(np.abs(wrist[:, :3]) > _FARTHEST_M, axis=1, keepdims=True)
        recording = replace(recording, T_world_wrist=np.where(gone, np.nan, wrist))
    wrong = valid & (frame[:, None] | far)
    if not wrong.any():
        return recording
    meta = {**recording.meta, "implausible_frames": int(wrong.any(axis=1).sum())}
    return replace(recording, valid=valid & ~wrong, meta=meta)


def side_note(where: str) -> str:
    """Note that the side of a recording was assumed."""
    return f"{where} does not state the side; assuming right. Use --side left otherwise"


def reading_notes(recording: HandRecording, where: str) -> list[str]:
    """Notes on assumptions and corrections that were made while reading a recording; may be
    empty."""
    notes = []
    if recording.meta.get("side_assumed"):
        notes.append(side_note(where))
    damaged = recording.meta.get("damaged_lines", 0)
    if damaged:
        notes.append(f"{where}: {damaged} lines are damaged and were skipped")
    ignored = recording.meta.get("ignored")
    if ignored:
        notes.append(
            f"{where}: ignored: {listed(ignored)}; besides the landmarks, these arrays are "
            "read: valid (T,) or (T, 21), T_world_wrist (T, 7) or (T, 4, 4), metacarpals "
            "(T, 4, 3) and orientations (T, 21, 4)"
        )
    motion = finger_motion(recording)
    if motion is not None and motion < STIFF_M:
        notes.append(
            f"{where}: the fingers never move ({1e3 * motion:.1f} mm in "
            f"{recording.duration:.0f} s); check whether the glove was worn, and whether one "
            "pose was copied"
        )
    odd = recording.meta.get("implausible_frames", 0)
    if odd:
        notes.append(
            f"{where}: {odd} of {len(recording)} frames have a palm or a landmark that is "
            "too large, too small or too far away for a hand; these landmarks are treated "
            "as not seen"
        )
    return notes


def finger_motion(recording: HandRecording) -> float | None:
    """Largest change in the distances from the wrist and from the thumb's tip to the fingertips
    [m].

    It is the range from the 5th to the 95th percentile, so single frames have no effect. It is 0 if
    the arm moves the hand without moving its fingers. In recordings of people, it is at least 5 mm
    in every window of 2 s, with all trackers.

    Returns:
        the range; None for less than ``JUDGED_MOTION_S`` of frames that show the whole hand.
    """
    assert recording.valid is not None  # filled in by HandRecording
    whole = recording.valid.all(axis=1)
    stamps = recording.stamps[whole]
    if len(stamps) < 2 or stamps[-1] - stamps[0] < JUDGED_MOTION_S:
        return None
    points = recording.landmarks[whole]
    tips = points[:, list(TIPS)]
    reach = np.linalg.norm(tips - points[:, [WRIST]], axis=-1)
    pinch = np.linalg.norm(tips[:, 1:] - tips[:, :1], axis=-1)
    low, high = np.percentile(np.concatenate([reach, pinch], axis=1), (5.0, 95.0), axis=0)
    return float((high - low).max())


def check_stamps(
    stamps: Float[np.ndarray, " T"], where: str, poses: Float[np.ndarray, "T ..."] | None = None
) -> None:
    """Refuses frame timestamps that are not finite, not strictly increasing, or not in seconds.

    Args:
        stamps: (T,) stamps [s].
        where: the file, for the message.
        poses: the landmarks of each frame, for the advice if timestamps repeat.

    Raises:
        RecordingError: the message gives the file, and the first offending frame or the likely
            unit and factor.
    """
    check_times(stamps, where, "frame", poses)
    if len(stamps) < 2:
        return
    rate = 1.0 / float(np.median(np.diff(stamps)))
    low, high = RATE_RANGE_HZ
    if not low <= rate <= high:
        rates = {unit: rate / factor for unit, factor in _TIME_UNITS.items()}
        units = _plausible(rates, RATE_RANGE_HZ, _TYPICAL_RATE_HZ)
        hint = (
            f"these look like {units[0]} (multiply by {_TIME_UNITS[units[0]]:g})"
            if units
            else "no other common unit fits either; check how the timestamps were written"
        )
        raise RecordingError(
            f"{where}: according to its timestamps, the recording has {rate:.4g} frames per "
            f"second; expected {low:g} to {high:g}; timestamps must be in seconds; {hint}"
        )
    check_span(stamps, where)


def check_times(
    stamps: Float[np.ndarray, " T"],
    where: str,
    what: str,
    poses: Float[np.ndarray, "T ..."] | None = None,
) -> None:
    """Refuses timestamps that are not finite or do not increase.

    Args:
        stamps: (T,) stamps [s].
        where: the file, for the message.
        what: name of one item with a timestamp, for the message: ``frame`` or ``command``.
        poses: the values that belong to each timestamp, for the advice if timestamps repeat.

    Raises:
        RecordingError: the message gives the first offending frame or command.
    """
    finite = np.isfinite(stamps)
    if not finite.all():
        first = int(np.argmin(finite))
        raise RecordingError(
            f"{where}: the timestamp of {what} {first} is {stamps[first]} ({np.sum(~finite)} "
            f"of {len(stamps)} are not finite); every {what} needs a time in seconds"
        )
    if len(stamps) < 2:
        return
    steps = np.diff(stamps)
    if (steps < 0).any():
        i = int(np.argmax(steps < 0)) + 1
        raise RecordingError(
            f"{where}: the timestamps go backwards at {what} {i}: {float(stamps[i - 1])!r} "
            f"s, then {float(stamps[i])!r} s ({np.sum(steps < 0)} such steps). The {what}s "
            f"are shuffled, or recordings were joined: sort the {what}s by time, or split "
            "the file there"
        )
    if (steps == 0).any():
        raise RecordingError(f"{where}: {_repeats(stamps, steps == 0, what, poses)}")


def check_span(stamps: Float[np.ndarray, " T"], where: str) -> None:
    """Raises RecordingError for timestamps that span more than ``LONGEST_S``."""
    span = float(stamps[-1]) - float(stamps[0]) if len(stamps) else 0.0
    if span > LONGEST_S:
        raise RecordingError(
            f"{where}: the timestamps span {span:.3g} s, but at most {LONGEST_S:g} s (32 years) "
            "are accepted; a timestamp is damaged, or the unit is not seconds"
        )


def _repeats(
    stamps: np.ndarray, same: Bool[np.ndarray, " S"], what: str, poses: np.ndarray | None
) -> str:
    """Message on repeated timestamps with advice, which depends on whether they are times and on
    whether the values are equal."""
    i = int(np.argmax(same)) + 1
    count, steps = int(same.sum()), len(same)
    if count == steps and steps > 1:
        return (
            f"all {len(stamps)} timestamps are {float(stamps[0])!r}, so they are not times; give "
            f"the number of {what}s per second, e.g. --rate 30 (in Python: rate=30)"
        )
    repeats = "1 repeat" if count == 1 else f"{count} repeats"
    first = f"{what}s {i - 1} and {i} have the same timestamp, {float(stamps[i])!r} s ({repeats})"
    moved = np.zeros(steps, bool)
    if poses is not None:
        both = np.diff(np.asarray(poses, np.float64).reshape(len(poses), -1), axis=0)
        moved = same & (np.abs(both) > 0).any(axis=1)  # NaN: not seen, so nothing has moved
    if moved.sum() > count / 2:
        return (
            f"{first}, and the hand differs in {int(moved.sum())} of these pairs, so the "
            f"timestamps are not the times of the {what}s; save the file without timestamps "
            f"and give the number of {what}s per second, e.g. --rate 30"
        )
    return (
        f"{first}; drop the repeated {what}s: keep = numpy.diff(timestamps, prepend=-numpy.inf) > 0"
    )


def stamps_from_rate(count: int, rate: float | None, where: str) -> Float[np.ndarray, " T"]:
    """Makes evenly spaced timestamps [s] from 0, for a recording that has none.

    Raises:
        RecordingError: there is no rate and more than one frame.
        ConfigError: the rate is outside ``RATE_RANGE_HZ``.
    """
    check_frame_rate(rate)
    if rate is None and count > 1:
        raise RecordingError(
            f"{where}: the recording has {count} frames and no timestamps; give the number "
            "of frames per second, e.g. --rate 100 (in Python: rate=100)"
        )
    return np.arange(count) / (rate or 1.0)


def check_rate(stamps: Float[np.ndarray, " T"], rate: float | None, where: str) -> None:
    """Raises RecordingError if a rate differs by over a tenth from the timestamps in the file."""
    if rate is None or len(stamps) < 2:
        return
    own = 1.0 / float(np.median(np.diff(stamps)))
    if not 0.9 * own <= rate <= 1.1 * own:  # NaN too
        raise RecordingError(
            f"{where}: the file has its own timestamps, of {own:.4g} frames per second, "
            f"which contradict --rate {rate:g}; remove --rate"
        )


def check_side(labels: Iterable[str], requested: Side | None, where: str) -> tuple[Side, bool]:
    """Determines the side of a recording from the file and the caller's request.

    Args:
        labels: the side labels in the file; empty if it has none.
        where: the file, for the message.

    Returns:
        The side, and True if it was assumed: without any information, it is ``"right"``.

    Raises:
        RecordingError: for an unknown label, labels of both sides, or a side that contradicts the
            caller's.
    """
    try:
        sides = {as_side(label) for label in labels}
    except ConfigError as error:
        raise RecordingError(f"{where}: {error}") from error
    if len(sides) > 1:
        raise RecordingError(
            f"{where}: the recording mixes left and right hands; split it into one file per hand"
        )
    if not sides:
        return requested or "right", requested is None
    side = sides.pop()
    if requested is not None and requested != side:
        raise RecordingError(
            f"{where}: it is a recording of a {side} hand, but side {requested!r} was requested; "
            f"use --side {side}, or another recording"
        )
    return side, False


def _plausible(values: dict[str, float], bounds: tuple[float, float], typical: float) -> list[str]:
    """Units in which the value would be within the bounds, the most typical unit first."""
    units = [unit for unit, value in values.items() if bounds[0] <= value <= bounds[1]]
    return sorted(units, key=lambda unit: abs(math.log(values[unit] / typical)))


_RANGE = re.compile(r"\s*([+-]?\d+)?\s*:\s*([+-]?\d+)?\s*", re.ASCII)
_LONG = 10**12  # frames; longer than any recording


def frame_slice(text: str, length: int | None) -> slice:
    """Parses a range ``A:B``, which has the meaning of a Python slice.

    ``:500`` is the first 500 frames, ``2600:3100`` the frames 2600 .. 3099, ``-500:`` the last 500;
    an end beyond the recording means its end.

    Args:
        text: the range.
        length: number of frames in the recording; None to check the text before the recording is
            read.

    Returns:
        ``slice(start, stop)`` with 0 <= start < stop <= length.

    Raises:
        ConfigError: the text is not a range, or the range contains no frame.
    """
    match = _RANGE.fullmatch(text)
    if match is None:
        raise ConfigError(
            f"frames must be a range A:B of whole numbers, such as ':500', '2600:3100' or '-500:', "
            f"not {text!r}{_hint(text)}"
        )
    start, stop = (None if part is None else int(part) for part in match.groups())
    first, last, _ = slice(start, stop).indices(_LONG if length is None else length)
    if first >= last:
        reason = (
            "in A:B, B must be greater than A"
            if length is None
            else f"the recording has {length} frames, 0 to {length - 1}"
            if length
            else "the recording is empty"
        )
        raise ConfigError(f"frames {text!r} selects nothing: {reason}")
    return slice(first, last)


def _hint(text: str) -> str:
    if re.fullmatch(r"\s*\d+\s*", text, re.ASCII):
        number = int(text)
        return f"; to select only frame {number}, write '{number}:{number + 1}'"
    if text.count(":") > 1:
        return "; a step is not supported"
    return ""
