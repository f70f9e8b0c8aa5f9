"""What a run leaves for replays: frames and intents in one MCAP, the scene, the hash of its frames."""

import json
from pathlib import Path
from typing import Any

from protocol.frame import Frame
from sim.cluster import Cluster
from sim.errand_setting import ErrandSetting
from sim.mcap_log import McapLog, McapMissing
from sim.recording import FramesDigest, Recording
from sim.scene import FILE, scene_of
from sim.setting import Setting
from sim.watch import watch

MCAP = "run.mcap"


class Keeping:
    """Given to an expedition or a survey as `attach`, or fed by a launch; close it after the run."""

    def __init__(
        self, setting: Setting | ErrandSetting, out: Path, recording: Recording | None = None,
        begun_us: int = 0,
    ) -> None:  # fmt: skip
        """`recording`: of a map that shows the run meanwhile. `begun_us`: time of the first line, on
        the clock that `write` is given. Raises OSError."""
        self.scene = scene_of(setting)
        (out / FILE).write_text(json.dumps(self.scene) + "\n", encoding="utf-8")
        self.digest = FramesDigest()
        self.recording = recording
        self.mcap: McapLog | None = None
        try:
            self.mcap = McapLog(out / MCAP, self.scene, begun_us)
        except McapMissing:
            (out / MCAP).unlink(missing_ok=True)  # of an earlier run, not of this one
        if recording is not None:
            recording.scene = self.scene

    def __call__(self, cluster: Cluster) -> None:
        cluster.segment.taps.append(self.write)
        watch(cluster, [keeper for keeper in (self.recording, self.mcap) if keeper is not None])

    def write(self, t_us: int, frame: Frame) -> None:
        self.digest.write(t_us, frame)
        if self.recording is not None:
            self.recording.write(t_us, frame)
        if self.mcap is not None:
            self.mcap.write(t_us, frame)

    def tell(self, t_us: int, intent: dict[str, Any]) -> None:
        """Of a robot in a process of its own."""
        if self.mcap is not None:
            self.mcap.tell(t_us, intent)

    @property
    def logs(self) -> str:
        """The names of the logs that are written, for a message."""
        return "can.log" if self.mcap is None else "can.log and run.mcap"

    @property
    def log_hash(self) -> str:
        return self.digest.hex

    def close(self) -> None:
        if self.recording is not None:
            self.recording.close()
        if self.mcap is not None:
            self.mcap.close()
