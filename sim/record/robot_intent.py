"""The intent of one robot, read from its peer: for observers, never for other robots.

A listener on the bus knows where robots are and what they own. Only the robots know where they want
to drive, which robots they avoid and which they receive. Reading this changes nothing, so an
observed run has the same trace hash as an unobserved one.
"""

from typing import TYPE_CHECKING, Any, NamedTuple

from agent.interface.config import NEIGHBOURS_MAX
from agent.interface.geometry import Point

if TYPE_CHECKING:
    from agent.peer.peer import Peer

POINTS_MAX = 48  # of a path: enough for a person, and it fits a datagram
STRANGE_MAX = 16


class Intent(NamedTuple):
    """One robot, at one time. SI units, field frame."""

    slot: int
    x_m: float
    y_m: float
    heading_rad: float
    vx_m_s: float
    vy_m_s: float
    wanted: Point  # velocity that its mission wants, before avoidance and safety
    path: tuple[Point, ...]  # the rest of its path, nearest point first
    avoids: tuple[int, ...]  # the robots that ORCA keeps clear of, nearest first
    hears: tuple[int, ...]  # the members that it considers live, itself included
    strange: tuple[Point, ...]  # obstacles that it sees and that are not announced
    holds: tuple[str, ...]  # the causes for which it may not move
    tool: bool  # it wants its implement down

    def to_dict(self) -> dict[str, Any]:
        """Plain values, rounded to visible precision."""
        return {
            "slot": self.slot, "x": round(self.x_m, 3), "y": round(self.y_m, 3),
            "heading": round(self.heading_rad, 3), "vx": round(self.vx_m_s, 3),
            "vy": round(self.vy_m_s, 3), "wanted": [round(v, 2) for v in self.wanted],
            "path": [[round(x, 2), round(y, 2)] for x, y in self.path],
            "avoids": list(self.avoids), "hears": list(self.hears),
            "strange": [[round(x, 2), round(y, 2)] for x, y in self.strange],
            "holds": list(self.holds), "tool": self.tool,
        }  # fmt: skip


def intent_of(peer: "Peer") -> Intent | None:
    """None before the first observation of its sensors."""
    from agent.motion.holonomic_motion import HolonomicMotion  # a tool that listens has no numpy

    here = peer.here
    # No robot is avoided on a grid.
    motion = peer.motion if isinstance(peer.motion, HolonomicMotion) else None
    if here is None:
        return None
    others = sorted(motion.others, key=lambda o: o.distance_m) if motion is not None else []
    strange: list[Point] = [] if motion is None else list(motion.strange)
    if motion is not None and motion.lookout is not None:
        strange += [point for point, _ in motion.lookout.points.values()]
    way = () if peer.mission is None else peer.mission.remaining_path
    return Intent(
        slot=peer.slot,
        x_m=here.x_m,
        y_m=here.y_m,
        heading_rad=here.heading_rad,
        vx_m_s=here.vx_m_s,
        vy_m_s=here.vy_m_s,
        wanted=(peer.wish.vx_m_s, peer.wish.vy_m_s),
        path=tuple(way[:POINTS_MAX]),
        avoids=tuple(o.slot for o in others[:NEIGHBOURS_MAX]),
        hears=tuple(sorted(peer.membership.live)),
        strange=tuple(strange[:STRANGE_MAX]),
        holds=tuple(cause.name for cause, _ in peer.safety.causes),
        tool=peer.wish.tool_on,
    )
