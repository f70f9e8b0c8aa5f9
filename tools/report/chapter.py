"""The chapters of a report: a picture, a short table, all values as CSV; or why there is none."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from datetime import UTC, datetime
from math import isfinite
from statistics import median
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from sim.record.recording import Recording
from sim.record.scene import Scene
from tools.common.release_records import records_or_none
from tools.inspect.inspector import NO_KEYS
from tools.report import figures as drawing
from tools.report.run_data import RunEvidence
from tools.report.timeline import SILENT, History, Stop, TimelineEvent

if TYPE_CHECKING:
    from tools.report.tracking_error import Following

ROWS_MAX = 40  # most rows of a table on the page; the CSV has them all
Table = tuple[Sequence[str], Sequence[Sequence[Any]]]  # head, rows


# Of the values of chapters: the same in a run that has none of them.
COLUMNS: Final[Mapping[str, tuple[str, ...]]] = {
    "tracks": ("robot", "t_s", "x_m", "y_m", "speed_m_s", "stopped"),
    "planned": (
        "robot", "RMSE, m", "implement down, m", "implement up, m", "worst, m", "samples", "ways",
    ),
    "errors": ("robot", "t_s", "x_m", "y_m", "off_m", "implement_down"),
    "sections": ("section", "phase", "owner", "from_s", "until_s"),
    "states": ("robot", "state", "from_s", "until_s"),
    "stops": ("dot", "t_s", "by", "reason", "robot", "echo_s", "stopped_s", "stands_s"),
    "events": ("t_s", "kind", "who", "what"),
}  # fmt: skip


class Chapter(NamedTuple):
    """One chapter of a report, or the reason why it is missing."""

    name: str  # of its files
    title: str
    about: str
    picture: drawing.Drawn | None = None
    table: Table | None = None  # on the page
    values: Table | None = None  # in the CSV; COLUMNS has their names where there is none
    missing: str = ""  # why there is nothing to see
    warning: str = ""  # in red


# As `planned_chapters`, but of somebody who is told early and asked for the chapters later.
Planned = Callable[[Scene | None, int], Callable[[], Iterable[Chapter]]]


def chapters(evidence: RunEvidence, planned: Planned | None = None) -> Iterator[Chapter]:
    """Every chapter that this evidence has something for, in the order of the page.

    `planned`: gives the chapters of planned ways, from elsewhere than the intents of the evidence.
    """
    recording = evidence.recording
    if recording is None:
        yield Chapter("frames", "The run", "", missing="A campaign keeps verdicts and no frames: run "
                      "its reproduction with headland run, and report that.")  # fmt: skip
        yield _campaign(evidence)
        return
    scene, zero_at_us = recording.scene, evidence.zero_at_us
    begun = None if planned is None else planned(scene, zero_at_us)
    history = History(zero_at_us).hear_all(recording)
    faults = _faults(evidence)
    told = sorted([*faults, *history.seen], key=lambda event: event.t_s)
    marks = [event for event in told if drawing.is_mark(event)]
    bitrate = (scene or {}).get("bitrate", history.load.bitrate)
    events = _events(evidence, faults, history)
    if history.keyed is False and "authenticated" not in evidence.figures:
        events = events._replace(warning=NO_KEYS)
    yield events
    yield _sections(history, told)
    yield _stops(history)
    yield from _releases(evidence)
    yield _tracks(scene, history)
    yield from planned_chapters(recording, scene, zero_at_us) if begun is None else begun()
    yield _load(history, bitrate if isinstance(bitrate, int) and bitrate > 0 else 250_000, marks)
    yield _states(history, marks)


def _faults(evidence: RunEvidence) -> list[TimelineEvent]:
    found = []
    for fault in evidence.faults or []:
        rest = {k: v for k, v in fault.items() if k not in ("t_s", "kind", "robot")}
        robot = f"robot {fault['robot']}" if "robot" in fault else ""
        what = ", ".join(f"{key} {value}" for key, value in rest.items())
        found.append(
            TimelineEvent(float(fault["t_s"]), f"fault: {fault.get('kind', '?')}", robot, what)
        )
    return found


def _drawn(draw: Any, scene: Scene | None, *what: Any) -> drawing.Drawn:
    """Over its ground; without one where the scene cannot be read."""
    try:
        found: drawing.Drawn = draw(scene, *what)
    except (KeyError, TypeError, ValueError, IndexError, AttributeError, OverflowError):
        found = draw(None, *what)
    return found


def _tracks(scene: Scene | None, history: History) -> Chapter:
    title, about = (
        "Tracks",
        "Where each robot said that it was, to 5 cm; the disc is its last place.",
    )
    if not history.places:
        return Chapter("tracks", title, about, missing="No robot has said where it is.")
    rows = [
        (slot, round(p.t_s, 3), round(p.x_m, 2), round(p.y_m, 2), round(p.speed_m_s, 2), int(p.stopped))
        for slot, track in sorted(history.places.items()) for p in track
    ]  # fmt: skip
    return Chapter("tracks", title, about, _drawn(drawing.tracks, scene, history.places),
                   values=(COLUMNS["tracks"], rows))  # fmt: skip


def planned_chapters(
    recording: Recording, scene: Scene | None, zero_at_us: int
) -> Iterator[Chapter]:
    """What robots meant to drive, and how they kept to it."""
    robots: list[Following] = []
    if recording.intents:
        from tools.report.tracking_error import followed  # numpy, which nothing else here needs

        robots = followed(recording.intents, zero_at_us)
    title = "Planned against executed"
    about = (
        "Dotted: the ways that the robots planned. Solid: where they drove on them. The error is the "
        "distance to the line followed at that moment, five times a second, while moving; giving way "
        "to others counts as error. "
    )
    if not any(robot.samples for robot in robots):
        yield Chapter("planned", title, about, missing="Planned ways go beside the bus, into run.mcap "
                      "(headland[operator]); this recording has none.")  # fmt: skip
        return
    head = COLUMNS["planned"]
    values = [
        (r.slot, _metres(r.rmse_m()), _metres(r.rmse_m(True)), _metres(r.rmse_m(False)),
         _metres(r.worst_m), len(r.samples), len(r.lines))
        for r in robots
    ]  # fmt: skip
    table = [tuple(_said(value) for value in row) for row in values]
    yield Chapter("planned", title, about, _drawn(drawing.planned, scene, robots), (head, table),
                  (head, values))  # fmt: skip
    rows = [
        (r.slot, round(s.t_s, 3), round(s.x_m, 3), round(s.y_m, 3), round(s.off_m, 4), int(s.tool))
        for r in robots for s in r.samples
    ]  # fmt: skip
    yield Chapter("errors", "The same over time", "", drawing.errors(robots),
                  values=(COLUMNS["errors"], rows))  # fmt: skip


def _metres(value: float) -> float | None:
    """None where there is none: an empty cell of a CSV, and NaN of a data frame."""
    return round(value, 3) if isfinite(value) else None


def _said(value: float | None) -> str:
    if value is None:
        return "-"
    return f"{value:.3f}" if isinstance(value, float) else str(value)


def _sections(history: History, events: Sequence[TimelineEvent]) -> Chapter:
    title = "Events and sections over time"
    about = (
        "Above, what happened. Below, a row for each section (goals of errands and frontiers of a map "
        "are sections, too), in the owner's colour: pale claimed, full begun, faint done. Red lines are "
        "faults, stops and resets."
    )
    if not history.held:
        return Chapter("sections", title, about, missing="No section was claimed.")
    shown = len({span.subject for span in history.held})
    if shown > drawing.ROWS_MAX:
        about += f" The first {drawing.ROWS_MAX} of {shown} are drawn."
    rows = [
        (f"S{s.subject}", s.what, s.owner, round(s.from_s, 3), round(s.until_s, 3))
        for s in history.held
    ]  # fmt: skip
    owners: dict[int, list[float]] = {}
    for span in history.held:
        if span.owner is not None and span.what == "STARTED":
            owners.setdefault(span.owner, []).append(span.until_s - span.from_s)
    table = [(slot, len(spans), f"{sum(spans):.1f}") for slot, spans in sorted(owners.items())]
    picture = drawing.gantt(history.held, history.now_s, events)
    return Chapter("sections", title, about, picture, (("robot", "begun", "at work, s"), table),
                   (("section", "phase", "owner", "from_s", "until_s"), rows))  # fmt: skip


def _load(history: History, bitrate: int, marks: Sequence[TimelineEvent]) -> Chapter:
    width_s, bins = history.bins(drawing.BINS)
    about = (
        f"At worst-case stuffing, of {bitrate} bit/s, {width_s} s a step, by kind of frame. "
        f"A dotted line, where there is one, is {drawing.FULL:.0%}."
    )
    kinds = sorted({kind for _, bits in bins for kind in bits})
    rows = [
        (second, *(round(bits[kind] / (width_s * bitrate), 5) for kind in kinds),
         round(bits.total() / (width_s * bitrate), 5)) for second, bits in bins
    ]  # fmt: skip
    shares = [bits.total() / (width_s * bitrate) for _, bits in bins]
    table = [(f"{median(shares):.1%}", f"{max(shares):.1%}", sum(history.malformed.values()))]
    picture = drawing.load(width_s, bins, bitrate, marks)
    return Chapter("load", "Bus load", about, picture,
                   (("median", "most", "frames that nobody can read"), table),
                   (("t_s", *kinds, "all"), rows))  # fmt: skip


def _states(history: History, marks: Sequence[TimelineEvent]) -> Chapter:
    about = "As each robot's beat said it. Grey: nothing was heard of it for more than a second."
    if not history.states:
        return Chapter("states", "States", about, missing="No robot has said its state.")
    rows = [
        (s.subject, s.what, round(s.from_s, 3), round(s.until_s, 3)) for s in history.states
    ]  # fmt: skip
    names = [n for n in drawing.STATES if any(s.what == n for s in history.states)]
    table = []
    for slot in sorted({s.subject for s in history.states}):
        sums = dict.fromkeys(names, 0.0)
        for span in history.states:
            if span.subject == slot:
                sums[span.what] = sums.get(span.what, 0.0) + span.until_s - span.from_s
        table.append((slot, *(f"{sums[name]:.1f}" for name in names)))
    head = ("robot", *(f"{name.lower()}, s" for name in names))
    picture = drawing.states(history.states, history.now_s, marks)
    return Chapter("states", "States", about, picture, (head, table),
                   (COLUMNS["states"], rows))  # fmt: skip


def _stops(history: History) -> Chapter:
    about = (
        "From the first frame of each press, as it was heard on the bus: when each robot that was there "
        "said it again, when its beat said that it is stopped, when that beat had no speed left. Beats "
        "come each 50 to 100 ms, so that much of the last two is waiting for the beat."
    )
    if not history.pressed:
        return Chapter("stops", "Stops", about, missing="Nobody pressed a stop.")
    head = ("at, s", "by", "reason", "robots", "last echo, ms", "all say stopped, ms", "all stand, ms",
            "cleared at, s")  # fmt: skip
    table = [
        (f"{s.t_s:.3f}", s.by, s.reason, len(s.present), _last(s, s.echo_s), _last(s, s.latch_s),
         _last(s, s.still_s), "-" if s.cleared_s is None else f"{s.cleared_s:.3f}")
        for s in history.pressed
    ]  # fmt: skip
    rows = [
        (".".join(map(str, s.dot)), round(s.t_s, 6), s.by, s.reason, slot,
         *(round(of[slot], 6) if slot in of else None for of in (s.echo_s, s.latch_s, s.still_s)))
        for s in history.pressed for slot in s.present
    ]  # fmt: skip
    return Chapter("stops", "Stops", about, drawing.latencies(history.pressed),
                   (head, table), (COLUMNS["stops"], rows))  # fmt: skip


def _releases(evidence: RunEvidence) -> Iterator[Chapter]:
    source = evidence.source
    records = records_or_none(source if source.is_dir() else source.parent)
    if records is None:
        return
    about = (
        "What let each robot drive again, and under whose key, as it wrote it down. "
        + ("Hashes and tags were checked." if records.root else "Hashes were checked; no key is here.")
    )  # fmt: skip
    about += "".join(f" Robot {r}: CHANGED: {why}." for r, why in records.broken.items())
    about += "".join(f" Robot {r}: NOT PROVEN: it had no key of its own." for r in records.shared)
    rows = [
        (datetime.fromtimestamp(r.released_at_s, UTC).isoformat(timespec="milliseconds"), r.robot, r.what,
         records.who(r.device))
        for one in records.logs for r in one.releases
    ]  # fmt: skip
    rows.sort()
    head = ("at, UTC", "robot", "what", "by")
    yield Chapter("releases", "Releases", about, None, (head, rows[:ROWS_MAX]), (head, rows))


def _last(stop: Stop, times_s: dict[int, float]) -> str:
    if not times_s:
        return "-" if not stop.present else f"nobody of {len(stop.present)}"
    lacks = len(stop.present) - len(times_s)
    return f"{max(times_s.values()) * 1e3:.1f}" + (f" (without {lacks})" if lacks else "")


def _events(evidence: RunEvidence, faults: Sequence[TimelineEvent], history: History) -> Chapter:
    told = sorted([*faults, *history.seen], key=lambda event: event.t_s)
    rows = [(round(e.t_s, 3), e.kind, e.who, e.what) for e in told]
    table = [(f"{t_s:.3f}", *rest) for t_s, *rest in rows]
    about = (
        "Faults that were done to it, and what the bus showed: silences, stops, orders, questions."
    )
    if evidence.faults is None:
        about += (
            " What was done to it is not known here: only headland run writes it into report.json."
        )
    elif not faults:
        about += " Nothing was done to it."
    silent = {s.subject for s in history.states if s.what == SILENT}
    if silent:
        about += f" Silent for a while: robots {', '.join(map(str, sorted(silent)))}."
    if not rows:
        return Chapter("events", "Chaos and other events", about, missing="Nothing happened.")
    head = ("t, s", "what", "who", "")
    return Chapter("events", "Chaos and other events", about, table=(head, table),
                   values=(COLUMNS["events"], rows))  # fmt: skip


def _campaign(evidence: RunEvidence) -> Chapter:
    told = evidence.campaign
    broken = [b for b in told.get("broken", []) if isinstance(b, dict)]
    rows = [tuple(b.get(key, "") for key in ("seed", "rule", "t_s", "what")) for b in broken]
    faults = told.get("faults")
    kinds = faults if isinstance(faults, dict) else {}
    injected = ", ".join(f"{count} {kind}" for kind, count in kinds.items())
    about = (
        f"{told.get('runs')} runs, {told.get('robot_hours')} robot-hours, hash {told.get('hash')}. "
        f"Injected: {injected or 'nothing'}. Reproduction: {told.get('reproduction') or 'none needed'}."
    )
    if not rows:
        return Chapter("chaos", "Chaos", about, missing="Every rule was kept.")
    head = ("seed", "rule", "t_s", "what")
    return Chapter("chaos", "Chaos", about, table=(head, rows), values=(head, rows))
