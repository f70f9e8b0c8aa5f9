"""What a run leaves for replays: frames and intents in one MCAP, the scene, the hash of its frames."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from agent.interface.effects import Effect
from protocol.frames.frame import Frame
from sim.files.log_parts import Limit, PartedLog
from sim.files.recording_end import Ending, say
from sim.files.strict_json import dumps
from sim.fleet.simulated_fleet import Cluster
from sim.record.mcap_log import MCAP, McapLog, McapMissing
from sim.record.recorder_script import RecordingSink, watch
from sim.record.recording import FramesDigest, Recording
from sim.record.scene import FILE
from sim.record.scene_builder import scene_of
from sim.scenarios.fleet_setup import FleetSetup


class RunRecorder:
    """Given to an expedition or a survey as `attach`, or fed by a launch; close it after the run."""

    def __init__(
        self, setting: FleetSetup, out: Path, recording: Recording | None = None,
        begin_at_us: int = 0, told: Callable[[str], None] = say, limit: Limit | None = None,
    ) -> None:  # fmt: skip
        """`recording`: of a map that shows the run meanwhile. `begin_at_us`: time of the first line, on
        the clock that `write` is given. `told`: one line where the disk takes no more. `limit`: of the
        size of the MCAP; None: there is none. Raises OSError, here and nowhere else."""
        self.scene = scene_of(setting)
        (out / FILE).write_text(dumps(self.scene) + "\n", encoding="utf-8")
        self.digest = FramesDigest()
        self.recording = recording
        self.mcap: McapLog | PartedLog[McapLog] | None = None
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
            keepers.append(_UntilFull(self.mcap, self._ending))
        watch(cluster, keepers)

    def _part(self, path: Path, t_us: int) -> McapLog:
        return McapLog(path, self.scene, t_us)

    def write(self, t_us: int, frame: Frame) -> None:
        """Take a frame of the bus: hash it, keep it, and write it to the MCAP file while the disk
        accepts it."""
        self.digest.write(t_us, frame)
        if self.recording is not None:
            self.recording.write(t_us, frame)
        if self.mcap is not None:
            self._ending(self.mcap.write, t_us, frame)

    def tell(self, t_us: int, intent: dict[str, Any]) -> None:
        """Of a robot in a process of its own."""
        if self.mcap is not None:
            self._ending(self.mcap.tell, t_us, intent)

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
        if self.mcap is not None:
            self._ending.close(self.mcap.close)


class _UntilFull:
    """The MCAP of a run, as what watches the run sees it."""

    def __init__(self, mcap: McapLog, ending: Ending) -> None:
        self.mcap, self.ending = mcap, ending

    def tell(self, t_us: int, intent: dict[str, Any]) -> None:
        self.ending(self.mcap.tell, t_us, intent)

    def place(self, t_us: int, rows: list[list[float]]) -> None:
        self.ending(self.mcap.place, t_us, rows)

    def effect(self, slot: int, t_us: int, effect: Effect) -> None:
        self.ending(self.mcap.effect, slot, t_us, effect)
