"""The standard "all implements stop" (ISO 11783-7, PGN 64770): how it is received and sent.

A stop button sends its state once a second and on every change. Each button is a separate level.
Its stop ends by its own permit or by its silence, never by the permit of another button. A button
counts its stops. So a press with a release is noticed even if all frames between them were lost, and
so is a permit that somebody else sends in its name: then it says a stop that it has not counted.
"""

from dataclasses import dataclass
from typing import Final

from agent.interface.config import MS, S
from protocol.frames.safety_frames import AllImplementsStop, Switch

SAY_US: Final = 1 * S  # ISO 11783-7: the state is sent once a second
HOLD_US: Final = 3 * S  # three frames missed; other implementations use the same timeout
BUTTONS_MAX: Final = 254  # addresses that a frame can come from (J1939-81)
# If no robot has sent the fleet's stop for this long, the next robot in slot order sends it.
TAKE_OVER_US: Final = 1_500 * MS
RANK_US: Final = 10 * MS  # between two robots that would take over: two frame times with margin
PERMITS: Final = 3  # sent after a release; by then every listener's own timeout has ended the stop
COUNT_MAX: Final = 0xFF  # the count wraps to 0
assert TAKE_OVER_US + 108 * RANK_US + 200 * MS < HOLD_US, (
    "the next robot sends its stop before the timeout"
)

STOPS: Final = (Switch.STOP, Switch.ERROR)


@dataclass
class _Button:
    switch: int
    count: int
    ends_at_us: int  # it holds until then
    source: int  # bus address of its newest frame
    robot: bool  # a member of the fleet, whose own stop frames announce what holds it
    # until then a missed press or a doubtful one holds, even if the button now sends a permit
    missed_ends_at_us: int = 0

    @property
    def said(self) -> tuple[int, int]:
        return self.switch, self.count


class ShortcutButtons:
    """All buttons on the bus, each by the NAME of its device, or by its address if it has claimed
    no NAME.

    At most `BUTTONS_MAX` are kept. If one more sends, the button that was received longest ago is
    dropped, and a stop that it held goes on until its time is over.
    """

    def __init__(self) -> None:
        self._buttons: dict[int, _Button] = {}
        # until then a button holds that was dropped because the table was full
        self._dropped_end_at_us = 0
        self.missed = 0  # count of presses whose frames were lost
        self.doubtful = 0  # count of stops after a permit that the button cannot have sent

    def __len__(self) -> int:
        return len(self._buttons)

    def on_message(
        self, source: int, name: int | None, robot: bool, m: AllImplementsStop, now_us: int
    ) -> None:
        """Take in one frame of a button.

        `source`: bus address. `name`: the 64-bit NAME that this address has claimed, or None.
        `robot`: the sender is a fleet member. A stop holds for `HOLD_US` after its last frame. The
        stop of a robot holds for `HOLD_US` after its first frame only: by then its own stop frames
        have announced what holds the fleet.
        """
        key = -1 - source if name is None else name
        known = self._buttons.pop(key, None)
        if m.switch == Switch.NOT_AVAILABLE:
            if known is not None:
                self._buttons[key] = known
            return
        button = _Button(m.switch, m.transition, now_us, source, robot)
        if known is not None:
            button.missed_ends_at_us = known.missed_ends_at_us
        if m.switch in STOPS:
            button.ends_at_us = now_us + HOLD_US
            if robot and known is not None and known.said == button.said:
                button.ends_at_us = known.ends_at_us
            if not robot and known is not None and _doubtful(known, m.transition):
                self.doubtful += 1
                button.missed_ends_at_us = now_us + HOLD_US
        elif known is not None and _missed(known, m.transition):
            self.missed += 1
            button.missed_ends_at_us = now_us + HOLD_US
        self._keep(key, button, now_us)

    def _keep(self, key: int, button: _Button, now_us: int) -> None:
        """Store the button; the dict is ordered by last reception."""
        self._buttons[key] = button
        if len(self._buttons) <= BUTTONS_MAX:
            return
        free = (
            k for k, b in self._buttons.items() if max(b.ends_at_us, b.missed_ends_at_us) <= now_us
        )
        gone = self._buttons.pop(next(free, next(iter(self._buttons))))
        self._dropped_end_at_us = max(
            self._dropped_end_at_us, gone.ends_at_us, gone.missed_ends_at_us
        )

    def ends_at_us(self) -> int:
        """The time at which the last known stop ends if no further frame arrives; 0 if none was
        known.
        """
        ends = (max(b.ends_at_us, b.missed_ends_at_us) for b in self._buttons.values())
        return max(self._dropped_end_at_us, max(ends, default=0))

    def holder(self, now_us: int) -> int | None:
        """The bus address of a button that holds now; None if none does, or if it was dropped.

        Where several hold: the lowest address, and a robot only if nothing else does.
        """
        holds = [
            (button.robot, button.source)
            for button in self._buttons.values()
            if max(button.ends_at_us, button.missed_ends_at_us) > now_us
        ]
        return min(holds)[1] if holds else None


