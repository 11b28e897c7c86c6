"""Every method that the analysis uses, with the work to cite for it."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True)
class Citation:
    """A method and where it comes from."""

    key: str
    method: str
    reference: str


CITATIONS: Final = (
    Citation("Schulz2010", "Flow of participants",
             "Schulz, Altman, Moher (2010). CONSORT 2010 statement: updated guidelines for "
             "reporting parallel group randomised trials. BMJ 340, c332. doi:10.1136/bmj.c332"),
    Citation("Williams1949", "Orders balanced for place and for what comes before",
             "Williams (1949). Experimental designs balanced for the estimation of residual "
             "effects of treatments. Australian Journal of Scientific Research A 2(2), 149-168. "
             "doi:10.1071/CH9490149"),
    Citation("Bates2015", "Linear mixed models by restricted maximum likelihood",
             "Bates, Mächler, Bolker, Walker (2015). Fitting linear mixed-effects models using "
             "lme4. Journal of Statistical Software 67(1). doi:10.18637/jss.v067.i01"),
    Citation("Kuznetsova2017", "Satterthwaite's degrees of freedom",
             "Kuznetsova, Brockhoff, Christensen (2017). lmerTest package: tests in linear mixed "
             "effects models. Journal of Statistical Software 82(13). doi:10.18637/jss.v082.i13"),
    Citation("Liang1986", "Generalised estimating equations, sandwich covariance",
             "Liang, Zeger (1986). Longitudinal data analysis using generalized linear models. "
             "Biometrika 73(1), 13-22. doi:10.1093/biomet/73.1.13"),
    Citation("Mancl2001", "Covariance of GEE with few clusters",
             "Mancl, DeRouen (2001). A covariance estimator for GEE with improved small-sample "
             "properties. Biometrics 57(1), 126-134. doi:10.1111/j.0006-341X.2001.00126.x"),
    Citation("Searle1980", "Estimated marginal means",
             "Searle, Speed, Milliken (1980). Population marginal means in the linear model. "
             "The American Statistician 34(4), 216-221. doi:10.1080/00031305.1980.10483031"),
    Citation("Dunnett1955", "Comparison of several treatments with a control",
             "Dunnett (1955). A multiple comparison procedure for comparing several treatments "
             "with a control. Journal of the American Statistical Association 50, 1096-1121. "
             "doi:10.1080/01621459.1955.10501294"),
    Citation("Hothorn2008", "Single-step comparisons of model contrasts",
             "Hothorn, Bretz, Westfall (2008). Simultaneous inference in general parametric "
             "models. Biometrical Journal 50(3), 346-363. doi:10.1002/bimj.200810425"),
    Citation("Genz2009", "Multivariate normal and t probabilities",
             "Genz, Bretz (2009). Computation of multivariate normal and t probabilities. "
             "Springer. doi:10.1007/978-3-642-01689-9"),
    Citation("Holm1979", "Step-down correction of all pairs",
             "Holm (1979). A simple sequentially rejective multiple test procedure. Scandinavian "
             "Journal of Statistics 6(2), 65-70."),
    Citation("Konis2007", "Detection of separation by linear programming",
             "Konis (2007). Linear programming algorithms for detecting separated data in binary "
             "logistic regression models. DPhil thesis, University of Oxford."),
    Citation("Spearman1904", "Rank correlation",
             "Spearman (1904). The proof and measurement of association between two things. "
             "The American Journal of Psychology 15(1), 72-101. doi:10.2307/1412159"),
    Citation("Field2007", "Bootstrap over clusters",
             "Field, Welsh (2007). Bootstrapping clustered data. Journal of the Royal Statistical "
             "Society B 69(3), 369-390. doi:10.1111/j.1467-9868.2007.00593.x"),
    Citation("Cohen1988", "Effect sizes and words for them",
             "Cohen (1988). Statistical power analysis for the behavioral sciences, 2nd edition. "
             "Lawrence Erlbaum."),
    Citation("Hart1988", "NASA-TLX",
             "Hart, Staveland (1988). Development of NASA-TLX (Task Load Index). Advances in "
             "Psychology 52, 139-183. doi:10.1016/S0166-4115(08)62386-9"),
    Citation("Hart2006", "Unweighted (raw) NASA-TLX",
             "Hart (2006). NASA-Task Load Index (NASA-TLX); 20 years later. Proceedings of the "
             "Human Factors and Ergonomics Society Annual Meeting 50(9), 904-908. "
             "doi:10.1177/154193120605000909"),
    Citation("Shapiro1965", "Test of normal residuals",
             "Shapiro, Wilk (1965). An analysis of variance test for normality (complete samples). "
             "Biometrika 52(3-4), 591-611. doi:10.1093/biomet/52.3-4.591"),
    Citation("Brown1974", "Test of equal spread, about medians",
             "Brown, Forsythe (1974). Robust tests for the equality of variances. Journal of the "
             "American Statistical Association 69, 364-367. doi:10.1080/01621459.1974.10482955"),
)  # fmt: skip
"""Of everything that may be done."""


def cited(text: str) -> list[Citation]:
    """The works that a text cites by their keys in square brackets, in the order of the list."""
    keys = {key for group in re.findall(r"\[([\w, ]+)\]", text) for key in group.split(", ")}
    return [citation for citation in CITATIONS if citation.key in keys]
