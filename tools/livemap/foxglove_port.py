"""`--foxglove PORT`: where viewers look, looked at before anything starts."""

import socket
from importlib.util import find_spec

LOOPBACK = "127.0.0.1"  # not visible from other machines; there is no option for that
NO_PACKAGE = "--foxglove needs the foxglove extra: pip install 'headland[foxglove]'"


class PortTaken(Exception):
    """One line for the person: why viewers cannot look there."""


def check_port(port: int) -> None:
    """Raises PortTaken, also where the package is not installed."""
    if find_spec("foxglove") is None:
        raise PortTaken(NO_PACKAGE)
    try:
        with socket.create_server((LOOPBACK, port)):
            pass
    except OSError as problem:
        raise PortTaken(
            f"--foxglove {port}: {problem.strerror}; choose another, or 0 for any free one"
        ) from None
