"""The command line: ``smooth-operator demo``, ``retarget`` and ``view``.

What is heavy (JAX, MuJoCo, matplotlib, viser) is imported inside the command that needs it.
"""

from smooth_operator.cli.process import main as main
from smooth_operator.cli.process import program as program
