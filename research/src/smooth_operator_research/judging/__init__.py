"""Judging: the check of input, pinch damping, and a bound on motion.

Programs, run as ``python -m smooth_operator_research.judging.NAME``: ``input_check``,
``pinch_front`` and ``motion_bound``.
"""
