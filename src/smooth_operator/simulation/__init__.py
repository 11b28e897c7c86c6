"""Simulates robot hands in MuJoCo, and the scenes of the user study's tasks."""
