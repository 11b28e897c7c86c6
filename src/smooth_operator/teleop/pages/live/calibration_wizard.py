"""A calibration on the page: prompts while frames come, then the estimate and what it is for."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import Any

from smooth_operator.calibration.estimate import calibrate
from smooth_operator.calibration.operator_file import read_operator, write_operator
from smooth_operator.calibration.prompts import prompts
from smooth_operator.calibration.report import report
from smooth_operator.errors import ConfigError, SmoothOperatorError
from smooth_operator.hands.hand import Hand
from smooth_operator.human.operator import OperatorProfile
from smooth_operator.teleop.runtime.calibration_session import CalibrationSession
from smooth_operator.teleop.sources.live import Arrival


class CalibrationWizard:
    """Calibrates the operator of one hand at a time.

    Attributes:
        operator: what the last calibration found; None before one is done.
        hand: for which robot hand.
    """

    def __init__(self) -> None:
        self.operator: OperatorProfile | None = None
        self.hand: Hand | None = None
        self._session: CalibrationSession | None = None
        self._estimating = False
        self._figures: dict[str, Any] = {}
        self._error = ""

    def begin(self, hand: Hand) -> None:
        """Start with the first prompt; what ran before is forgotten."""
        self.operator, self.hand, self._figures, self._error = None, hand, {}, ""
        self._session = CalibrationSession(hand.spec.side, prompts(hand.fingers))

    def cancel(self) -> None:
        """Forget it."""
        self._session, self._error = None, ""

    def see(self, arrival: Arrival) -> None:
        """A frame has come; called on the loop's thread, and quick."""
        session = self._session
        if session is not None:
            session.see(arrival)

    def look(self, now: float) -> dict[str, Any]:
        """What to show, as JSON has it.

        Args:
            now: by the clock of the arrivals [s].
        """
        shown: dict[str, Any] = {"error": self._error, "figures": self._figures}
        session = self._session
        if session is None:
            return {**shown, "phase": "estimate" if self._estimating else "idle"}
        moment = session.at(now)
        if moment is None:
            self._session, self._estimating = None, True
            threading.Thread(
                target=self._estimate, args=(session, self.hand), name="calibration", daemon=True
            ).start()
            return {**shown, "phase": "estimate"}
        return {
            **shown,
            "phase": moment.phase,
            "text": moment.prompt.text,
            "number": moment.number + 1,
            "count": len(session.prompts),
            "done": round(moment.done, 4),
            "left_s": round(moment.left_s, 1),
            "side": session.side,
        }

    def save(self, folder: Path) -> Path:
        """Write what was found, for ``--operator``.

        Raises:
            ConfigError: nothing was found yet, or another file has the name.
            OutputError: it can't be written.
        """
        if self.operator is None:
            raise ConfigError("there is no finished calibration; calibrate first")
        path = folder / f"operator-{self.operator.hand}-{self.operator.side}.json"
        if path.exists():
            read_operator(path)  # an older calibration may be replaced, nothing else
        write_operator(path, self.operator)
        return path

    def _estimate(self, session: CalibrationSession, hand: Hand) -> None:
        try:
            recording = session.recording()
            found = calibrate(recording, hand, session.segments())
        except SmoothOperatorError as error:
            self._error = str(error)
        else:
            self._figures = _key_figures(report(found, recording))
            self.operator = found.operator
        finally:
            self._estimating = False


def _key_figures(content: dict[str, Any]) -> dict[str, Any]:
    """What a person wants to know of a report."""
    fingers = {
        name: {
            "scale": finger["scale"],
            "gap_mm": (finger["pinch_gap_mm"] or {}).get("median"),
            "corrected_mm": (finger["pinch_gap_corrected_mm"] or {}).get("p90"),
        }
        for name, finger in content["fingers"].items()
    }
    missing = [pose for pose, found in content["poses"].items() if not found["found"]]
    keys = ("hand", "side", "frames_used", "palm_scale", "palm_width_mm", "project_mm", "escape_mm")
    return {**{key: content[key] for key in keys}, "fingers": fingers, "missing": missing,
            "apply": list(content["apply"])}  # fmt: skip
