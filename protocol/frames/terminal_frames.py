"""Frames between a robot and a virtual terminal of another maker (ISO 11783-6)."""

from typing import NamedTuple

from protocol.frames.layout import ANY_DEVICE, FrameLayout, octets


class TerminalMessage(NamedTuple):
    """A status, an answer or a key of a virtual terminal (ISO 11783-6, PGN 58880).

    Its first byte is the function. `protocol/terminal_client.py` has the sequences.
    """

    body: bytes


VT_TO_ECU = FrameLayout(
    TerminalMessage, "VT_TO_ECU", pgn=0xE600, priority=7, sender=ANY_DEVICE,
    fields=(octets("body", 8, "by the function in byte 0"),),
)  # fmt: skip


class TerminalRequest(NamedTuple):
    """A question or a change of a device for a virtual terminal (ISO 11783-6, PGN 59136).

    The robot that serves the fleet's screen sends it. Its first byte is the function.
    `protocol/terminal_client.py` has the sequences.
    """

    body: bytes


ECU_TO_VT = FrameLayout(
    TerminalRequest, "ECU_TO_VT", pgn=0xE700, priority=7, sender=ANY_DEVICE,
    fields=(octets("body", 8, "by the function in byte 0"),),
)  # fmt: skip
