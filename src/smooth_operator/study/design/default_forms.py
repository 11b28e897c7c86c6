"""Forms that ``study new`` puts into a plan: consent, about the operator, a look back."""

from __future__ import annotations

from typing import Final

from smooth_operator.study.design.forms import Form, FormField

_CONSENT: Final = Form(
    "consent",
    "before",
    (
        FormField(
            "agreed",
            "I have read the information for participants, and agree to take part.",
            "consent",
            required=True,
        ),
        FormField("recordings", "Recordings of my hand may be kept for research.", "consent"),
    ),
    title="Consent",
    text="You may stop at any time, without giving a reason.",
)
_OFTEN: Final = ("never", "once or twice", "up to ten times", "more often")
_ABOUT: Final = Form(
    "about-you",
    "before",
    (
        FormField("age", "Age [years]", "number", least=16, most=120),
        FormField("gender", "Gender"),
        FormField("writes_with", "Hand that you write with", "choice",
                  choices=("left", "right", "both")),
        FormField("hand_length", "Hand length, wrist to tip of the middle finger [mm]", "number",
                  least=100, most=280),
        FormField("experience", "How often have you moved a robot hand with your own?", "choice",
                  choices=_OFTEN),
        FormField("author", "Do you work on one of the compared methods?", "choice",
                  choices=("no", "yes")),
    ),
    title="About you",
)  # fmt: skip
_BACK: Final = Form(
    "at-the-end",
    "after",
    (
        FormField("ranking", "Which did you like best?", "ranking"),
        FormField("comments", "What else would you like to say?"),
    ),
    title="Looking back",
)
DEFAULT_FORMS: Final = (_CONSENT, _ABOUT, _BACK)
"""In the order in which they are asked."""
