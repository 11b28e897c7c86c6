"""``smooth-operator doctor``: reports the machine, versions and extras, and suggests changes."""

from __future__ import annotations

from collections.abc import Mapping

from smooth_operator.cli.console import output_console, plain_table
from smooth_operator.cli.diagnosis import environment
from smooth_operator.cli.doctor_options import Doctor
from smooth_operator.io.jsonable import to_json
from smooth_operator.teleop.runtime.priority import going_first


def doctor(options: Doctor) -> None:
    """Prints facts about the machine as a table or JSON, and suggested changes."""
    with going_first() as priority:
        pass
    report = environment() | {"priority": priority}
    advice = _advice(report)
    if options.json:
        print(to_json({"environment": report, "advice": advice}, indent=2))
        return
    console = output_console()
    rows = ((n.replace("_", " "), "-" if v is None else str(v)) for n, v in report.items())
    console.print(plain_table("Machine", ("", "found"), rows))
    for line in advice or ["Nothing to change."]:
        console.print(f"{'! ' if advice else ''}{line}", markup=False, soft_wrap=True)


def _advice(report: Mapping[str, object]) -> list[str]:
    """Suggested changes; empty if there are none."""
    advice = []
    if str(report["programs"]).startswith("not kept"):
        advice.append(
            f"compiled programs are {report['programs']}, so every start compiles again; set "
            "SMOOTH_OPERATOR_CACHE to a folder that only you can write to, or unset it"
        )
    load, cores = report["load"], report["cores"]
    if isinstance(load, float) and isinstance(cores, int) and load > cores:
        advice.append(
            f"the load is {load:.1f} on {cores} cores: other programs take time from the loop"
        )
    if cores == 1:
        advice.append("loop, page and tracker share one core: give the process at least two")
    if report["priority"] != "real-time" and report["system"] == "Linux":
        advice.append(
            "real-time priority is not granted, so `teleop --priority high` has no effect: add "
            "'USER - rtprio 20' to /etc/security/limits.conf and log in again"
        )
    if report["governor"] == "powersave":
        advice.append(
            "the processor is in a power-saving mode; to change it: sudo cpupower frequency-set "
            "-g performance"
        )
    if "," in str(report["opencv"]):
        advice.append(
            f"{report['opencv']} are installed in one folder, where the last one overwrites "
            "the others: keep only one, see docs/how-to/webcam.md, Problems"
        )
    if report["device"] not in ("cpu", None):
        advice.append(
            f"frames run on {report['device']}, which is efficient for many hands; for one "
            "hand, try JAX_PLATFORMS=cpu"
        )
    return advice
