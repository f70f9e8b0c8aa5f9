"""Topics of the robots' fixes, which are made while viewers are connected.

foxglove-sdk 0.30 tells viewers of a new channel before it can look the channel up: a subscription that
comes at once is lost ("attempted to subscribe to unknown channel"), and the viewer believes that it has
subscribed. So a topic that nobody takes, while viewers are there, is offered again as a new channel.
"""

from dataclasses import dataclass
from typing import Final

import foxglove
from foxglove import channels

from sim.record.topics import fix_topic

OFFER_FOR_S: Final = 1.0  # a viewer that subscribes to each topic does so within this
# Of one topic: a viewer may not want it, and a subscription is lost about once in 3,000 offers.
OFFERS_MAX: Final = 3


@dataclass(slots=True)
class _Offer:
    channel: channels.LocationFixChannel
    at_s: float
    count: int


class FixTopics:
    """One topic a robot, `/robots/SLOT/fix`, offered when the robot's first fix comes."""

    def __init__(self, context: foxglove.Context) -> None:
        self._context = context
        self._offers: dict[int, _Offer] = {}

    def of(self, slot: int, t_s: float) -> channels.LocationFixChannel:
        """The channel of a robot; `t_s`: now."""
        if slot not in self._offers:
            self._offer(slot, t_s, 1)
        return self._offers[slot].channel

    def offer_again(self, t_s: float) -> None:
        """Those that nobody has taken; to be called while viewers are there."""
        for slot, offer in list(self._offers.items()):
            due = t_s - offer.at_s >= OFFER_FOR_S and offer.count < OFFERS_MAX
            if due and not offer.channel.has_sinks():
                offer.channel.close()
                self._offer(slot, t_s, offer.count + 1)

    def _offer(self, slot: int, t_s: float, count: int) -> None:
        channel = channels.LocationFixChannel(fix_topic(slot), context=self._context)
        self._offers[slot] = _Offer(channel, t_s, count)
