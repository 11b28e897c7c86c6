"""GeoRT (Yin et al., 2025): the network as a method, and its training in JAX on a CPU."""
