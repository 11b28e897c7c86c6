"""Statistics of a study: models, comparisons, learning, correlations, report.

Needs the extra ``study``.
"""

from smooth_operator.errors import require

require("the analysis of a study", "study", "statsmodels", "matplotlib")

from smooth_operator_study.analysis.analyze import Analysis as Analysis
from smooth_operator_study.analysis.analyze import analyze_study as analyze_study
