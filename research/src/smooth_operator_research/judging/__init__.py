"""Judging: methods by targets, parts of a method, a calibration, and the check of input.

Programs, run as ``python -m smooth_operator_research.judging.NAME``: ``judge``, ``method_tables``,
``calibration_gain`` and ``input_check``.
"""
