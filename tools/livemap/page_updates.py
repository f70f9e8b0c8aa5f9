"""What one page is sent: everything once, then only what has changed. Plain values, as JSON."""

from typing import Any

from protocol.frames.safety_frames import Reason
from tools.inspect.inspector import SILENT_S, Seen
from tools.livemap.map_state import Watcher
from tools.livemap.playback import Player

KINDS_MAX = 8  # frames of the last second are listed by kind, most first
TRANSITIONS_TOLD = 12
# Stops that a picture names: the first ones, which a flood of forged stops does not push out, and the
# newest ones. The others are counted, because a picture of thousands of stops takes longer than its time.
FIRST_STOPS_TOLD, NEWEST_STOPS_TOLD = 8, 8


class PageUpdates:
    """Remembers what one page in a browser was sent, so that each message has only what is new."""

    def __init__(self, player: Player) -> None:
        self.player = player
        self.told = self.drawn = 0  # pictures; the page says which it has drawn
        self._jumps = -1
        self._paths: dict[int, Any] = {}
        self._things: Any = None
        self._events = 0
        self._transports: dict[int, tuple[int, int]] = {}

    def tell(self) -> dict[str, Any]:
        """The next message for the page. After a jump in time it has everything again."""
        self.told += 1
        player, watcher = self.player, self.player.watcher
        now_s = player.head_us / 1e6
        jumped = player.jumps != self._jumps
        if jumped:
            self._jumps = player.jumps
            self._paths.clear()
            self._things = None
            self._transports = {}
            watcher.all_changed()
        recording = player.recording
        told: dict[str, Any] = {
            "kind": "now", "jumped": jumped, "t": round(now_s, 3),
            "from": player.index.begin_at_us / 1e6, "until": round(recording.end_at_us / 1e6, 3),
            "ended": recording.ended, "playing": player.playing, "speed": player.speed,
            "follow": player.follow, "quiet": round(recording.quiet_for_us / 1e6, 1),
            "load": round(watcher.share, 4),
            "frames": dict(list(watcher.recent.items())[:KINDS_MAX]),
            "total": sum(watcher.recent.values()),
            "malformed": sum(watcher.malformed.values()),
            "robots": [self._robot(robot, now_s) for _, robot in sorted(watcher.robots.items())],
            "islands": watcher.islands(now_s), "stop": _stop(watcher, now_s),
            "keyed": watcher.keyed,
        }  # fmt: skip
        self._changes(watcher, told)
        return told

    def _robot(self, robot: Seen, now_s: float) -> dict[str, Any]:
        watcher = self.player.watcher
        told: dict[str, Any] = {
            "s": robot.slot, "state": robot.state, "x": round(robot.x_m, 2),
            "y": round(robot.y_m, 2), "c": round(watcher.course.get(robot.slot, 0.0), 3),
            "v": round(robot.speed_m_s, 2), "stopped": robot.stopped, "left": robot.left,
            "silent": now_s - robot.last_s > SILENT_S and not robot.left,
            "age": round(now_s - robot.last_s, 1), "started": robot.started,
        }  # fmt: skip
        if not robot.has_place:
            told["nowhere"] = True
        intent = watcher.intent(robot.slot, now_s)
        if intent is not None:
            told["h"], told["near"] = intent["heading"], intent["avoids"]
            told["vx"], told["vy"], told["want"] = intent["vx"], intent["vy"], intent["wanted"]
            told["strange"], told["holds"] = intent["strange"], intent["holds"]
            told["hears"] = intent.get("hears")  # None: a recording from before it was written
        stands = watcher.stands(robot)
        if stands:
            told["stands"] = stands
        if robot.battery is not None:
            told["battery"], told["queue"] = round(robot.battery, 2), watcher.itinerary(robot)
        question = watcher.asking.get(robot.slot)
        if question is not None:
            told["asks"] = [question.matter.name, round(question.x_m, 1), round(question.y_m, 1)]
        path = [] if intent is None else intent["path"]
        if path != self._paths.get(robot.slot):
            self._paths[robot.slot] = told["path"] = path
        return told

    def _changes(self, watcher: Watcher, told: dict[str, Any]) -> None:
        """Sections, units, cells, things and events, where there is news of them."""
        allocation, progress = watcher.allocation, watcher.progress
        if watcher.changed_sections:
            told["sections"] = [
                [section, allocation.phase_of(section).name, allocation.owner_of(section)]
                for section in sorted(watcher.changed_sections)
            ]
        if watcher.changed_blocks:
            told["units"] = [
                [section, block, f"{progress.bits(section, block):x}"]
                for section, block in sorted(watcher.changed_blocks)
            ]
        if watcher.changed_patches:
            told["cells"] = watcher.cells(sorted(watcher.changed_patches))
        watcher.changed_sections, watcher.changed_blocks = set(), set()
        watcher.changed_patches = set()
        if watcher.things is not self._things:
            self._things = told["things"] = watcher.things
        if watcher.transports != self._transports:  # also of one that was taken back
            self._transports = dict(watcher.transports)
            told["transports"] = [[task, *cells] for task, cells in watcher.transports.items()]
        index = self.player.index
        if index.noted != self._events:
            self._events = index.noted
            told["events"] = list(index.events)

    def why(self, section: int) -> dict[str, Any]:
        """How a section came to its owner, as `headland inspect --why` says it: lines for a person,
        each with its time and, behind it, what led to it."""
        steps = []
        for step in self.player.watcher.why(section):
            because = [_told(cause) for cause in step["because"]]
            steps.append([step["t_s"], step["text"], because])
        allocation = self.player.watcher.allocation
        return {
            "kind": "why", "section": section, "steps": steps[-TRANSITIONS_TOLD:],
            "phase": allocation.phase_of(section).name, "owner": allocation.owner_of(section),
        }  # fmt: skip

    def robot(self, slot: int) -> dict[str, Any] | None:
        """All that is known of one robot, as `headland inspect` shows it."""
        watcher = self.player.watcher
        robot = watcher.robots.get(slot)
        if robot is None:
            return None
        found = watcher._robot_dict(robot)
        found["transitions"] = found["transitions"][-TRANSITIONS_TOLD:]
        found["frames"] = dict(robot.frames.most_common(KINDS_MAX))
        found["health"] = robot.health
        return {"kind": "robot", **found}


