"""Whether UDP multicast works on this machine."""

import can
import pytest

WAIT_S = 2.0


def reached(group: str) -> str:
    """The group, if its datagrams reach this machine itself. Else the test skips, with the reason."""
    try:
        with can.Bus(group, "udp_multicast") as out, can.Bus(group, "udp_multicast") as back:
            out.send(can.Message(arbitration_id=1, is_extended_id=True))
            heard = back.recv(timeout=WAIT_S)
    except (OSError, can.CanError, ImportError) as problem:
        pytest.skip(f"this machine has no multicast: {problem}")
    if heard is None:
        pytest.skip("this machine does not deliver its own multicast datagrams")
    return group
