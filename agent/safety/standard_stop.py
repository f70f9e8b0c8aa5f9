"""The standard "all implements stop" (ISO 11783-7, PGN 64770): what others say, and what we say.

A shortcut button says its state once a second and on every change. Each button is a level of its own:
its stop ends by its own permit or by its silence, never by another button's permit. A button counts its
stops, so that a press and release whose frames were all lost is noticed.
"""

from dataclasses import dataclass
from typing import Final

from agent.interface.config import MS, S
from protocol.frames.safety_frames import AllImplementsStop, Switch

SAY_US: Final = 1 * S  # ISO 11783-7: the state is said once a second
HOLD_US: Final = 3 * S  # three are missing; other implementations forget a silent button then, too
BUTTONS_MAX: Final = 254  # addresses that a frame can come from (J1939-81)
TAKE_OVER_US: Final = (
    1_500 * MS
)  # nobody has said the fleet's stop for so long: the next robot does
RANK_US: Final = 10 * MS  # between two robots that would take over: a frame, and one in its way
PERMITS: Final = 3  # said after a release: until a listener has forgotten the stop by itself
COUNT_MAX: Final = 0xFF  # the count goes on with 0
assert TAKE_OVER_US + 108 * RANK_US + 200 * MS < HOLD_US, "the next one speaks within the time-out"

STOPS: Final = (Switch.STOP, Switch.ERROR)


@dataclass
class _Button:
    switch: int
    count: int
    until_us: int  # it holds until then
    missed_us: int = 0  # until then a press that was missed holds, whatever it permits

    @property
    def said(self) -> tuple[int, int]:
        return self.switch, self.count


class ShortcutButtons:
    """All buttons of the bus, by NAME, or by address where no NAME is claimed."""

    def __init__(self) -> None:
        self._buttons: dict[int, _Button] = {}
        self._beyond_us = 0  # until then a button holds for which there was no room
        self.missed = 0  # presses whose frames were lost

    def __len__(self) -> int:
        return len(self._buttons)

    def hear(
        self, source: int, name: int | None, robot: bool, m: AllImplementsStop, now_us: int
    ) -> None:
        """`robot`: a member of the fleet. Its stop holds for one time-out after a transition: until
        then its own stop frames have said what holds the fleet."""
        key = -1 - source if name is None else name
        known = self._buttons.pop(key, None)
        if m.switch == Switch.NOT_AVAILABLE:
            if known is not None:
                self._buttons[key] = known
            return
        button = _Button(m.switch, m.transition, now_us)
        if known is not None:
            button.missed_us = known.missed_us
        if m.switch in STOPS:
            button.until_us = now_us + HOLD_US
            if robot and known is not None and known.said == button.said:
                button.until_us = known.until_us
        elif known is not None and _missed(known.count, m.transition):
            self.missed += 1
            button.missed_us = now_us + HOLD_US
        self._keep(key, button, now_us)

    def _keep(self, key: int, button: _Button, now_us: int) -> None:
        """The one heard last stands last."""
        self._buttons[key] = button
        if len(self._buttons) <= BUTTONS_MAX:
            return
        free = (k for k, b in self._buttons.items() if max(b.until_us, b.missed_us) <= now_us)
        gone = self._buttons.pop(next(free, next(iter(self._buttons))))
        self._beyond_us = max(self._beyond_us, gone.until_us, gone.missed_us)

    def until_us(self) -> int:
        """When the last stop that is known ends, if nothing more is heard."""
        ends = (max(b.until_us, b.missed_us) for b in self._buttons.values())
        return max(self._beyond_us, max(ends, default=0))


def _missed(known: int, count: int) -> bool:
    """A permit with another count than before: a stop was said that was not heard. With 0 the button
    was switched off and on, but behind the largest count."""
    return count != known and (count != 0 or known == COUNT_MAX)


class OwnButton:
    """What this robot says for the implements on its bus while an emergency stop holds it.

    The robot that was pressed says it; where nobody does, because the stop came from a panel or the
    pressed robot has died, the first robot in slot order does.
    """

    def __init__(self) -> None:
        self.transitions = 0  # permit to stop, since power up
        self._stopped = self._pressed = False
        self._permits = 0  # still to be said
        self._said_us = -SAY_US
        self._latched_us: int | None = None
        self._heard_us = -TAKE_OVER_US  # when another robot said the fleet's stop

    def press(self, now_us: int) -> AllImplementsStop:
        """Pressed at this machine: said at once."""
        self._pressed = True
        return self._stop(now_us)

    def heard(self, m: AllImplementsStop, now_us: int) -> None:
        """Another robot's: one that stops speaks for all, one that permits does no longer."""
        self._heard_us = now_us if m.switch == Switch.STOP else now_us - TAKE_OVER_US

    def release(self, now_us: int) -> AllImplementsStop | None:
        """A person has reset this machine. None: it has said no stop."""
        self._pressed, self._latched_us = False, None
        if not self._stopped:
            return None
        self._stopped, self._permits, self._said_us = False, PERMITS, now_us
        return AllImplementsStop(self.transitions & COUNT_MAX, Switch.PERMIT)

    @property
    def speaks(self) -> bool:
        """It has a state to repeat."""
        return self._stopped or self._permits > 0

    def say(self, latched: bool, rank: int, now_us: int) -> AllImplementsStop | None:
        """With a beat. `rank`: our place in the slot order of the live robots."""
        if not latched:
            return self._permit(now_us)
        if self._latched_us is None:
            self._latched_us = now_us
        due_us = self._said_us + SAY_US
        if not self._pressed:
            turn_us = max(self._latched_us, self._heard_us + TAKE_OVER_US) + rank * RANK_US
            due_us = max(due_us, turn_us)
        return self._stop(now_us) if now_us >= due_us else None

    def _permit(self, now_us: int) -> AllImplementsStop | None:
        if self._stopped:
            return self.release(now_us)
        if not self._permits or now_us - self._said_us < SAY_US:
            return None
        self._permits, self._said_us = self._permits - 1, now_us
        return AllImplementsStop(self.transitions & COUNT_MAX, Switch.PERMIT)

    def _stop(self, now_us: int) -> AllImplementsStop:
        if not self._stopped:
            self.transitions += 1
        self._stopped, self._permits, self._said_us = True, 0, now_us
        return AllImplementsStop(self.transitions & COUNT_MAX, Switch.STOP)
