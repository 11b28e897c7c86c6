"""Robot hands under MuJoCo physics, and the scenes of the study's tasks."""
