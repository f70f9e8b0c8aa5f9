"""Run as a script by `test_multicast_loopback.py`, in a network of its own: its only interface is removed
and comes back.

    unshare -rn python multicast_in_namespace.py GROUP [listens]

`listens`: the bus says nothing, as that of a viewer.
Prints which frames of another device were heard, as JSON.
"""

import asyncio
import json
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress

import can

from protocol.frames.frame import Frame
from protocol.links import bus as links
from protocol.links.bus import open_bus

INTERFACE, LIMIT_S, LOOK_S = "udp_multicast", 20.0, 0.01
OWN = Frame(0x18FF1080, b"own")
PLUG = (
    "link add veth0 type veth peer name veth1",
    "addr add 10.9.0.1/24 dev veth0",
    "link set veth0 up",
    "link set veth1 up",
    "route add 224.0.0.0/4 dev veth0",
)


def ip(*commands: str) -> None:
    for command in commands:
        subprocess.run(["ip", *command.split()], check=True)


async def play(group: str, listens: bool) -> list[str]:
    loop = asyncio.get_running_loop()
    ip(*PLUG)
    bus, heard, refused = open_bus(INTERFACE, group), list[str](), False
    bus.subscribe(lambda frame: heard.append(frame.data.decode()))

    async def sends_until(holds: Callable[[], bool]) -> None:
        nonlocal refused
        while not holds():
            refused = listens or not bus.send(OWN)
            turn = loop.create_future()
            loop.call_later(LOOK_S, turn.set_result, None)
            await turn

    async def hears(word: str) -> None:
        with can.Bus(group, INTERFACE) as speaker:

            def holds() -> bool:
                with suppress(can.CanError, OSError):
                    speaker.send(can.Message(arbitration_id=2, data=word.encode()))
                return word in heard

            await sends_until(holds)

    async with asyncio.timeout(LIMIT_S):
        await hears("before")
        ip("link del veth0")
        await sends_until(lambda: refused)
        ip(*PLUG)
        await hears("after")
    bus.close()
    return sorted(set(heard))


if __name__ == "__main__":
    only_listens = "listens" in sys.argv
    links.DEAF_S = 0.2  # type: ignore[misc]
    links.QUIET_S = 0.2 if only_listens else LIMIT_S  # type: ignore[misc]
    print(json.dumps(asyncio.run(play(sys.argv[1], only_listens))))
