"""Simulation of robot hands in MuJoCo, and the scenes of the study's tasks."""
