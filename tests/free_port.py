"""A port of this machine that nothing uses."""

import socket


def free_port() -> int:
    """The system's choice: other runs of the tests, at the same time, get others."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
    return port
