"""Runs of methods on degraded recordings, and their figures."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from jaxtyping import Float, Int

from smooth_operator.errors import ConfigError, RecordingError, SmoothOperatorError
from smooth_operator.execution import built_for
from smooth_operator.hands.hand import Hand
from smooth_operator.hands.registry import load_hand
from smooth_operator.landmarks import LANDMARKS
from smooth_operator.metrics import consistency, joints
from smooth_operator.metrics.accuracy import cosine_similarity
from smooth_operator.metrics.trace import Trace
from smooth_operator.planning import Plan
from smooth_operator.reporting.drawing import method_label
from smooth_operator.result_cache import Job
from smooth_operator.retargeting.aligned_recording import align_recording
from smooth_operator.retargeting.alignment import AlignmentConfig
from smooth_operator.synthetic.tracker import TrackerModel, TrackerStream
from smooth_operator.types import HandRecording
from smooth_operator_benchmark.cells import (
    Cell,
    Choice,
    Settings,
    benchmark_code,
    fingerprint,
    select_methods,
)
from smooth_operator_benchmark.recordings import SYNTHETIC_SECONDS, Source
from smooth_operator_research.paper.experiment import Compute, ExperimentContext, cell_job
from smooth_operator_research.paper.intervals import (
    Contrast,
    Estimate,
    Samples,
    contrast,
    mean_of,
    typical,
)

LEAD: Final = 20
"""Number of times that the first frame is shown before measuring starts, so that the motion of a
method from its neutral pose until it has settled does not count."""

FEWEST: Final = 12
"""Smallest number of frames for a meaningful jitter or lag."""


@dataclass(frozen=True, eq=False)
class DegradedRecording:
    """A recording as a degraded tracker shows it, and the true motion.

    Attributes:
        source: source of the recording.
        clean: the T true frames.
        seen: LEAD + T frames, as the tracker gave them; lost frames are not valid.
    """

    source: Source
    clean: HandRecording
    seen: HandRecording

    def __post_init__(self) -> None:
        if len(self.clean) < FEWEST:
            raise RecordingError(
                f"{self.source.name}: {len(self.clean)} frames are left for this experiment; it "
                f"needs {FEWEST}"
            )

    @property
    def digest(self) -> str:
        """Digest of what the method receives."""
        assert self.seen.valid is not None  # filled in on construction
        points = np.where(self.seen.valid[..., None], self.seen.landmarks, np.nan)
        total = hashlib.sha256(self.seen.side.encode())
        for array in (points, self.seen.stamps):
            total.update(np.ascontiguousarray(array, "<f8").tobytes())
        return total.hexdigest()


def recording_of(source: Source) -> HandRecording:
    """Reads the frames of a source."""
    if source.recording is None:
        raise RecordingError(f"{source.name}: {source.error}")
    return source.recording


def middle(recording: HandRecording, frames: int) -> HandRecording:
    """Selects a number of frames from the middle; all if there are fewer."""
    start = max(0, (len(recording) - frames) // 2)
    return recording[start : start + frames]


def through_tracker(
    source: Source, clean: HandRecording, model: TrackerModel, noise: float = 0.0
) -> DegradedRecording:
    """Simulates a tracker with losses and white noise, unlike that of real trackers.

    A lost frame stays in place without valid landmarks, as for a loop that must send a command
    anyway. The noise of a real recording remains in both the clean and the seen frames.

    Args:
        noise: standard deviation of white noise of each coordinate of every landmark [m].
    """
    tracked = led(clean)
    ticks = TrackerStream(model, clean.rate_hz).next(len(tracked))
    ticks.arrives[:LEAD] = True
    landmarks, valid, metacarpals = tracked.landmarks.copy(), tracked.valid, tracked.metacarpals
    assert valid is not None  # filled in on construction
    if noise:
        white = np.random.default_rng([model.seed, 0x7C, 1]).normal(
            0.0, noise, (len(tracked), 25, 3)
        )
        landmarks += white[:, :21]
        metacarpals = None if metacarpals is None else metacarpals + white[:, 21:]
    gone = ~ticks.arrives[:, None] | ticks.lost
    landmarks[gone] = np.nan
    return DegradedRecording(
        source,
        clean,
        replace(tracked, landmarks=landmarks, valid=valid & ~gone, metacarpals=metacarpals),
    )


def at_rate(source: Source, rate_hz: float, seconds: float) -> DegradedRecording | None:
    """Resamples a motion at another frame rate.

    The built-in operator is recorded again, so that nothing is interpolated. From other
    recordings, the frames nearest to the ticks are taken with their own timestamps.

    Args:
        rate_hz: frames per second.
        seconds: length of the part from the middle that is used.

    Returns:
        None if the recording has fewer frames per second.
    """
    recording = recording_of(source)
    begin = float(recording.stamps[0]) + max(0.0, (recording.duration - seconds) / 2)
    end = begin + min(seconds, recording.duration)
    if source.request.path is None:
        operator = replace(source.request, rate=rate_hz, tracker=None).operator()
        whole = operator.record(SYNTHETIC_SECONDS)
        inside = np.flatnonzero((whole.stamps >= begin - 1e-9) & (whole.stamps < end + 1e-9))
        clean = whole[int(inside[0]) : int(inside[-1]) + 1]
        return DegradedRecording(source, replace(clean, meta={}), led(clean))
    if recording.rate_hz < 0.95 * rate_hz:
        return None
    chosen = nearest_frames(recording.stamps, np.arange(begin, end, 1 / rate_hz))
    clean = _chosen(recording, chosen)
    return DegradedRecording(source, clean, led(clean))


def nearest_frames(
    stamps: Float[np.ndarray, " T"], ticks: Float[np.ndarray, " S"]
) -> Int[np.ndarray, " U"]:
    """Indices of the frames nearest to the ticks, each at most once."""
    after = np.searchsorted(stamps, ticks).clip(1, len(stamps) - 1)
    before_is_nearer = ticks - stamps[after - 1] < stamps[after] - ticks
    return np.unique(after - before_is_nearer)


def led(recording: HandRecording) -> HandRecording:
    """Inserts the first frame of a recording LEAD times at its beginning, at its own rate."""
    period = 1.0 / recording.rate_hz
    first = np.zeros(LEAD, int)
    led = _chosen(recording, np.concatenate([first, np.arange(len(recording))]), check=False)
    stamps = led.stamps.copy()
    stamps[:LEAD] -= period * np.arange(LEAD, 0, -1)
    return replace(led, stamps=stamps)


def _chosen(
    recording: HandRecording, at: Sequence[int] | Int[np.ndarray, " S"], check: bool = True
) -> HandRecording:
    optional: dict[str, Any] = {
        name: None if getattr(recording, name) is None else getattr(recording, name)[at]
        for name in ("valid", "metacarpals", "orientations", "T_world_wrist", "forearm")
    }
    stamps = recording.stamps[at]
    assert not check or (np.diff(stamps) > 0).all()  # frames are taken in order, and once
    return replace(recording, landmarks=recording.landmarks[at], stamps=stamps, meta={}, **optional)


LONGEST_S: Final = 0.25
"""Longest delay of the search [s]; a result near it means this delay or a longer one."""

EARLIEST_S: Final = 0.04
"""Longest lead of the robot in the search [s], so that a lag of zero is not at the edge."""

_STEP_S: Final = 0.002
_SHORTEST_S: Final = 0.2  # of overlap; less correlates by chance


def sub_frame_lag(
    human: Float[np.ndarray, "T F 3"],
    robot: Float[np.ndarray, "T F 3"],
    stamps: Float[np.ndarray, " T"],
) -> tuple[float, float]:
    """Delay that best aligns the fingertip velocities of human and robot, and its correlation.

    ``lag`` counts whole frames, refines by a parabola and gives 0 for delays under half a frame,
    which is 33 ms at 15 Hz. Here, cubic splines interpolate the commands and the human's motion,
    and their velocities are shifted against each other in steps of 2 ms, in both directions. Both
    splines smooth equally, so this adds no delay. Each command has the timestamp of its frame, so
    the lag contains neither the computing time nor the time until the next command.

    Args:
        human: (T, F, 3) human wrist to tip vectors [m], NaN where unknown.
        robot: (T, F, 3) robot wrist to tip vectors [m].
        stamps: (T,) strictly increasing times [s].

    Returns:
        The lag [ms], negative if the robot is ahead, and the Pearson correlation there; both NaN
        if there is too little motion or time.
    """
    from scipy.interpolate import CubicSpline

    finite = np.isfinite(human).all(axis=(1, 2)) & np.isfinite(robot).all(axis=(1, 2))
    nothing = float("nan"), float("nan")
    if finite.sum() < 8:
        return nothing
    at = stamps[finite]
    longest = min(LONGEST_S, (at[-1] - at[0]) / 3)
    ahead, behind = round(EARLIEST_S / _STEP_S), int(longest / _STEP_S)
    grid = np.arange(at[0], at[-1], _STEP_S)
    count = len(grid) - ahead - behind
    if count * _STEP_S < _SHORTEST_S:
        return nothing
    leader, follower = (CubicSpline(at, hand[finite])(grid, 1) for hand in (human, robot))
    velocity = leader[ahead : ahead + count]
    delays = _STEP_S * np.arange(-ahead, behind + 1)
    c = np.array([_correlation(velocity, follower[k : k + count]) for k in range(len(delays))])
    if not np.isfinite(c).all():
        return nothing
    k = int(np.argmax(c))
    delay = float(delays[k])
    if 0 < k < len(c) - 1:
        bend = c[k - 1] - 2 * c[k] + c[k + 1]
        if bend < 0:
            delay += _STEP_S * float(0.5 * (c[k - 1] - c[k + 1]) / bend)
    return 1e3 * delay, float(c[k])


def _correlation(a: Float[np.ndarray, "S F 3"], b: Float[np.ndarray, "S F 3"]) -> float:
    a, b = a - a.mean(), b - b.mean()
    size = np.sqrt((a * a).sum() * (b * b).sum())
    return float((a * b).sum() / size) if size > 1e-12 else float("nan")


PUBLISHED_SBR: Final = "sbr:paper"
"""Label of the paper's method with the paper's settings."""

BASELINES: Final = ("dexpilot", "geort", "hybrid")
"""Labels of the baselines in the paper's table, with their authors' settings (GeoRT: with our
model)."""

METHODS: Final = (PUBLISHED_SBR, *BASELINES, "sbr", "smooth", "ako", "joint_angle")
"""Methods of the paper's table as published, and ours."""

