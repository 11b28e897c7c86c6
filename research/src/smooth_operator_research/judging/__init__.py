"""Measurements of the input check and of pinch damping.

Programs, run as ``python -m smooth_operator_research.judging.NAME``: ``input_check`` and
``pinch_front``.
"""
