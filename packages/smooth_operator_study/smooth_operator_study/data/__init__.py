"""Data of a study: trials, questionnaires, simulation metrics; read with every row checked."""

from smooth_operator_study.data.reading import read_study as read_study
from smooth_operator_study.data.rows import StudyData as StudyData
