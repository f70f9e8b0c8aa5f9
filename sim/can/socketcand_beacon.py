"""The beacon of socketcand: a datagram that announces where a bus is served, so that tools find it.

SavvyCAN lists only servers whose beacon it has received, and python-can's
`detect_available_configs` uses beacons as well. A server on loopback is announced on loopback only.
"""

import asyncio
import contextlib
import socket
from ipaddress import ip_address
from xml.sax.saxutils import escape, quoteattr

PORT = 42_000  # the port on which listeners expect it, as with socketcand
EVERY_S = 3.0  # as socketcand does
LOOPBACK, NETWORK = "127.255.255.255", "255.255.255.255"  # broadcast addresses
BYTES_MAX = 1024  # the size that listeners read; socketcand's own limit, too
NAME_MAX, CHANNEL_MAX = 64, 32  # characters of a host name and of a channel
TYPE = "SocketCAN"  # SavvyCAN and Kayak know this kind and "adapter"


def beacon(name: str, host: str, port: int, channel: str) -> bytes:
    """The datagram. `host`: the address that clients connect to."""
    text = (
        f'<CANBeacon name={quoteattr(name[:NAME_MAX])} type="{TYPE}" description="Headland">\n'
        f"<URL>can://{escape(host)}:{port}</URL><Bus name={quoteattr(channel[:CHANNEL_MAX])}/>"
        "</CANBeacon>"
    ).encode()
    assert len(text) <= BYTES_MAX
    return text


async def announce(host: str, port: int, channel: str) -> None:
    """Announce until cancelled. `host`: where the server listens. A network that rejects a datagram
    is no reason to end, because it may recover."""
    local = "127.0.0.1" if host == "localhost" else host
    try:
        address = ip_address(local)
    except ValueError:  # a host name: its addresses cannot be known here
        return
    if address.version != 4:  # the beacon is a broadcast, which IPv6 does not have
        return
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.setblocking(False)
        sender.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        while True:
            with contextlib.suppress(OSError):
                sender.connect((LOOPBACK if address.is_loopback else NETWORK, PORT))
                reached = sender.getsockname()[0] if address.is_unspecified else local
                sender.send(beacon(socket.gethostname(), reached, port, channel))
            await asyncio.sleep(EVERY_S)
