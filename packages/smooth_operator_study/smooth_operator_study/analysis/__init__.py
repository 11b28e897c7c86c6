"""Statistics of a study: models, comparisons, learning, correlations, report."""

from smooth_operator_study.analysis.analyze import Analysis as Analysis
from smooth_operator_study.analysis.analyze import analyze_study as analyze_study
