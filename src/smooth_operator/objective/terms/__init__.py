"""Terms of an objective, one per file; ``smooth_operator.objective.loss`` sums them."""
