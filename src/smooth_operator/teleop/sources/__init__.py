"""Sources, which provide hand frames: one module for each kind."""
