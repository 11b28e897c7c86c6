"""Judging: ``motion_bound``, the largest motion preservation that a hand allows."""