_EFFORT_MS: Final = {
    "sbr:paper": 20.0,
    "ako": 5.0,
    "dexpilot": 8.0,
    "hybrid": 8.0,
}
"""Approximate time of a frame [ms], to estimate the remaining time; 0.7 for other methods."""


@dataclass(frozen=True)
class Field:
    """The methods that can be used with a hand.

    Attributes:
        choices: label -> method.
        gaps: label -> why a method is missing.
    """

    choices: Mapping[str, Choice]
    gaps: Mapping[str, str]

    def note(self) -> str:
        """Describes the missing methods in a sentence; empty without any."""
        return "".join(f" {label} is missing: {why}." for label, why in self.gaps.items())


def field_of(context: ExperimentContext, names: Sequence[str] = METHODS) -> Field:
    """Selects the methods that can be used with the hand."""
    choices: dict[str, Choice] = {}
    gaps: dict[str, str] = {}
    hand = load_hand(context.hand, context.sources[0].side)
    for choice in select_methods(tuple(names)):
        label = method_label(choice.method, choice.preset)
        try:
            choice.config.build(hand)
            choices[label] = choice
        except SmoothOperatorError as error:
            gaps[label] = str(error)
    if not choices:
        raise ConfigError(
            f"no method can be used with hand {hand.name!r}: {next(iter(gaps.values()))}"
        )
    return Field(choices, gaps)


