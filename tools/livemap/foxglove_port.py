"""`--foxglove PORT`: the port for viewers, checked before anything starts."""

import socket
from importlib.util import find_spec

from tools.inspect.metrics_address import LOOPBACK

NO_PACKAGE = "--foxglove needs the foxglove extra: pip install 'headland[foxglove]'"


class PortTaken(Exception):
    """One line for the person: why viewers cannot look there."""


def check_port(port: int) -> None:
    """Raises PortTaken, also where the package is not installed. Other machines never see the port:
    there is no option for that."""
    if find_spec("foxglove") is None:
        raise PortTaken(NO_PACKAGE)
    try:
        with socket.create_server((LOOPBACK, port)):
            pass
    except OSError as problem:
        raise PortTaken(
            f"--foxglove {port}: {problem.strerror}; choose another, or 0 for any free one"
        ) from None
