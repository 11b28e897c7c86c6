"""GeoRT (Yin et al., 2025): its network as a retargeting method, and the training of the network in
JAX on a CPU."""
