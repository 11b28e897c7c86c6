"""File formats of episodes: HDF5, ``.npz`` and LeRobot datasets; EgoDex files."""
