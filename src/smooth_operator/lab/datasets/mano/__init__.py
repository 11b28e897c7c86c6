"""MANO hands: model files, parameters to landmarks, and the pickles they come in, read as data."""
