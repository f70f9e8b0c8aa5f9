"""Passes frames, messages and time into a gateway, and performs its effects.

It uses the timers that it is given: those of an asyncio loop (`headland bridge`) or of a
simulation.
"""

import logging
from collections.abc import Callable, Sequence
from typing import Protocol

from agent.interface.effects import Send, Trace
from agent.interface.ports import Bus
from agent.segments.gateway import Gateway, Out, Publish
from protocol.frames.codec import encode
from protocol.frames.frame import Frame

log = logging.getLogger(__name__)


class TimerHandle(Protocol):
    """A call that was scheduled for later."""

    def cancel(self) -> object:
        """Do not make the call."""
        ...


class Backbone(Protocol):
    """The link between segments: messages may be lost, late or duplicated, and have no loopback."""

    def publish(self, message: Publish) -> None:
        """Send a message to the segment that it concerns, or to all."""
        ...

    def subscribe(self, callback: Callable[[bytes], None]) -> None:
        """Call back for every message that concerns this segment, in the thread of the timers."""
        ...

    def close(self) -> None:
        """Stop receiving and release the link."""
        ...


class GatewayRunner:
    """Runs one gateway on a bus and a backbone."""

    def __init__(
        self,
        gateway: Gateway,
        bus: Bus,
        backbone: Backbone,
        clock: Callable[[], int],
        at: Callable[[int, Callable[[], None]], TimerHandle],
        on_effect: Callable[[int, Out], None] | None = None,
    ) -> None:
        """`clock`: the time in microseconds. `at`: schedules a call for a time in microseconds.
        `on_effect`: called with the time and each effect after it was performed.
        """
        self.gateway, self.bus, self.backbone = gateway, bus, backbone
        self.on_effect = on_effect
        self.frames = 0  # count of frames sent on our bus
        self._clock, self._at = clock, at
        self._timer: TimerHandle | None = None
        self._timer_at_us = 0
        self._open = True

    def start(self) -> None:
        """Subscribe to bus and backbone, and set the first timer."""
        self.bus.subscribe(self._on_frame)
        self.backbone.subscribe(self._on_message)
        self._arm()

    def stop(self) -> None:
        """Stop without a farewell; another candidate notices the silence."""
        self._open = False
        if self._timer is not None:
            self._timer.cancel()
        self.backbone.close()
        self.bus.close()

    def _on_frame(self, frame: Frame) -> None:
        if self._open:
            self._perform(self.gateway.on_frame(frame, self._clock()))

    def _on_message(self, data: bytes) -> None:
        if self._open:
            self._perform(self.gateway.on_backbone_message(data, self._clock()))

    def _on_timer(self) -> None:
        self._timer = None
        if self._open:
            self._perform(self.gateway.on_tick(self._clock()))

    def _perform(self, effects: Sequence[Out]) -> None:
        for effect in effects:
            if isinstance(effect, Publish):
                self.backbone.publish(effect)
            elif isinstance(effect, Send):
                if effect.source is not None:
                    self.frames += 1
                    self.bus.send(encode(effect.message, effect.source, effect.destination))
            elif isinstance(effect, Trace):
                log.info("segment %d: %s", self.gateway.segment, " ".join(effect))
            if self.on_effect is not None:
                self.on_effect(self._clock(), effect)
        self._arm()

    def _arm(self) -> None:
        due_at_us = self.gateway.due_at_us
        if self._timer is not None:
            if self._timer_at_us <= due_at_us:
                return  # the timer fires earlier, finds nothing due, and is set again
            self._timer.cancel()
        self._timer_at_us = due_at_us
        self._timer = self._at(due_at_us, self._on_timer)
