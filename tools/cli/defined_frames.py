"""Every frame as tools of other makers are to know it: its identifier, sender, signals and cycle time.

Without addresses, source address 254 and destination 255 stand for any, as J1939 files do. With them,
each frame has its exact identifier, once for each sender and receiver that it may have: these
addresses, the tools' address 249, and all.
"""

from collections.abc import Iterator, Sequence
from typing import Any, Final, NamedTuple

from agent.interface.config import (
    FAULTS_PERIOD_US,
    MEMBER_EVERY,
    STANDARD_HEARTBEAT_US,
    STANDSTILL_US,
    beat_of,
)
from protocol.frames.diagnostic_frames import DM1, STANDARD_HEARTBEAT
from protocol.frames.fleet_frames import HEARTBEAT, MEMBER, POSE, STANDSTILL
from protocol.frames.identifier import GLOBAL_ADDRESS, NULL_ADDRESS, Identifier
from protocol.frames.layout import GATEWAY, ROBOT, TOOL, FrameLayout, Signal
from protocol.frames.messages import GROUPS
from protocol.frames.safety_frames import ALL_IMPLEMENTS_STOP

NODES = (ROBOT, TOOL, GATEWAY)
NAME_MAX = 32  # characters of a name in a DBC
TOOL_ADDRESS: Final = 249  # preferred by the tools of operators
ADDRESSES_MAX: Final = 32  # a file for more would have 20,000 frames
# Of a fleet of up to 30 robots, in calm; STANDSTILL and DM1 while a robot stands, the standard stop
# while it is latched, the standard heartbeat while it is asked for.
CYCLE_MS: dict[FrameLayout[Any], int] = {
    POSE: beat_of(1).pose_period_us // 1000,
    HEARTBEAT: beat_of(1).heartbeat_period_us // 1000,
    MEMBER: MEMBER_EVERY * beat_of(1).heartbeat_period_us // 1000,
    STANDSTILL: STANDSTILL_US // 1000,
    ALL_IMPLEMENTS_STOP: 1000,
    DM1: FAULTS_PERIOD_US // 1000,
    STANDARD_HEARTBEAT: STANDARD_HEARTBEAT_US // 1000,
}


class AddressesError(Exception):
    """A range of addresses that cannot be used; the text says why."""


class Definition(NamedTuple):
    """One frame of the file: a group as one device sends it to one other."""

    group: FrameLayout[Any]
    name: str
    identifier: int  # 29 bits
    sender: str  # node; "": any


def addresses_of(text: str) -> Sequence[int]:
    """The addresses of `128-133` or `128,130-131`. Raises AddressesError.

    >>> list(addresses_of("128,130-131"))
    [128, 130, 131]
    """
    found: set[int] = set()
    for part in text.split(","):
        first, to, last = part.strip().partition("-")
        try:
            run = range(int(first), int(last if to else first) + 1)
        except ValueError:
            raise AddressesError(
                f"{part!r} is no address, as 128, and no range, as 128-133"
            ) from None
        if not run or run[0] < 0 or run[-1] >= NULL_ADDRESS:
            raise AddressesError(
                f"{part}: addresses are 0 to {NULL_ADDRESS - 1}, the lower one first"
            )
        found |= set(run)
    if len(found) > ADDRESSES_MAX:
        raise AddressesError(f"{len(found)} addresses; {ADDRESSES_MAX} at most")
    return sorted(found)


def definitions(addresses: Sequence[int]) -> Iterator[Definition]:
    """All frames. `addresses`: of robots; empty: any."""
    if not addresses:
        for group in GROUPS:
            yield _definition(group, group.name, GLOBAL_ADDRESS, NULL_ADDRESS, group.sender)
        return
    for group in GROUPS:
        for source in _sources(group, addresses):
            node = "" if source == NULL_ADDRESS else _node(source)
            name = f"{group.name}_{source}"
            if not _addressed(group):
                yield _definition(group, name, GLOBAL_ADDRESS, source, node)
                continue
            for destination in (*addresses, TOOL_ADDRESS, GLOBAL_ADDRESS):
                if destination != source:
                    yield _definition(group, f"{name}_{destination}", destination, source, node)


def _sources(group: FrameLayout[Any], addresses: Sequence[int]) -> Sequence[int]:
    """The addresses from which a group is sent. Robots pass on some groups of tools. Before its claim
    a tool sends from the null address."""
    if group.sender in (ROBOT, GATEWAY):
        return addresses
    return sorted({*addresses, TOOL_ADDRESS, NULL_ADDRESS})


def _addressed(group: FrameLayout[Any]) -> bool:
    return group.pgn >> 8 & 0xFF < 240


def _node(address: int) -> str:
    return f"address_{address}"


def _definition(
    group: FrameLayout[Any], name: str, destination: int, source: int, sender: str
) -> Definition:
    assert len(name) <= NAME_MAX, name
    identifier = Identifier(group.priority, group.pgn, destination, source).pack()
    return Definition(group, name, identifier, sender)


def signals_of_groups(one_list: bool = False) -> dict[FrameLayout[Any], list[Signal]]:
    """The signals of each group. `one_list`: for formats with one list of signals for all frames, a name
    that means different things in different groups gets the name of the group added.
    """
    found = {group: group.signals() for group in GROUPS}
    if not one_list:
        return found
    kinds: dict[str, set[Signal]] = {}
    for signals in found.values():
        for signal in signals:
            kinds.setdefault(signal.name, set()).add(signal._replace(start=0, meaning=""))
    return {
        group: [
            each._replace(name=f"{each.name}_{group.name.lower()}")
            if len(kinds[each.name]) > 1
            else each
            for each in signals
        ]
        for group, signals in found.items()
    }


def nodes_of(addresses: Sequence[int]) -> Sequence[str]:
    """The senders of `definitions`."""
    return [_node(each) for each in sorted({*addresses, TOOL_ADDRESS})] if addresses else NODES


def comment_of(group: FrameLayout[Any]) -> str:
    """The first paragraph of what the code says about a frame."""
    return " ".join((group.kind.__doc__ or "").split("\n\n", 1)[0].split())
