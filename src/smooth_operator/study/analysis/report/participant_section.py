"""The section of participants: from enrolment to analysis, and irregular events."""

from __future__ import annotations

from smooth_operator.reporting.html import Html, element, join, paragraph, text_table
from smooth_operator.study.analysis.analyze import Analysis


def participant_section(analysis: Analysis) -> Html:
    """Who took part, what was repeated or corrected."""
    flow = analysis.data.flow
    analysed = len({str(name) for name in analysis.data.trials.operator})
    parts = []
    if flow.logged:
        rows = [
            ("planned", "–" if flow.planned is None else str(flow.planned)),
            ("enrolled", str(len(flow.enrolled))),
            ("started", str(len(flow.started))),
            ("withdrawn", str(len(flow.withdrawn))),
            ("replaced a withdrawn one", str(len(flow.replaces))),
            ("completed", str(len(flow.completed))),
            ("excluded from the analysis", str(len(flow.excluded))),
            ("analysed", str(analysed)),
        ]
        parts.append(text_table(("operators", "number"), rows))
    else:
        parts.append(paragraph(
            f"{analysed} operators analysed. Enrolment and withdrawals are not known: tables were "
            "given, and not the log of the study.", "soft",
        ))  # fmt: skip
    leavers = [
        f"{who}: withdrew, data {'kept' if one.keep else 'left out'}"
        + (f" ({one.reason})" if one.reason else "")
        for who, one in flow.withdrawn.items()
    ]
    leavers += [f"{who}: takes the place of {other}" for who, other in flow.replaces.items()]
    leavers += [f"{who}: excluded ({reason})" for who, reason in flow.excluded.items()]
    parts += [paragraph(line) for line in leavers]
    if flow.logged:
        events = [
            [
                name,
                *(str(counts.get(name, 0)) for counts in (flow.voids, flow.undone, flow.amended)),
            ]
            for name in analysis.retargeters
        ]
        parts.append(element("h3", Html("Irregular events")))
        parts.append(
            text_table(("retargeter", "void trials", "undone events", "amended trials"), events)
        )
        parts.append(paragraph(
            f"Pauses {flow.pauses}; recalibrations {flow.recalibrations}; blocks ended early "
            f"{flow.ended_early}.", "soft",
        ))  # fmt: skip
    return join(parts)
