"""The paragraph on methods, ready to paste, with this study's numbers in it."""

from __future__ import annotations

from smooth_operator.study.analysis.analyze import Analysis
from smooth_operator.study.analysis.results import POOLED


def methods_paragraph(analysis: Analysis) -> str:
    """How the study was analysed, in the mode small-sample, in plain prose.

    Args:
        analysis: of the study.

    Returns:
        One paragraph per model and one on corrections; citations by the keys of
        ``CITATIONS``.
    """
    data = analysis.data
    tasks = [scope for scope in analysis.scopes if scope != POOLED]
    operators = len({str(name) for name in data.trials.operator})
    success = int(data.trials.success.sum())
    others = len(analysis.retargeters) - 1
    pairs = others * (others + 1) // 2
    many = len(tasks) > 1
    adjusted = "retargeter, task and" if many else "retargeter and"
    forms = "with questionnaires filled in" if data.questionnaires is not None else ""
    count = len(data.questionnaires or ())
    first = (
        f"{operators} operators took part in {len(data.trials)} trials of {len(tasks)} "
        f"task{'s' if many else ''} with {len(analysis.retargeters)} retargeters "
        f"({', '.join(analysis.retargeters)}), {success} of them successful (score of at least 0.5)"
        + (f", {forms} {count} times" if forms else "")
        + "."
    )
    linear = "Completion time of successful trials"
    if data.questionnaires is not None:
        linear += (
            " and workload (unweighted mean of the six NASA-TLX scales [Hart1988])"
            if analysis.workload == "raw"
            else " and workload (mean of the six NASA-TLX scales, weighted by each operator's "
            "choices between pairs of them [Hart1988])"
        )
    linear += (
        f" were analysed by linear mixed models with {adjusted} standardised trial index as fixed "
        "effects and a random intercept for each operator, fitted by restricted maximum likelihood "
        "[Bates2015]; tests and intervals use Satterthwaite's degrees of freedom [Kuznetsova2017]."
    )
    binary = (
        "Success was analysed by population-averaged logistic regression with the same fixed "
        "effects: generalised estimating equations with an exchangeable working correlation within "
        "operators [Liang1986], the covariance of Mancl and DeRouen [Mancl2001] and t tests "
        f"with {operators - 1} degrees of freedom for all tasks together (operators less one). "
        "Data were checked for separation beforehand [Konis2007]."
    )
    means = (
        "We report estimated marginal means [Searle1980] at the mean trial index"
        + (", tasks weighing equally" if many else "")
        + ", for success as means of probabilities with standard errors by the delta method. "
        f"{'Each retargeter' if others > 1 else 'The other retargeter'} was compared with "
        f"{analysis.baseline} by Dunnett's single-step procedure [Dunnett1955, Hothorn2008], with "
        "p-values and simultaneous 95 % intervals from the exact multivariate t distribution of "
        f"the model's contrasts [Genz2009]; all {pairs} pairs were compared with Holm's correction "
        "[Holm1979]. Effect sizes are described in Cohen's words [Cohen1988]."
    )
    parts = [first, linear, binary, means]
    if analysis.spearman:
        parts.append(
            "Metrics of the simulation were correlated with each operator's mean outcomes by "
            "Spearman's rank correlation [Spearman1904], with 95 % percentile intervals from a "
            "bootstrap over operators [Field2007]."
        )
    parts.append("The analysis was done with smooth-operator.")
    return " ".join(parts)
