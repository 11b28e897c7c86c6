"""The command ``smooth-operator dataset``, and ``retarget`` for folders and data sets."""
