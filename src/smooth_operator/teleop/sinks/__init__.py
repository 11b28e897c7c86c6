"""Where joint commands go: one module per kind of sink."""
