"""Ports of this machine."""

import socket


def free_port():
    """Port that nobody uses at present."""
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return one.getsockname()[1]
