"""What one peer knows about the fleet, as a text that any peer sends on request.

A global request is answered by the elected leader only (`agent/peer/leader_election.py`), so that
one text is sent and not thirty. Nothing depends on it: without an answer the requester asks any
other peer.

    by 2 sections 14 done 9
    0 WORKING LIVE 12.3 -4.5 0.8 S3,S4 0.1
    1 EMERGENCY_STOP LIVE 3.0 2.2 0.0 - 0.0

A line for each member: slot, state, membership status, metres east and north, m/s, sections it
holds, seconds since its last pose. A transport session carries 1,785 bytes, about 30 members.
Further members are only counted (`more 12`), and no other peer can list more.
"""

from math import isfinite
from typing import NamedTuple

from agent.interface.config import S
from agent.interface.lifecycle import State
from agent.peer.membership import Membership
from agent.peer.part import StepContext
from crdt import FieldAllocationCRDT, Phase
from protocol.transport import SIZE_MAX

FLEET_SUMMARY_PGN = 0xFF1E  # our own group: the fleet as one peer sees it
MORE = "more 999"  # room kept for the count of omitted members


class MemberRow(NamedTuple):
    """One member. Members that were never received have no row."""

    slot: int
    state: State
    standing: str  # a name of membership.MemberStatus
    x_m: float
    y_m: float
    speed_m_s: float
    sections: tuple[int, ...]
    age_s: float


class FleetSummary(NamedTuple):
    """The fleet as one peer sees it. `by`: its slot. `done`: number of finished sections."""

    by: int
    sections: int  # number of known sections
    done: int
    lines: tuple[MemberRow, ...]
    more: int = 0  # members that did not fit


def compose(
    ctx: StepContext, membership: Membership, allocation: FieldAllocationCRDT
) -> FleetSummary:
    """The summary of what this peer knows."""
    held: dict[int, list[int]] = {}
    for section in allocation.sections():
        claim = allocation.entry(section)
        if claim.phase in (Phase.CLAIMED, Phase.STARTED):
            held.setdefault(claim.owner, []).append(section)
    lines = []
    for slot in sorted({ctx.slot, *membership.neighbours}):
        sections = tuple(held.get(slot, ()))
        if slot != ctx.slot:
            pose, heard_at_us = membership.neighbours[slot]
            lines.append(
                MemberRow(
                    slot, State(pose.state), membership.standing[slot].name, pose.x_m, pose.y_m,
                    pose.speed_m_s, sections, (ctx.now_us - heard_at_us) / S,
                )
            )  # fmt: skip
        elif (here := ctx.here) is not None:
            speed_m_s = (here.vx_m_s**2 + here.vy_m_s**2) ** 0.5
            lines.append(
                MemberRow(slot, ctx.state, "LIVE", here.x_m, here.y_m, speed_m_s, sections, 0.0)
            )
    return FleetSummary(ctx.slot, len(allocation.sections()), allocation.done_count(), tuple(lines))


def write(bulletin: FleetSummary) -> str:
    """The text of a summary, cut to what a transport session carries."""
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
    """Parse a text from the wire; None if it is not a summary.

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