def _told(heard: dict[str, Any]) -> str:
    """What was heard, with its sender where the text does not begin with it."""
    text: str = heard["text"]
    who = "a device" if heard["said_by"] is None else f"robot {heard['said_by']}"
    return text if text.startswith("robot ") else f"{who} {text}"


def _stop(watcher: Watcher, now_s: float) -> dict[str, Any]:
    """Which stops are latched, which robots stand, which do not, and of which it is not known."""
    here = [robot for robot in watcher.robots.values() if not robot.left]
    live = [robot for robot in here if now_s - robot.last_s <= SILENT_S]
    latched, held = [], watcher.latched
    first, others = held[:FIRST_STOPS_TOLD], held[FIRST_STOPS_TOLD:]
    named = first + others[-NEWEST_STOPS_TOLD:]
    for dot in named:
        reason, said_by = watcher.reasons.get(dot, (None, None))
        name = (
            "" if reason is None or reason not in Reason._value2member_map_ else Reason(reason).name
        )
        latched.append(
            {"dot": ".".join(map(str, dot)), "slot": dot[0], "reason": name, "said_by": said_by,
             "since": round(watcher.stops[dot], 3)}
        )  # fmt: skip
    standing = sorted(r.slot for r in live if r.stopped)
    return {
        "latched": latched, "more": len(held) - len(named) + watcher.latched_more,
        "stopped": standing,
        "moving": sorted(r.slot for r in live if not r.stopped),
        "silent": sorted(r.slot for r in here if now_s - r.last_s > SILENT_S),
        "implements": watcher.implements_stop is not None,
    }  # fmt: skip
