"""Real robot hands: tables of their actuators, drivers, and the sink that keeps them safe."""