def effort_ms(label: str) -> float:
    """Approximate time of a frame on two cores [ms]."""
    return _EFFORT_MS.get(label, 0.7)


def follow_job(
    context: ExperimentContext,
    label: str,
    choice: Choice,
    degraded: DegradedRecording,
    seed: int = 0,
) -> Job[Compute]:
    """Job of a method on a degraded recording: ``q`` (T, n) [rad] and ``status`` (T,)."""
    source = replace(degraded.source, recording=degraded.seen, digest=degraded.digest)
    cell = Cell(source, context.hand, choice.method, choice.preset, choice.config)

    def compute(advance: Callable[[float], None]) -> dict[str, np.ndarray]:
        hand = load_hand(context.hand, degraded.seen.side)
        todo = Plan(
            recording=degraded.seen,
            hand=hand,
            method=choice.method,
            preset=choice.preset,
            config=choice.config,
        )
        retargeter, _ = built_for(todo)

        def tracked(frames: Iterable[int]) -> Iterator[int]:
            for i in frames:
                yield i
                if i % 20 == 19:
                    advance(20 / len(degraded.seen))

        commands, _ = retargeter.run(degraded.seen, seed=seed, track=tracked)
        return {"q": commands.joint_positions[LEAD:], "status": commands.status[LEAD:]}

    return cell_job(
        f"{label} on {degraded.source.name}",
        {
            "kind": f"follow-{choice.method}",
            "lead": LEAD,
            "cell": fingerprint(cell, Settings(output=Path(), seed=seed)),
        },
        300.0 + effort_ms(label) * len(degraded.seen),
        compute,
        benchmark_code(),
    )


