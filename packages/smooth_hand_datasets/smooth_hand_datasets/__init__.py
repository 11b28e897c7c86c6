"""Research data sets of hands and objects: readers, writers, and retargeting with objects."""
