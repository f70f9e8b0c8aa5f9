"""Every socket that a program of ours opens for others, and its limits: the page `docs/how/sockets.md`.

The numbers are those of the code, read where it uses them. `tests/tools/cli/test_socket_limits.py`
finds each place in the sources that opens a listening socket, and demands its row.
"""

from typing import NamedTuple

from agent.runtime.bodies import line_port
from protocol import backbone_messages
from protocol.links import socketcand_link, zenoh_link
from sim.can import socketcand_server as hub
from sim.machines import nmea_machine
from sim.record import local_link
from tools.inspect import scrape_server
from tools.livemap import foxglove_live, seated_http
from tools.livemap import server as livemap

NONE = "none"


class SocketRow(NamedTuple):
    """One socket. The four limits are sentences with their numbers, or `NONE` with the reason."""

    place: str  # file, and function in which it is opened
    what: str
    connections: str
    length: str  # of a line, a message or a request
    memory: str
    time: str
    reason: str
    shown_by: str


class ProbeRow(NamedTuple):
    """A place that binds a port only to see whether it is free, and closes it at once."""

    place: str
    what: str


def _kib(count: int) -> str:
    return f"{count // 1024} KiB" if count >= 1024 else f"{count} bytes"


SOCKETS: tuple[SocketRow, ...] = (
    SocketRow(
        "sim/can/socketcand_server.py Hub.start", "hub: TCP, loopback unless a host is named",
        f"{hub.CLIENTS_MAX}, of which {hub.LISTENERS_MAX} may only listen; a newcomer takes the seat of "
        "the one that has been silent for longest",
        f"command of {hub.LINE_MAX} bytes, of a filter {_kib(hub.FILTER_LINE_MAX)}",
        f"{_kib(hub.READ_BYTES)} read, {_kib(hub.BACKLOG_BYTES_MAX)} unread by each client",
        f"{hub.OPEN_S:.0f} s to open a bus, {hub.COMMANDS_S} commands a second",
        "108 peers and their tools; a full bus for ten seconds",
        "tests/sim/can/test_socketcand_server.py::"
        "test_l6_clients_that_do_not_read_cost_little_and_starve_nobody",
    ),
    SocketRow(
        "tools/livemap/command.py listen", "map: HTTP and web sockets, loopback only",
        f"{seated_http.CONNECTIONS_MAX} for files and posts, {livemap.PAGES_MAX} pages; "
        "the oldest that waits gives way",
        f"POST {_kib(livemap.BODY_MAX)}, message of a page {_kib(livemap.MESSAGE_MAX)}, header 64 KiB",
        f"{livemap.AHEAD_MAX} pictures that a page has not drawn",
        f"{seated_http.REQUEST_S:.0f} s for a request, 5 s idle, 20 s for a ping of a page",
        "16 pages with the six connections that a browser opens at most",
        "tests/tools/livemap/test_seated_http.py::"
        "test_idle_connections_and_slow_posts_keep_no_page_out",
    ),
    SocketRow(
        "tools/livemap/foxglove_live.py FoxgloveFeed.__init__", "viewers: web sockets, loopback only",
        f"{NONE}: the SDK has no limit; only users of this machine reach it",
        "of the SDK",
        f"{foxglove_live.BACKLOG_MESSAGES} messages for each viewer, then the oldest are dropped",
        f"{NONE}: a viewer may only listen",
        "a full bus for eight seconds",
        "tests/tools/livemap/test_foxglove_live.py::test_a_viewer_that_stalls_misses_nothing",
    ),
    SocketRow(
        "tools/inspect/scrape_server.py ScrapeServer.__init__",
        "metrics: HTTP, loopback unless a host is named",
        f"{scrape_server.SCRAPES_MAX}, more are closed",
        f"line of {_kib(scrape_server.LINE_BYTES_MAX)}, 100 headers; a body is not read",
        "one answer for each connection",
        f"{scrape_server.SCRAPE_S:.0f} s from connection to answer",
        "Prometheus keeps one connection and gives up after 10 s",
        "tests/tools/inspect/test_scrape_server.py::"
        "test_slow_and_idle_clients_are_closed_and_the_next_scrape_is_answered",
    ),
    SocketRow(
        "sim/record/local_link.py LinkServer.start", "bodies of robots: Unix, this user only",
        f"{local_link.LINKS_MAX}, more are closed",
        f"message of {_kib(local_link.MESSAGE_MAX)}",
        f"{_kib(local_link.BACKLOG_MAX)} unread, then messages are dropped",
        f"{NONE}: a robot may wait as long as it runs",
        "108 robots, those that restart, and listeners",
        "tests/sim/record/test_local_link.py::test_many_links_and_long_messages_keep_a_robot_served",
    ),
    SocketRow(
        "sim/machines/nmea_machine.py NmeaMachine._serve",
        "simulated machine: TCP ports of receiver, wheels and control; a tractor has control only",
        f"{nmea_machine.CLIENTS_MAX} a port; a newcomer takes the seat of the oldest",
        f"line of {_kib(nmea_machine.LINE_MAX)}",
        f"{_kib(nmea_machine.LATE_MAX * nmea_machine.LINE_MAX)} unread; of what the receiver is told "
        f"{_kib(nmea_machine.SKIPPED_BYTES)}",
        "command: 0.1 s, then the machine stands",
        "its robot, one that restarts, and people who look",
        "tests/sim/machines/test_nmea_ports.py::test_hostile_clients_of_a_machine_keep_no_robot_out",
    ),
    SocketRow(
        "agent/runtime/bodies/line_port.py _udp", "robot's receiver: UDP datagrams",
        "one socket; any sender, as receivers broadcast",
        f"line of {_kib(line_port.LINE_MAX)}; longer ones are counted",
        "of the kernel's queue",
        "a place that grows old stops the robot",
        "a sentence of NMEA has 82 bytes",
        "tests/agent/runtime/bodies/test_line_port.py::test_hostile_datagrams_cost_themselves_and_no_sentence",
    ),
    SocketRow(
        "protocol/links/zenoh_link.py ZenohLink.__init__",
        "backbone of gateways: Zenoh, TCP or TLS, where `--listen` names it",
        f"{zenoh_link.SESSIONS_MAX}, of which {zenoh_link.PENDING_MAX} may be unknown",
        f"message of {_kib(zenoh_link.MESSAGE_BYTES_MAX)}; of gateways "
        f"{_kib(backbone_messages.MESSAGE_MAX)}",
        f"{zenoh_link.INBOX_MAX} messages wait, then all but stops are dropped",
        f"{zenoh_link.OPEN_MS / 1000:.0f} s to say who one is, {zenoh_link.LEASE_MS} ms of silence",
        "two gateways for each of 128 segments behind one router",
        "tests/protocol/links/test_zenoh_limits.py::test_a_backbone_has_the_limits_of_the_table",
    ),
    SocketRow(
        "protocol/links/zenoh_link.py ZenohLink._connect", "the same, opened again after silence",
        "as above", "as above", "as above", "as above", "a client only connects",
        "tests/protocol/links/test_zenoh_limits.py::test_a_backbone_has_the_limits_of_the_table",
    ),
)  # fmt: skip
PROBES: tuple[ProbeRow, ...] = (
    ProbeRow("tools/livemap/foxglove_port.py check_port", "whether `--foxglove` is free"),
    ProbeRow("tools/inspect/metrics_address.py metrics_address", "whether `--metrics` is free"),
    ProbeRow("tools/bench/scale.py presses", "a free port for a backbone of the bench"),
    ProbeRow(
        "tools/bench/wrong_inputs.py taken_port",
        "a taken port, for the bench of wrong words",
    ),
    ProbeRow("tools/cli/doctor.py _loopback", "whether loopback works"),
    ProbeRow(
        "tools/bench/vda5050/counterparts.py free_port", "a free port for a broker of the bench"
    ),
)
# Programs that connect and never listen: `headland vda5050`, `headland say`, robots on a hub.
CLIENTS = (
    f"Robots and tools on a hub read answers of up to {socketcand_link.LINE_MAX} bytes, keep "
    f"{_kib(socketcand_link.UNSENT_MAX)} unsent, and give up a server that is silent for "
    f"{socketcand_link.DEAD_S:.0f} s. `headland vda5050` connects to a broker and listens nowhere."
)


def sockets_page() -> str:
    """The page, in Markdown."""
    lines = [
        "# Sockets and their limits", "",
        "Each socket that a program of Headland opens for others. A client that is slow, silent, or says "
        "too much costs itself its connection, and nobody else theirs. "
        "[Trust](trust.md) says who may do what.", "",
        "| socket | connections | length | memory | time | why so many | shown by |",
        "|---|---|---|---|---|---|---|",
    ]  # fmt: skip
    for row in SOCKETS:
        lines.append(
            f"| {row.what} (`{row.place.split()[0]}`) | {row.connections} | {row.length} | "
            f"{row.memory} | "
            f"{row.time} | {row.reason} | `{row.shown_by}` |"
        )
    return "\n".join((*lines, "", CLIENTS, ""))
