"""Scorecard of a hand: what its thumb touches, what it holds, and which human postures it takes."""
