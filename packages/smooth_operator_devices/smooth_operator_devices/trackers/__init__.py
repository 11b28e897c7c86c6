"""Live sources of trackers that speak a maker's protocol."""
