"""`--metrics PORT`, or HOST:PORT: where the figures for Prometheus are served."""

import socket
from importlib.util import find_spec
from typing import NamedTuple

from tools.common.options import PORT_MAX

LOOPBACK = "127.0.0.1"  # not visible from other machines, unless a host is named
NO_PACKAGE = "--metrics needs the metrics extra: pip install 'headland[metrics]'"


class MetricsError(Exception):
    """One line for the person."""


class MetricsAddress(NamedTuple):
    """A host and a port; port 0: any free one."""

    host: str
    port: int

    def __str__(self) -> str:
        return str(self.port) if self.host == LOOPBACK else f"{self.host}:{self.port}"


def metrics_address(text: str) -> MetricsAddress:
    """Of what a person has typed. Raises MetricsError, also where the package is not installed or
    the port is taken, so that all of it is said before a robot starts."""
    host, _, digits = text.rpartition(":")
    is_port = digits.isascii() and digits.isdecimal() and len(digits) <= len(str(PORT_MAX))
    if not is_port or int(digits) > PORT_MAX or ":" in host:
        raise MetricsError(f"--metrics {text}: a port from 0 to {PORT_MAX}, or HOST:PORT")
    if find_spec("prometheus_client") is None:
        raise MetricsError(NO_PACKAGE)
    address = MetricsAddress(host or LOOPBACK, int(digits))
    try:
        with socket.create_server(address):
            pass
    except OSError as problem:
        raise MetricsError(
            f"--metrics {address}: {problem.strerror}; choose another, or 0 for any free one"
        ) from None
    return address
