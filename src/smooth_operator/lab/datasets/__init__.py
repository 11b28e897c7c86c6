"""Data sets of human hands into episodes of robot hands: readers, retargeting, filters, writers."""
