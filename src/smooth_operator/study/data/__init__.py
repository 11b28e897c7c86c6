"""Data of a study: trials, questionnaires, simulation metrics; read with every row checked."""

from smooth_operator.study.data.reading import read_study as read_study
from smooth_operator.study.data.rows import ITEMS as ITEMS
from smooth_operator.study.data.rows import POINTS as POINTS
from smooth_operator.study.data.rows import Questionnaires as Questionnaires
from smooth_operator.study.data.rows import SimulationMetrics as SimulationMetrics
from smooth_operator.study.data.rows import StudyData as StudyData
from smooth_operator.study.data.rows import Trials as Trials
