"""Virtual operators: a model of a person who looks at the robot hand and corrects."""

from smooth_operator_research.virtual_operator.operator import VirtualOperator
from smooth_operator_research.virtual_operator.person import Person, draw_person
from smooth_operator_research.virtual_operator.trial import (
    Familiar,
    OperatorTrial,
    make_familiar,
    simulate_trial,
)

__all__ = [
    "Familiar",
    "OperatorTrial",
    "Person",
    "VirtualOperator",
    "draw_person",
    "make_familiar",
    "simulate_trial",
]
