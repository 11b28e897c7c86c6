"""``python -m smooth_operator``: the command line, where its script is not on the path."""

import sys

from smooth_operator.cli import program

if __name__ == "__main__":
    sys.exit(program())