def measure_following(
    hand: Hand,
    degraded: DegradedRecording,
    cell: Mapping[str, np.ndarray],
    alignment: AlignmentConfig,
    timing: bool = False,
) -> dict[str, float]:
    """Measures a method on a degraded recording against the true hand.

    Returns:
        ``cosine_similarity`` (thumb to tips), ``motion_preservation``, ``flatness`` [m²],
        ``jitter`` [rad], ``acceleration`` [rad/s²], ``tip_acceleration`` [m/s²], ``step`` (largest
        step of a joint in a frame) [rad], ``held`` (fraction of frames whose command repeats the
        last one); with ``timing``, which takes longer than all others, also ``lag_ms`` and
        ``correlation`` (of the velocities at that lag). Unknown values are NaN.
    """
    q = np.asarray(cell["q"], float)
    trace = Trace(
        human=align_recording(degraded.clean, hand, alignment),
        robot_tips=hand.tips(q),
        robot_wrist=hand.wrist,
        fingers=hand.fingers,
        joint_positions=q,
        joint_limits=hand.joint_limits,
        stamps=degraded.clean.stamps,
        status=cell["status"],
        latency_ms=np.full(len(q), np.nan),
    )
    thumb = trace.thumb_vectors
    figures = {
        "cosine_similarity": cosine_similarity(
            trace.human_keyvectors[:, thumb], trace.robot_keyvectors[:, thumb]
        ),
        "motion_preservation": consistency.motion_preservation(
            trace.human_reaches, trace.robot_reaches
        ),
        "flatness": consistency.flatness(trace.robot_tips),
        "tip_acceleration": consistency.fingertip_acceleration(trace.robot_tips, trace.stamps),
        "jitter": joints.joint_jitter(q),
        "acceleration": joints.joint_acceleration(q, trace.stamps),
        "step": joints.max_joint_step(q),
        "held": float(np.mean(trace.status != 0)),
    }
    if timing:
        figures["lag_ms"], figures["correlation"] = sub_frame_lag(
            trace.human_reaches, trace.robot_reaches, trace.stamps
        )
    return {name: float("nan") if value is None else value for name, value in figures.items()}


def measure_human(hand: Hand, degraded: DegradedRecording) -> dict[str, float]:
    """``flatness`` [m²] and ``tip_acceleration`` [m/s²] of the human's own fingertips, aligned: as
    they were, and as seen (``seen_flatness``, ``seen_tip_acceleration``)."""
    figures: dict[str, float] = {}
    for prefix, recording in (("", degraded.clean), ("seen_", degraded.seen[LEAD:])):
        aligned = align_recording(recording, hand, AlignmentConfig())
        tips = _tips(hand, aligned)
        for name, value in (
            ("flatness", consistency.flatness(tips)),
            ("tip_acceleration", consistency.fingertip_acceleration(tips, recording.stamps)),
        ):
            figures[prefix + name] = float("nan") if value is None else value
    return figures


def _tips(hand: Hand, aligned: Float[np.ndarray, "T 21 3"]) -> Float[np.ndarray, "T F 3"]:
    return np.asarray(aligned[:, [LANDMARKS.index(name) for name in hand.tip_names]])


_SIGNED_OR_BOUNDED: Final = (
    "cosine_similarity",
    "motion_preservation",
    "lag_ms",
    "correlation",
    "held",
)
"""Figures with an arithmetic mean; the others are positive, vary widely and have a geometric
mean."""


