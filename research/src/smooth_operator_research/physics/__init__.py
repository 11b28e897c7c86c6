"""Measures of what a hand achieves: motions that it can make, tasks, pinches, and operators.

``smooth-operator bench --physics`` runs them; ``measure`` says what a measure has to offer.
"""
