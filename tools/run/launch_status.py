"""What a launch tells while it runs: a line that renews itself at a terminal, and a line for each event.

Where nobody looks, in a pipe or a log, the line is printed every few seconds instead.
"""

from contextlib import ExitStack
from types import TracebackType

from rich.console import Console
from rich.status import Status

from agent.interface.lifecycle import State
from agent.safety.stop_cause import cause_of
from tools.inspect.inspector import SILENT_S, Inspector, Seen

TELL_S = 5.0  # between two status lines where they stay


class LaunchStatus:
    """Follows the robots of a launch; `with` keeps its line at the bottom of the terminal."""

    def __init__(self, console: Console, inspector: Inspector, has_keys: bool) -> None:
        self.console, self.inspector, self.has_keys = console, inspector, has_keys
        self._stopped: set[int] = set()
        self._told_s = 0.0
        self._heard_s = self._heard_at_s = (
            0.0  # of the newest frame: its time, and when that was new
        )
        self._status: Status | None = None
        self._stack = ExitStack()

    def __enter__(self) -> "LaunchStatus":
        """Only a terminal has a line that renews itself."""
        if self.console.is_terminal:
            self._status = self._stack.enter_context(self.console.status("robots start"))
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:  # fmt: skip
        self._status = None
        self._stack.close()

    def tell(self, elapsed_s: float, done: int, all_of_it: int, what: str) -> None:
        """What has happened since, and how far it is; call it at each look."""
        self._tell_stops()
        if self.inspector.now_s != self._heard_s:
            self._heard_s, self._heard_at_s = self.inspector.now_s, elapsed_s
        line = self._line(elapsed_s, done, all_of_it, what)
        if self._status is not None:
            self._status.update(line)
        elif elapsed_s - self._told_s >= TELL_S:
            self._told_s = elapsed_s
            self.console.print(line)

    def _tell_stops(self) -> None:
        latched = State.EMERGENCY_STOP.name
        now = {slot for slot, seen in self.inspector.robots.items() if seen.state == latched}
        if now - self._stopped:
            slots = " ".join(map(str, sorted(now)))
            robots = f"robots {slots} stand" if len(now) > 1 else f"robot {slots} stands"
            self.console.print(
                f"[bold red]EMERGENCY STOP[/bold red]: {robots}; headland inspect says why, "
                "headland release --start clears stops"
            )
        elif self._stopped - now and not now:
            self.console.print("the stop is released")
        self._stopped = now

    def _line(self, elapsed_s: float, done: int, all_of_it: int, what: str) -> str:
        seen = self.inspector.robots
        now_s = self._heard_s + elapsed_s - self._heard_at_s  # quiet is time, too
        states = " ".join(f"{slot}:{_word(robot, now_s)}" for slot, robot in sorted(seen.items()))
        bare = "" if self.has_keys else "  [bold red]NO KEYS[/bold red]"
        return f"{elapsed_s:6.0f} s  {done}/{all_of_it} {what}  {states}{bare}"


def _word(robot: Seen, now_s: float) -> str:
    """The state of a robot, and the worst cause for which it may not move, as it tells it."""
    if now_s - robot.last_s >= SILENT_S:
        return "silent"
    plain = not robot.held or robot.stopped or robot.state == State.EMERGENCY_STOP.name
    told = [] if plain else robot.causes.fresh(round(now_s * 1e6))
    cause = cause_of(told[0].cause) if told else None
    return robot.state if cause is None else f"{robot.state}({cause.name})"
