"""The limits of a backbone, as Zenoh itself has taken them."""

import json

from protocol.backbone_messages import MESSAGE_MAX
from protocol.links.zenoh_link import (
    MESSAGE_BYTES_MAX,
    OPEN_MS,
    PENDING_MAX,
    SESSIONS_MAX,
    configure,
)


def test_a_backbone_has_the_limits_of_the_table() -> None:
    config = configure([], ["tcp/127.0.0.1:0"])
    told = {
        "transport/unicast/max_sessions": SESSIONS_MAX,
        "transport/unicast/accept_pending": PENDING_MAX,
        "transport/unicast/accept_timeout": OPEN_MS,
        "transport/link/rx/max_message_size": MESSAGE_BYTES_MAX,
    }
    for key, limit in told.items():
        assert json.loads(config.get_json(key)) == limit, key
    assert MESSAGE_MAX < MESSAGE_BYTES_MAX
