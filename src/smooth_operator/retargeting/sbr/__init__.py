"""SBR, the sampling-based method of the paper: Eq. (1), Algorithm 1 and its random numbers."""
