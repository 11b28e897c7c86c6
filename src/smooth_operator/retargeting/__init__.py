"""Retargeting: computes a command from the landmarks of a frame, in one compiled program.

A frame passes these modules, in this order: ``retargeter`` takes it, ``program`` checks it and
holds the state, ``alignment`` aligns it to the palm, ``pinch_gaps``, ``fingertip_filter`` and
``correspondence`` compute the fingertip targets, ``targets`` sets the keyvector targets,
``objective`` sums its cost terms and those of ``smooth_terms``, and ``levenberg`` minimises the
sum. ``smooth`` puts these together; ``sbr`` is the paper's method, with its sampler.
Whole recordings are solved by ``trajectory_retargeter``.
"""

from smooth_operator.lazy_names import public_names

__getattr__, __dir__, __all__ = public_names(__name__, __file__)
