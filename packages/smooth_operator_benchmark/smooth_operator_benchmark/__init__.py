"""Measures retargeting methods on recordings and robot hands; writes tables, plots and a report.

``plan_cells`` checks the request, ``run_suite`` measures, ``make_rows`` creates the rows of
``results.json``, ``compare`` compares them with an earlier benchmark, and
``smooth_operator_benchmark.page`` writes the report. None of them prints anything.

A separate distribution that uses ``smooth_operator`` and adds the command ``bench`` to it.
"""

from smooth_operator.lazy_names import public_names

__getattr__, __dir__, __all__ = public_names(__name__, __file__)
