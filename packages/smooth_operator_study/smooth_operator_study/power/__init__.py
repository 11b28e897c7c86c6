"""Power of a study: simulated studies, analysed as the real one will be."""
