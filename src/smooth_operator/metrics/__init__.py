"""Metrics of a run: pure functions of what the human did and what the robot was told to do.

``evaluate(trace)`` gives all of them; the modules beside it hold one family each and can be used
alone: ``smooth_operator.metrics.accuracy``, ``smooth_operator.metrics.consistency``,
``smooth_operator.metrics.joints``, ``smooth_operator.metrics.safety``,
``smooth_operator.metrics.service`` and ``smooth_operator.metrics.published``.
"""

from smooth_operator.lazy_names import public_names

__getattr__, __dir__, __all__ = public_names(__name__, __file__)
