"""Real robot hands: actuator tables, drivers, and the sink that moves them safely."""
