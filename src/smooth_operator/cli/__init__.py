"""The command ``smooth-operator`` and its subcommands: options, help and output.

Heavy libraries (JAX, MuJoCo, matplotlib, viser) are imported inside the command that needs them.
"""

from smooth_operator.cli.process import main as main
from smooth_operator.cli.process import program as program
