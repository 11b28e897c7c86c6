"""Judging: the check of input and pinch damping.

Programs, run as ``python -m smooth_operator_research.judging.NAME``: ``input_check`` and
``pinch_front``.
"""
