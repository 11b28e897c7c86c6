"""The paper's supplementary experiments, re-run on the given data; one file each.

An experiment is named in ``smooth_operator_research.paper.experiment``, and made of cells (what a
solver did on a recording) that are kept on disk and shared among the experiments of a folder.
"""
