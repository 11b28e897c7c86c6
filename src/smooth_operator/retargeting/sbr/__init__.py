"""SBR, the sampling-based method of the Smooth Operator paper (Malate et al., 2026)."""
