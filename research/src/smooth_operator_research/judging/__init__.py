"""Programs that measure the input check and pinch damping.

Run them as ``python -m smooth_operator_research.judging.NAME``, with the names ``input_check`` and
``pinch_front``.
"""
