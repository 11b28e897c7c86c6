"""``smooth-operator doctor``: the machine, versions and extras, and what to change."""

from __future__ import annotations

from collections.abc import Mapping

from smooth_operator.cli.console import output_console, plain_table
from smooth_operator.cli.doctor_options import Doctor
from smooth_operator.compilation.diagnosis import environment
from smooth_operator.io.jsonable import to_json
from smooth_operator.teleop.runtime.priority import going_first


def doctor(options: Doctor) -> None:
    """Prints the facts about the machine as a table or JSON, and what to change."""
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
    """What to change; empty if nothing."""
    advice = []
    if str(report["programs"]).startswith("not kept"):
        advice.append(
            f"compiled programs are {report['programs']}, so each start compiles; give "
            "SMOOTH_OPERATOR_CACHE a folder that only you can write, or unset it"
        )
    load, cores = report["load"], report["cores"]
    if isinstance(load, float) and isinstance(cores, int) and load > cores:
        advice.append(
            f"the load is {load:.1f} on {cores} cores: other programs take time from the loop"
        )
    if cores == 1:
        advice.append("one core serves loop, page and tracker: give the process two")
    if report["priority"] != "real-time" and report["system"] == "Linux":
        advice.append(
            "real-time priority is not granted, so `teleop --priority high` has no effect: add "
            "'USER - rtprio 20' to /etc/security/limits.conf and log in again"
        )
    if report["governor"] == "powersave":
        advice.append("the processor saves power: sudo cpupower frequency-set -g performance")
    if "," in str(report["opencv"]):
        advice.append(
            f"{report['opencv']} are in one folder, where the last one installed overwrites the "
            "others: keep one, see docs/how-to/webcam.md, Problems"
        )
    if report["device"] not in ("cpu", None):
        advice.append(
            f"frames run on {report['device']}, which suits many hands; for one, try "
            "JAX_PLATFORMS=cpu"
        )
    return advice
