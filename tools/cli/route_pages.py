"""The page of routes, printed from the routing tables of a peer."""

from agent.peer.routing import NOT_FOR_ROBOTS, ROUTES, Routes
from agent.segments.segment_parts import SEGMENT_ROUTES
from protocol.frames.messages import GROUP_OF

HEAD = ("| message | part | taken from |", "|---|---|---|")


def routes() -> str:
    """Markdown: which part of a peer handles a message, and from whom it is taken."""
    others = [f"| {_name(kind)} | {who} |" for kind, who in NOT_FOR_ROBOTS.items()]
    about = (
        "What a robot does with a message: the one table of `agent/peer/routing.py`. Stops come "
        "first, in every state. A frame of another maker's device is refused before any part sees it "
        "(`agent/peer/sender_origins.py`)."
    )
    of_segments = "`agent/segments/segment_parts.py` adds these rows."
    return "\n".join(
        ["# Routes", "", about, "", *HEAD, *_rows(ROUTES), "",
         "## Fleets of several segments", "", of_segments, "", *HEAD, *_rows(SEGMENT_ROUTES), "",
         "## Not for robots", "", "| message | for which devices it is |", "|---|---|", *others, ""]
    )  # fmt: skip


def _rows(table: Routes) -> list[str]:
    return [
        f"| {_name(kind)} | {part.__name__} in `{part.__module__.replace('.', '/')}.py` "
        f"| {senders.value} |"
        for kind, (part, senders) in table.items()
    ]


def _name(kind: type) -> str:
    """The name of a frame, with a link; of what cannot be decoded, the name of its class."""
    group = GROUP_OF.get(kind)
    return kind.__name__ if group is None else f"[{group.name}](frames.md#{group.name.lower()})"
