"""The player of a clip; what moves it is in ``player.js``."""

from __future__ import annotations

from collections.abc import Mapping

from smooth_operator.reporting.html import Html, data, dot, element, escape, join, paragraph


def player(clip: Mapping[str, object]) -> Html:
    """One pane a method, with play, pause, a slider and a speed.

    Args:
        clip: result of ``make_clip``.
    """
    panes = clip["panes"]
    assert isinstance(panes, list)
    shown = join(
        element(
            "div",
            Html(
                f'<canvas role="img" aria-label="{escape(pane["method"])}: human and robot hand">'
                f"</canvas><span>{dot(pane['color'])}"
                f"{escape(pane['method'])}</span>"
            ),
            class_="pane",
        )
        for pane in panes
    )
    controls = Html(
        '<button type="button">Play</button>'
        '<input type="range" min="0" value="0" aria-label="frame">'
        "<output></output>"
        '<select aria-label="speed"><option value="1">1 ×</option>'
        '<option value="0.5">½ ×</option><option value="0.25">¼ ×</option></select>'
    )
    hint = paragraph(
        "Grey: the human as the method saw it; coloured: the robot. Drag to turn, double-click to "
        "turn back.",
        "soft",
    )
    inside = join(
        [
            data(clip),
            element("div", shown, class_="panes"),
            element("div", controls, class_="controls"),
            hint,
        ]
    )
    return element("div", inside, class_="player")
