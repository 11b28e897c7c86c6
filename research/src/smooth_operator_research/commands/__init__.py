"""The commands that this distribution adds to ``smooth-operator``."""
