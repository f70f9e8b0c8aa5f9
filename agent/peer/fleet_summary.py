"""What one peer knows of the fleet, as a text that any peer tells when it is asked.

A question to everybody is answered by the elected leader (`agent/peer/leader_election.py`), so
that one text comes and not thirty. Nothing depends on it: without an answer the same question goes
to any other peer.

    by 2 sections 14 done 9
    0 WORKING LIVE 12.3 -4.5 0.8 S3,S4 0.1
    1 EMERGENCY_STOP LIVE 3.0 2.2 0.0 - 0.0

A line for each member: slot, state, standing, metres east and north, m/s, sections it holds, seconds
since it was heard. A transport session carries 1,785 bytes: about 30 members; further ones are only
counted (`more 12`), and another peer knows no more.
"""

from math import isfinite
from typing import TYPE_CHECKING, NamedTuple

from agent.interface.config import S
from agent.interface.lifecycle import State
from crdt import Phase
from protocol.transport import SIZE_MAX

if TYPE_CHECKING:
    from agent.peer.peer import Peer

BULLETIN_PGN = 0xFF1E  # our own: the fleet, as one peer sees it
MORE = "more 999"  # room kept for the count of those left out


class MemberRow(NamedTuple):
    """One member. Of members never heard there is none."""

    slot: int
    state: State
    standing: str  # a name of membership.Standing
    x_m: float
    y_m: float
    speed_m_s: float
    sections: tuple[int, ...]
    age_s: float


class FleetSummary(NamedTuple):
    by: int
    sections: int  # heard of
    done: int
    lines: tuple[MemberRow, ...]
    more: int = 0  # members for whom there was no room


def offer(peer: "Peer") -> None:
    """From now on this peer tells a device that asks it, and as the leader one that asks everybody."""
    peer.letters.answer(
        BULLETIN_PGN, lambda now_us: write(compose(peer, now_us)), lambda: peer.leads
    )


def compose(peer: "Peer", now_us: int) -> FleetSummary:
    """As this peer knows it."""
    held: dict[int, list[int]] = {}
    for section in peer.allocation.sections():
        claim = peer.allocation.entry(section)
        if claim.phase in (Phase.CLAIMED, Phase.STARTED):
            held.setdefault(claim.owner, []).append(section)
    lines = []
    for slot in sorted({peer.slot, *peer.membership.neighbours}):
        sections = tuple(held.get(slot, ()))
        if slot != peer.slot:
            pose, heard_us = peer.membership.neighbours[slot]
            lines.append(
                MemberRow(
                    slot, State(pose.state), peer.membership.standing[slot].name, pose.x_m, pose.y_m,
                    pose.speed_m_s, sections, (now_us - heard_us) / S,
                )
            )  # fmt: skip
        elif (here := peer.here) is not None:
            speed_m_s = (here.vx_m_s**2 + here.vy_m_s**2) ** 0.5
            lines.append(
                MemberRow(slot, peer.state, "LIVE", here.x_m, here.y_m, speed_m_s, sections, 0.0)
            )
    allocation = peer.allocation
    return FleetSummary(
        peer.slot, len(allocation.sections()), allocation.done_count(), tuple(lines)
    )


def write(bulletin: FleetSummary) -> str:
    """At most what a transport session carries."""
    text = f"by {bulletin.by} sections {bulletin.sections} done {bulletin.done}"
    for number, m in enumerate(bulletin.lines):
        sections = ",".join(f"S{section}" for section in m.sections) or "-"
        line = (
            f"\n{m.slot} {m.state.name} {m.standing} {m.x_m:.1f} {m.y_m:.1f} {m.speed_m_s:.1f} "
            f"{sections} {m.age_s:.1f}"
        )
        if len(text) + len(line) + 1 + len(MORE) > SIZE_MAX:
            return f"{text}\nmore {len(bulletin.lines) - number + bulletin.more}"
        text += line
    return text + (f"\nmore {bulletin.more}" if bulletin.more else "")


def read(text: str) -> FleetSummary | None:
    """None for what is no bulletin: it came over a wire.

    >>> read("by 2 sections 3 done 1\\n0 IDLE LIVE 1.5 -2.0 0.0 S2 0.1").lines[0].sections
    (2,)
    """
    try:
        head, *rest = text.strip().splitlines()
        word, by, named, sections, completed, done = head.split()
        if (word, named, completed) != ("by", "sections", "done"):
            return None
        more = int(rest.pop().split()[1]) if rest and rest[-1].startswith("more ") else 0
        return FleetSummary(int(by), int(sections), int(done), tuple(map(_line, rest)), more)
    except (ValueError, KeyError, IndexError):
        return None


def _line(text: str) -> MemberRow:
    slot, state, standing, x_m, y_m, speed_m_s, sections, age_s = text.split()
    x, y, speed, age = (float(part) for part in (x_m, y_m, speed_m_s, age_s))
    if not all(map(isfinite, (x, y, speed, age))):
        raise ValueError
    named = () if sections == "-" else tuple(int(s.lstrip("S")) for s in sections.split(","))
    return MemberRow(int(slot), State[state], standing, x, y, speed, named, age)
