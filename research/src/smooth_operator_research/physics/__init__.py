"""Measures of what a hand achieves: motions that it can make, tasks, pinches, and operators.

``smooth-operator bench --physics`` runs them; ``measure`` has the interface of a measure.
"""
