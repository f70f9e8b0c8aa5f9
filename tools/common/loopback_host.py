"""Names by which a browser or a program on this machine asks a server on loopback.

A page of another site may give its own name the address of this machine (DNS rebinding). The browser then
takes our answers for that site's, and only the header Host tells whose name was asked for.
"""

import re
from collections.abc import Sequence
from ipaddress import ip_address

# Any port: ssh may forward another.
HOST = re.compile(r"(127\.0\.0\.1|localhost|\[::1\])(:[0-9]{1,5})?")


def asked_here(hosts: Sequence[str], origins: Sequence[str]) -> bool:
    """Whether a request names this machine, and a page that sent it is of the same server.

    `hosts`, `origins`: the values of these headers."""
    known = len(hosts) == 1 and HOST.fullmatch(hosts[0]) is not None
    return known and all(origin == f"http://{hosts[0]}" for origin in origins)


def is_loopback(address: str) -> bool:
    """Whether only this machine reaches a server there. A name is none but `localhost`."""
    try:
        return ip_address(address).is_loopback
    except ValueError:
        return address == "localhost"
