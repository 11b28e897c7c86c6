"""Robot arms that carry a hand: descriptions, models, and the transform from flange to hand."""
