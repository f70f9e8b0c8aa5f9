"""What a run leaves for replays and viewers: one MCAP, the scene, the hash of its frames."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from agent.interface.effects import Effect
from protocol.frames.frame import Frame
from sim.files.log_parts import Limit, PartedLog
from sim.files.recording_end import Ending, say
from sim.files.strict_json import dumps
from sim.files.whole_file import write_whole
from sim.fleet.simulated_fleet import Cluster
from sim.record.mcap_log import MCAP, McapLog, McapMissing
from sim.record.recorder_script import RecordingSink, watch
from sim.record.recording import FramesDigest, Recording
from sim.record.scene import FILE
from sim.record.scene_builder import scene_of
from sim.scenarios.fleet_setup import FleetSetup
from tools.livemap.recorded_topics import RecordedTopics

# Frames and intents that are written together, so that code and data are in the caches of the processor.
# The hub of a launch waits for a millisecond meanwhile.
BATCH = 64


class RunRecorder:
    """Given to a `MissionRun` as `attach`, or fed by a launch; close it after the run."""

    def __init__(
        self, setting: FleetSetup, out: Path, recording: Recording | None = None,
        begin_at_us: int = 0, told: Callable[[str], None] = say, limit: Limit | None = None,
    ) -> None:  # fmt: skip
        """`recording`: of a map that shows the run meanwhile. `begin_at_us`: time of the first line, on
        the clock that `write` is given. `told`: one line where the disk takes no more. `limit`: of the
        size of the MCAP; None: there is none. Raises OSError, here and nowhere else."""
        self.scene = scene_of(setting)
        write_whole(out / FILE, dumps(self.scene) + "\n")
        self.digest = FramesDigest()
        self.recording = recording
        self._heard: list[tuple[int, Frame | dict[str, Any]]] = []
        self._begins = False  # a new part, which has to be whole by itself
        self.mcap: McapLog | PartedLog[McapLog] | None = None
        self.topics = RecordedTopics(self.scene, self._add)
        self._ending = Ending(MCAP, told)
        try:
            if limit is None:
                self.mcap = McapLog(out / MCAP, self.scene, begin_at_us)
            else:
                self.mcap = PartedLog(out / MCAP, self._part, begin_at_us, limit, told)
        except McapMissing:
            (out / MCAP).unlink(missing_ok=True)  # of an earlier run, not of this one
        if recording is not None:
            recording.scene = self.scene

    def __call__(self, cluster: Cluster) -> None:
        cluster.segment.taps.append(self.write)
        keepers: list[RecordingSink] = [] if self.recording is None else [self.recording]
        if isinstance(self.mcap, McapLog):
            keepers.append(_UntilFull(self.mcap, self._ending, self.tell))
        watch(cluster, keepers)

    def _part(self, path: Path, t_us: int) -> McapLog:
        self._begins = True
        return McapLog(path, self.scene, t_us)

    def _add(self, topic: str, t_us: int, text: str) -> None:
        assert self.mcap is not None
        self._ending(self.mcap.add, topic, t_us, text)

    def write(self, t_us: int, frame: Frame) -> None:
        """Take a frame of the bus: hash it, keep it, and write it to the MCAP file while the disk
        accepts it."""
        self.digest.write(t_us, frame)
        if self.recording is not None:
            self.recording.write(t_us, frame)
        if self.mcap is not None:
            self._later(t_us, frame)

    def tell(self, t_us: int, intent: dict[str, Any]) -> None:
        """Of one robot; in a launch it comes from a process of its own."""
        if self.mcap is not None:
            self._later(t_us, intent)

    def _later(self, t_us: int, heard: Frame | dict[str, Any]) -> None:
        self._heard.append((t_us, heard))
        if len(self._heard) >= BATCH:
            self._keep()

    def _keep(self) -> None:
        """Write what was heard, and what viewers see of it."""
        heard, self._heard = self._heard, []
        if self.mcap is None:
            return
        for t_us, what in heard:
            told = isinstance(what, dict)
            self._ending(self.mcap.tell if told else self.mcap.write, t_us, what)
            if self._ending.why:
                continue
            if self._begins:
                self._begins = False
                self.topics.again(t_us / 1e6)
            if isinstance(what, dict):
                self.topics.intend(t_us / 1e6, what)
            else:
                self.topics.hear(t_us / 1e6, what)

    @property
    def logs(self) -> str:
        """The names of the logs that are written, for a message."""
        return "can.log" if self.mcap is None else "can.log and run.mcap"

    @property
    def log_hash(self) -> str:
        """Hash of all frames so far, in hexadecimal."""
        return self.digest.hex

    def close(self) -> None:
        """End the recording and the file."""
        if self.recording is not None:
            self.recording.close()
        self._keep()
        if self.mcap is not None:
            self._ending.close(self.mcap.close)


class _UntilFull:
    """The MCAP of a run, as what watches the run sees it."""

    def __init__(
        self, mcap: McapLog, ending: Ending, tell: Callable[[int, dict[str, Any]], None]
    ) -> None:
        self.mcap, self.ending, self.tell = mcap, ending, tell

    def place(self, t_us: int, rows: list[list[float]]) -> None:
        self.ending(self.mcap.place, t_us, rows)

    def effect(self, slot: int, t_us: int, effect: Effect) -> None:
        self.ending(self.mcap.effect, slot, t_us, effect)
