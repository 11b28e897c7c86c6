"""Readers of data sets: from the files of each layout to clips of one or two human hands."""