def _missed(known: _Button, count: int) -> bool:
    """Whether a permit with a changed count means that a stop was sent but not received.

    A count of 0 means that the button was switched off and on, unless it follows the largest count, or a
    stop: then the stop may still be there.
    """
    if count == known.count:
        return False
    return count != 0 or known.count == COUNT_MAX or known.switch in STOPS


def _doubtful(known: _Button, count: int) -> bool:
    """Whether a stop does not follow the permit before it, since each stop is counted.

    Then somebody else has sent the permit, as it is one frame without a tag, or the button does not
    count. Its permits end nothing for `HOLD_US`. A button that was switched off and on begins anew.
    """
    if known.switch in STOPS or (count <= 1 and known.count > 1):
        return False
    return not 1 <= (count - known.count) & COUNT_MAX <= COUNT_MAX // 2


class OwnButton:
    """What this robot sends to the implements on its bus while an emergency stop holds it.

    The robot that was pressed sends it. If no robot does, because the stop came from a panel or the
    pressed robot has died, the first robot in slot order sends it.
    """

    def __init__(self) -> None:
        self.transitions = 0  # changes from permit to stop since power up
        self._stopped = self._pressed = False
        self._permits = 0  # permits still to be sent
        self._said_at_us = -SAY_US
        self._latched_at_us: int | None = None
        self._heard_at_us = -TAKE_OVER_US  # when another robot last sent the fleet's stop

    def press(self, now_us: int) -> AllImplementsStop:
        """The frame to send immediately because the stop was pressed at this machine."""
        self._pressed = True
        return self._stop(now_us)

    def on_message(self, m: AllImplementsStop, now_us: int) -> None:
        """Another robot's frame: its stop is sent for the whole fleet, and its permit ends that."""
        self._heard_at_us = now_us if m.switch == Switch.STOP else now_us - TAKE_OVER_US

    def release(self, now_us: int) -> AllImplementsStop | None:
        """The first permit, after a person has reset this machine; None if it has sent no stop."""
        self._pressed, self._latched_at_us = False, None
        if not self._stopped:
            return None
        self._stopped, self._permits, self._said_at_us = False, PERMITS, now_us
        return AllImplementsStop(self.transitions & COUNT_MAX, Switch.PERMIT)

    @property
    def speaks(self) -> bool:
        """Whether there is a stop or a permit to repeat."""
        return self._stopped or self._permits > 0

    def outgoing(self, latched: bool, rank: int, now_us: int) -> AllImplementsStop | None:
        """The frame that is due with this beat, or None.

        `latched`: an emergency stop holds this robot. `rank`: how many live members have a lower
        slot. The robot with rank 0 sends first; each following one waits `RANK_US` longer.
        """
        if not latched:
            return self._permit(now_us)
        if self._latched_at_us is None:
            self._latched_at_us = now_us
        due_at_us = self._said_at_us + SAY_US
        if not self._pressed:
            turn_at_us = max(self._latched_at_us, self._heard_at_us + TAKE_OVER_US) + rank * RANK_US
            due_at_us = max(due_at_us, turn_at_us)
        return self._stop(now_us) if now_us >= due_at_us else None

    def _permit(self, now_us: int) -> AllImplementsStop | None:
        if self._stopped:
            return self.release(now_us)
        if not self._permits or now_us - self._said_at_us < SAY_US:
            return None
        self._permits, self._said_at_us = self._permits - 1, now_us
        return AllImplementsStop(self.transitions & COUNT_MAX, Switch.PERMIT)

    def _stop(self, now_us: int) -> AllImplementsStop:
        if not self._stopped:
            self.transitions += 1
        self._stopped, self._permits, self._said_at_us = True, 0, now_us
        return AllImplementsStop(self.transitions & COUNT_MAX, Switch.STOP)
