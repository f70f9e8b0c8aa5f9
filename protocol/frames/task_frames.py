"""Frames between a robot and a task controller of another maker (ISO 11783-10)."""

from typing import NamedTuple

from protocol.frames.layout import ANY_DEVICE, FrameLayout, integer, octets, reserved


class ProcessData(NamedTuple):
    """One command or value between a task controller and its client (ISO 11783-10, PGN 51968).

    The low half of its first byte is the command. `protocol/task_client.py` has the sequences.
    """

    body: bytes


PROCESS_DATA = FrameLayout(
    ProcessData, "PROCESS_DATA", pgn=0xCB00, priority=3, sender=ANY_DEVICE,
    fields=(octets("body", 8, "by the command in the low half of byte 0"),),
)  # fmt: skip


class WorkingSetMaster(NamedTuple):
    """A device says that it speaks for itself and for so many members (ISO 11783-7, PGN 65037).

    A robot sends it before it logs in at a task controller.
    """

    members: int


WORKING_SET_MASTER = FrameLayout(
    WorkingSetMaster, "WORKING_SET_MASTER", pgn=0xFE0D, priority=7, sender=ANY_DEVICE,
    fields=(
        integer("members", 8, "of the working set, the master included"),
        reserved(56, ones=True),
    ),
)  # fmt: skip
