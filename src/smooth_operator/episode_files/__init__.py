"""File formats of episodes: HDF5, ``.npz``, LeRobot datasets and EgoDex files."""
