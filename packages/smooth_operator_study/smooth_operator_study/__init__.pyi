from smooth_operator_study.analysis.analyze import analyze_study as analyze_study
from smooth_operator_study.data.reading import read_study as read_study
