"""Further readings of a study: what reviewers ask for, next to the models that are reported."""

from smooth_operator.study.analysis.readings.all_readings import Readings as Readings
from smooth_operator.study.analysis.readings.all_readings import interactions as interactions
from smooth_operator.study.analysis.readings.all_readings import read_further as read_further
from smooth_operator.study.analysis.readings.interaction import Interaction as Interaction
from smooth_operator.study.analysis.readings.long_rows import reading_rows as reading_rows
from smooth_operator.study.analysis.readings.parts import Refused as Refused
