"""Metrics of a run, as pure functions of the human's motion and the robot's commands.

``evaluate(trace)`` gives all of them; each module of the package holds one family and can be used
alone: ``smooth_operator.metrics.accuracy``, ``smooth_operator.metrics.consistency``,
``smooth_operator.metrics.joints``, ``smooth_operator.metrics.safety``,
``smooth_operator.metrics.service`` and ``smooth_operator.metrics.published``.
"""

from smooth_operator.lazy_names import public_names

__getattr__, __dir__, __all__ = public_names(__name__, __file__)
