"""Answers to questions, in words and as values, from one view of the fleet."""

from collections.abc import Sequence
from typing import Any, NamedTuple

from agent.interface.geometry import Point
from tools.language.fleet_state import FleetNow, RobotNow
from tools.language.intent import At, Beside, Query
from tools.language.places import Places

NO_PLACE = "it does not know where it is"


class Answer(NamedTuple):
    """The same answer for a person and for a program."""

    text: str
    value: Any


def answer(query: Query, fleet: FleetNow, places: Places, queued: Sequence[str]) -> Answer:
    """`queued`: names of the places that wait for an idle robot."""
    if isinstance(query.place, Beside) and not fleet.robots[query.place.robot].placed:
        return Answer(f"robot {query.place.robot}: {NO_PLACE}", None)
    match query.ask:
        case "status":
            return _lines(query, fleet, _status)
        case "position":
            if query.place is not None:
                x_m, y_m = _point(query, fleet, places)
                return Answer(f"{query.place} is at {x_m:g}, {y_m:g}", [x_m, y_m])
            return _lines(query, fleet, _position)
        case "nearest":
            return _nearest(query, fleet, places)
        case "stopped":
            slots = [r.slot for r in fleet.live if r.stopped]
            return Answer(_listed(slots, "stopped"), slots)
        case "idle":
            slots = [r.slot for r in fleet.live if r.idle]
            return Answer(_listed(slots, "idle"), slots)
        case "section":
            return _section(query, fleet)
        case "battery":
            return _lines(query, fleet, _battery)
        case "distance":
            place = _point(query, fleet, places)
            return _lines(query, fleet, lambda robot: _distance(robot, place))
        case "progress":
            return _progress(fleet, places)
        case "finished":
            done = _finished(fleet)
            return Answer(", ".join(f"S{s}" for s in done) or "no section is done", done)
        case "queue":
            text = "; ".join(f"{n}. {name}" for n, name in enumerate(queued, 1))
            return Answer(text or "nothing is queued", list(queued))
        case "places":
            points = {name: places.points[name] for name in places.named}
            text = ", ".join(f"{name} ({x:g}, {y:g})" for name, (x, y) in points.items())
            return Answer(text or "no place has a name", {n: list(p) for n, p in points.items()})


def _lines(query: Query, fleet: FleetNow, line: Any) -> Answer:
    slots = sorted(fleet.robots) if query.robots == "all" else query.robots
    robots = [fleet.robots[slot] for slot in slots]
    text = "\n".join(line(robot) for robot in robots) or "no robot is heard"
    return Answer(text, [robot._asdict() for robot in robots])


def _position(robot: RobotNow) -> str:
    if not robot.placed:
        return f"robot {robot.slot}: {NO_PLACE}"
    was = f", when last heard {robot.heard_s:.0f} s ago" if robot.silent else ""
    return f"robot {robot.slot} is at {robot.x_m:.1f}, {robot.y_m:.1f}{was}"


def _status(robot: RobotNow) -> str:
    if robot.silent:
        return f"robot {robot.slot}: silent for {robot.heard_s:.0f} s"
    parts = [robot.state]
    if robot.sections:
        parts.append("works " + " ".join(robot.sections))
    if robot.goal is not None:
        parts.append(f"is sent to {robot.goal[0]:.1f}, {robot.goal[1]:.1f}")
    if robot.asking:
        parts.append(f"asks (question {robot.asking}) what to do about something in its way")
    if not robot.started:
        parts.append("stands until it is started")
    at = f"at {robot.x_m:.1f}, {robot.y_m:.1f}, {robot.speed_m_s:.1f} m/s"
    parts.append(at if robot.placed else NO_PLACE)
    return f"robot {robot.slot}: " + "; ".join(parts)


def _battery(robot: RobotNow) -> str:
    told = "tells of no battery" if robot.battery is None else f"{100 * robot.battery:.0f} %"
    return f"robot {robot.slot}: {told}"


def _distance(robot: RobotNow, place: Point) -> str:
    if not robot.placed:
        return f"robot {robot.slot}: {NO_PLACE}"
    return f"robot {robot.slot} is {robot.away_m(place):.1f} m away, as the crow flies"


def _finished(fleet: FleetNow) -> list[int]:
    return sorted(n for n, section in fleet.sections.items() if section.phase == "DONE")


def _progress(fleet: FleetNow, places: Places) -> Answer:
    """Sections of the places file and those that were reported on the bus."""
    told = {f"S{n}" for n in fleet.sections} | {n for n in places.points if n not in places.named}
    done, begun = _finished(fleet), [s for s in fleet.sections.values() if s.phase == "STARTED"]
    value = {"sections": len(told), "done": len(done), "begun": len(begun)}
    if not told:
        return Answer("nothing is known of any section", value)
    return Answer(f"{len(done)} of {len(told)} sections are done, {len(begun)} are begun", value)


def _nearest(query: Query, fleet: FleetNow, places: Places) -> Answer:
    place = _point(query, fleet, places)
    there = query.place.robot if isinstance(query.place, Beside) else None  # it is not near itself
    others = [robot for robot in fleet.live if robot.slot != there]
    robots = sorted((r for r in others if r.placed), key=lambda r: (r.away_m(place), r.slot))
    if not robots:
        which = "other " if there is not None else ""
        return Answer(f"no {which}robot {'that knows its place ' if others else ''}is heard", None)
    first, idle = robots[0], fleet.nearest(place, frozenset(() if there is None else (there,)))
    text = f"robot {first.slot}, {first.away_m(place):.1f} m away ({first.state})"
    if idle is None:
        text += "; no robot is idle"
    elif idle.slot != first.slot:
        text += f"; of the idle ones robot {idle.slot}, {idle.away_m(place):.1f} m"
    value = {"robot": first.slot, "idle": None if idle is None else idle.slot}
    return Answer(text, value)


def _section(query: Query, fleet: FleetNow) -> Answer:
    section = fleet.sections.get(query.section if query.section is not None else -1)
    if section is None:
        return Answer(f"nothing is known of S{query.section}", None)
    who = "nobody" if section.owner is None else f"robot {section.owner}"
    text = f"S{query.section} is {section.phase}, by {who}"
    return Answer(f"{text} (why: headland inspect --why S{query.section})", section._asdict())


def _point(query: Query, fleet: FleetNow, places: Places) -> Point:
    match query.place:
        case At():
            return query.place.x_m, query.place.y_m
        case Beside():
            robot = fleet.robots[query.place.robot]
            return robot.x_m, robot.y_m
        case name:
            assert name is not None, "weighed before"
            return places.points[name]


def _listed(slots: Sequence[int], what: str) -> str:
    return f"{what}: {', '.join(map(str, slots))}" if slots else f"no robot is {what}"
