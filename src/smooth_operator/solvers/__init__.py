"""Solvers: pure functions of an objective, a start and, where they sample, random words."""
