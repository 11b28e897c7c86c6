"""The paper's supplementary experiments, re-run on the given data; one file each.

``smooth_operator_research.paper.experiment`` lists the experiments. Each consists of cells (the
results of a solver on a recording), which are stored on disk and shared within a folder.
"""
