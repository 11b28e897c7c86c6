"""Attainable bounds: the best pose of each frame within limits.

Run as ``python -m smooth_operator_research.attainable.bounds``.
"""
