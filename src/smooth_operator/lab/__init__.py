"""Experiments: benchmarks, the paper, tuning, training, data sets and hand validation."""
