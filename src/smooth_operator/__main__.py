"""Entry point of ``python -m smooth_operator`` and of the script ``smooth-operator``."""

import signal

# Ctrl-C during the imports below ends the process at once; Python's own handler would print a
# traceback. The command sets a handler of its own.
signal.signal(signal.SIGINT, signal.SIG_DFL)

import sys  # noqa: E402

from smooth_operator.cli import program  # noqa: E402

if __name__ == "__main__":
    sys.exit(program())
