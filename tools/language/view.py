"""The fleet as it is now: from what a listener has heard, or from what one peer tells."""

from agent.peer.fleet_summary import FleetSummary
from protocol.frames.fleet_frames import NOWHERE_M
from tools.inspect.inspector import SILENT_S, Inspector
from tools.language.fleet_state import FleetNow, RobotNow, SectionNow


def as_heard(inspector: Inspector) -> FleetNow:
    """What a listener knows, without robots that have left the fleet. A robot is silent if it was
    not heard for `SILENT_S`."""
    robots = {}
    for slot, seen in inspector.robots.items():
        if seen.left:
            continue
        age_s = inspector.now_s - seen.last_s
        sections = tuple(f"S{s}" for s in sorted(inspector.allocation.assigned_sections(slot)))
        robots[slot] = RobotNow(
            slot, seen.state, round(seen.x_m, 2), round(seen.y_m, 2), round(seen.speed_m_s, 2),
            seen.stopped, seen.started, age_s > SILENT_S, seen.question, seen.goal, sections,
            round(age_s, 1), seen.battery, seen.placed and seen.has_place,
        )  # fmt: skip
    sections_now = {
        section: SectionNow(
            inspector.allocation.phase_of(section).name, inspector.allocation.owner_of(section)
        )
        for section in inspector.allocation.sections()
    }
    return FleetNow(robots, sections_now)


def as_told(bulletin: FleetSummary) -> FleetNow:
    """What it does not tell, as questions of others to their operators, is taken as not being."""
    robots: dict[int, RobotNow] = {}
    sections: dict[int, SectionNow] = {}
    for line in bulletin.lines:
        if line.standing == "LEFT":
            continue
        sections |= {section: SectionNow("CLAIMED", line.slot) for section in line.sections}
        robots[line.slot] = RobotNow(
            line.slot, line.state.name, line.x_m, line.y_m, line.speed_m_s,
            stopped=line.state.name == "EMERGENCY_STOP", silent=line.standing != "LIVE",
            sections=tuple(f"S{section}" for section in line.sections), heard_s=line.age_s,
            placed=line.x_m > NOWHERE_M,
        )  # fmt: skip
    return FleetNow(robots, sections, f"robot {bulletin.by}")