@dataclass(frozen=True, eq=False)
class Sweep:
    """Methods over conditions, recordings and seeds.

    Attributes:
        conditions: conditions of the experiment, in order.
        labels: names of the methods.
        measured: (label, condition, recording) -> one set of metrics for each seed.
        human: (condition, recording) -> the same metrics of the human.
        units: name of a recording -> the independent unit that it belongs to.
    """

    conditions: Sequence[Any]
    labels: Sequence[str]
    measured: Mapping[tuple[str, Any, str], list[dict[str, float]]]
    human: Mapping[tuple[Any, str], list[dict[str, float]]]
    units: Mapping[str, str]

    def mean(self, label: str, condition: Any, metric: str) -> Estimate | None:
        """Mean with an interval, geometric for metrics of smoothness; None if no recording has
        the metric."""
        return self._averaged(self.known(label, condition, metric), metric)

    def human_mean(self, condition: Any, metric: str) -> Estimate | None:
        """Mean of the human's figure."""
        return self._averaged(_known(self.human, (condition,), self.units, metric), metric)

    def known(self, label: str, condition: Any, metric: str) -> dict[str, list[float]]:
        """Maps recordings to their values by seed, without recordings that lack the metric."""
        return _known(self.measured, (label, condition), self.units, metric)

    def _averaged(self, values: Mapping[str, list[float]], metric: str) -> Estimate | None:
        if not values:
            return None
        over = mean_of if metric in _SIGNED_OR_BOUNDED else typical
        return over(self.samples(values))

    def samples(self, values: Mapping[str, Sequence[float]]) -> Samples:
        """Samples with the units of the recordings."""
        return Samples(list(values.values()), [self.units[name] for name in values])

    def against(
        self, a: str, b: str, condition: Any, metric: str, kind: Contrast = "ratio"
    ) -> Estimate | None:
        """Compares two methods by recording; None if they can't be compared."""
        return self.compared(
            self.known(a, condition, metric), self.known(b, condition, metric), kind
        )

    def compared(
        self, x: Mapping[str, list[float]], y: Mapping[str, list[float]], kind: Contrast
    ) -> Estimate | None:
        """Samples of the recordings that both have; None if they share no recording."""
        both = [name for name in x if name in y]
        if not both:
            return None
        a, b = (self.samples({name: own[name] for name in both}) for own in (x, y))
        return contrast(a, b, kind)

    def figures(self) -> list[dict[str, Any]]:
        """All numbers, for results.json."""
        return [
            {"method": label, "condition": condition, "recording": recording, "seeds": own}
            for (label, condition, recording), own in self.measured.items()
        ] + [
            {"method": "human", "condition": condition, "recording": recording, "seeds": own}
            for (condition, recording), own in self.human.items()
        ]


def run_sweep(
    context: ExperimentContext,
    name: str,
    field: Field,
    inputs: Mapping[tuple[Any, str], Sequence[DegradedRecording]],
    timing: bool = False,
) -> Sweep:
    """Runs the missing cells of a sweep.

    Args:
        inputs: (condition, recording) -> one degraded recording for each seed.
        timing: True to measure the lag, too.
    """
    # recording by recording, so that a run which is stopped has whole comparisons
    order = [
        (label, condition, recording, seed)
        for recording in dict.fromkeys(recording for _, recording in inputs)
        for label in field.choices
        for (condition, own), several in inputs.items()
        if own == recording
        for seed in range(len(several))
    ]
    jobs = [
        follow_job(
            context,
            label,
            field.choices[label],
            inputs[condition, recording][seed],
            seed,
        )
        for label, condition, recording, seed in order
    ]
    measured: dict[tuple[str, Any, str], list[dict[str, float]]] = {}
    for (label, condition, recording, seed), cell in zip(
        order, context.finish(name, jobs), strict=True
    ):
        degraded = inputs[condition, recording][seed]
        hand = load_hand(context.hand, degraded.seen.side)
        alignment = field.choices[label].config.alignment
        measured.setdefault((label, condition, recording), []).append(
            measure_following(hand, degraded, cell, alignment, timing)
        )
    human = {
        at: [
            measure_human(load_hand(context.hand, degraded.seen.side), degraded)
            for degraded in several
        ]
        for at, several in inputs.items()
    }
    return Sweep(
        list(dict.fromkeys(condition for condition, _ in inputs)),
        list(field.choices),
        measured,
        human,
        {name: context.unit_of[name] for name in dict.fromkeys(own for _, own in inputs)},
    )


def _known(
    table: Mapping[Any, list[dict[str, float]]],
    at: tuple[Any, ...],
    recordings: Iterable[str],
    metric: str,
) -> dict[str, list[float]]:
    finite = {
        name: [one[metric] for one in table.get((*at, name), []) if np.isfinite(one[metric])]
        for name in recordings
    }
    return {name: values for name, values in finite.items() if values}
