"""Robot arms that carry the hand and follow the operator's wrist; needs the ``arm`` extra."""
