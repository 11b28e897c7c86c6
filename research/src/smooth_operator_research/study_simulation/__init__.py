"""Simulates a study with virtual operators in physics; it does not replace a study with people."""
