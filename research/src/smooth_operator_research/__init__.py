"""Experiments behind the figures of smooth-operator: the paper, ablations, physics, operators."""
