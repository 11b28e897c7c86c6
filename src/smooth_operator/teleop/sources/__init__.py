"""Sources of hand frames: one module for each kind."""
