"""What a run left behind: its frames and intents, its figures, and the faults that were done to it."""

from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

from agent.interface.config import S
from agent.runtime.files.given_file import REPORT_BYTES_MAX, GivenFileError, read_json
from sim.record.recording import Recording
from tools.inspect.log_frames import SourceError
from tools.livemap.command import recorded

REPORT, CAMPAIGN = "report.json", "chaos.json"


class RunEvidence(NamedTuple):
    """All that a run, a launch, a log or a campaign left behind."""

    source: Path
    recording: Recording | None  # none: a campaign, which keeps verdicts and no frames
    figures: dict[str, Any]  # of report.json; empty: there is none
    campaign: dict[str, Any]  # of chaos.json
    zero_at_us: int  # when the run began, on the clock of its frames

    @property
    def name(self) -> str:
        """What the page is called: the scenario, else the scene, the profile, or the file."""
        scene = None if self.recording is None else self.recording.scene
        told = self.figures.get("scenario") or (scene or {}).get("name")
        if told is None and self.campaign:
            told = f"chaos, profile {self.campaign.get('profile')}"
        return str(told or self.source.name or self.source)

    @property
    def about(self) -> str:
        """What a reader of many reports tells this one by: how many robots, how long, and which day."""
        told = []
        for key, one, more in (("robots", "1 robot", "{} robots"), ("seed", "seed 1", "seed {}")):
            value = self.figures.get(key)
            if isinstance(value, int) and not isinstance(value, bool):
                told.append(one if value == 1 else more.format(value))
        if self.recording is not None and self.recording.count:
            whole_s = (self.recording.end_at_us - self.zero_at_us) // S
            told.append(f"{whole_s // 60}:{whole_s % 60:02} on the bus")
        try:
            written = datetime.fromtimestamp(self.source.stat().st_mtime, UTC)
            told.append(f"{written:%Y-%m-%d %H:%M} UTC")
        except OSError:
            pass  # gone since
        return ", ".join(told)

    @property
    def faults(self) -> list[dict[str, Any]] | None:
        """Each with `t_s` and `kind`; None where the run did not keep them."""
        faults = self.figures.get("faults")
        if not isinstance(faults, list):
            return None
        return [f for f in faults if isinstance(f, dict) and isinstance(f.get("t_s"), int | float)]


def gather(source: Path, intents: bool = True) -> RunEvidence:
    """Of a run folder or a log; with the intents of its robots, or without. Raises SourceError and
    McapMissing."""
    folder = source if source.is_dir() else source.parent
    figures = _plain(folder / REPORT)
    campaign = _plain(source / CAMPAIGN) if source.is_dir() else {}
    logs = ("can.log", "run.mcap")
    if campaign and not any((source / log).is_file() for log in logs):
        return RunEvidence(source, None, figures, campaign, 0)
    recording = recorded(source, None, intents)
    if not recording.count:
        raise SourceError(f"{source}: there is no frame in it: not a CAN log, or nothing was said")
    # Virtual time begins at 0; a launch or a real bus has the clock of its computer.
    zero_at_us = 0 if "trace_hash" in figures else recording.begin_at_us
    return RunEvidence(source, recording, figures, campaign, zero_at_us)


def _plain(path: Path) -> dict[str, Any]:
    """What is no object of JSON is not there."""
    try:
        found = read_json(path, REPORT_BYTES_MAX)
    except GivenFileError:
        return {}
    return found if isinstance(found, dict) else {}
