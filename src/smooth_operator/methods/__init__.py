"""Named retargeting methods, composed from alignment, objective and solver."""
