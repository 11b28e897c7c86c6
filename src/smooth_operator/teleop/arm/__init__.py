"""Arms that follow the operator's wrist and carry the hand; needs the extra ``arm``."""
