"""The state machines of a robot as one page of the documents, printed from their total tables: a
picture, what each state and event means, and the table of each machine."""

from collections.abc import Mapping
from enum import Enum
from html import escape
from math import cos, hypot, pi, sin
from typing import Any, NamedTuple

from agent.coverage import plan_agreement
from agent.delivery import plan_negotiation
from agent.interface import lifecycle
from agent.mapf import joint_plan_agreement
from agent.motion import obstacle_stop
from agent.runtime.vda5050 import vehicle_orders
from agent.segments import gateway_election
from protocol import (
    address,
    extended_transport,
    task_client,
    task_server,
    terminal_client,
    transport,
)
from protocol.state_machine import edges

WIDTH, HEIGHT = 860, 620
BOX_W, BOX_H = 156, 40
BEND = 0.16  # of an edge's length to its left, so that there and back are two lines
COLOURS = ("#e0e0e0", "#bfe3f2", "#fbe3b5", "#bfe6c4", "#f5b7b1",
           "#d9c8ee", "#c9ded8", "#f3d3e4", "#dfe6ae")  # of states, in their order  # fmt: skip


class Machine(NamedTuple):
    """A state machine of the page: its table with the state that it begins in, and the module that
    has it."""

    picture: str  # file name
    title: str
    what: str
    module: str
    table: Mapping[tuple[Any, Any], Any]
    start: Enum


MACHINES = (
    Machine(
        "states.svg", "The lifecycle of a robot", "What a robot is to its fleet.",
        "agent/interface/lifecycle.py", lifecycle.TABLE, lifecycle.DISCONNECTED,
    ),
    Machine(
        "states_address.svg", "Address claim", "How a device comes to its source address.",
        "protocol/address.py", address.CLAIM_TABLE, address.WAITING,
    ),
    Machine(
        "states_transport.svg", "Transport session",
        "A long message that a device sends to another one; a broadcast starts in SENDING.",
        "protocol/transport.py", transport.SENDING_TABLE, transport.AWAITING,
    ),
    Machine(
        "states_task_client.svg", "Session with a task controller",
        "How a robot logs in at a task controller of another maker.",
        "protocol/task_client.py", task_client.SESSION_TABLE, task_client.SessionState.WAITING,
    ),
    Machine(
        "states_long_transport.svg", "Long transport session",
        "A message above 1,785 bytes that a device sends to another one.",
        "protocol/extended_transport.py", extended_transport.LONG_SENDING_TABLE,
        extended_transport.AWAITING,
    ),
    Machine(
        "states_task_server.svg", "An implement at our task controller",
        "How an implement of any maker logs in at `headland tc`.",
        "protocol/task_server.py", task_server.CLIENT_TABLE, task_server.GREETED,
    ),
    Machine(
        "states_terminal.svg", "The fleet's screen on a virtual terminal",
        "How the robot that serves the screen brings it to a terminal of another maker.",
        "protocol/terminal_client.py", terminal_client.TERMINAL_TABLE, terminal_client.AWAY,
    ),
    Machine(
        "states_obstacle.svg", "Question about an obstacle",
        "What a robot does about something that nobody has announced and that stands in its way.",
        "agent/motion/obstacle_stop.py", obstacle_stop.QUESTION_TABLE, obstacle_stop.NONE,
    ),
    Machine(
        "states_joint_plan.svg", "Agreement on a joint plan",
        "How robots in each other's way agree on which robot goes where.",
        "agent/mapf/joint_plan_agreement.py", joint_plan_agreement.JOINT_PLAN_TABLE,
        joint_plan_agreement.FREE,
    ),
    Machine(
        "states_coverage_plan.svg", "Agreement on a coverage plan",
        "How robots that cover a grid together agree on their next plan.",
        "agent/coverage/plan_agreement.py", plan_agreement.COVERAGE_PLAN_TABLE, plan_agreement.FREE,
    ),
    Machine(
        "states_negotiation.svg", "Plan negotiation",
        "How carriers agree on new itineraries: every robot searches, and the cheapest plan wins.",
        "agent/delivery/plan_negotiation.py", plan_negotiation.NEGOTIATION_TABLE,
        plan_negotiation.REST,
    ),
    Machine(
        "states_vehicle_order.svg", "Order of a VDA 5050 vehicle",
        "How far a vehicle is with the newest order of the robot whose body it is.",
        "agent/runtime/vda5050/vehicle_orders.py", vehicle_orders.ORDER_TABLE,
        vehicle_orders.OrderPhase.FREE,
    ),
    Machine(
        "states_gateway.svg", "Gateway candidate",
        "How a gateway comes to its number and address in a segment.",
        "agent/segments/gateway_election.py", gateway_election.CANDIDATE_TABLE,
        gateway_election.LISTENING,
    ),
)  # fmt: skip


def states() -> str:
    """Every machine as a picture and as its total table."""
    parts = [
        "# States", "", "Every state machine of the code is a total table: each state has an answer "
        "to each event. An empty field is an event that is seen and deliberately ignored.", "",
    ]  # fmt: skip
    for machine in MACHINES:
        parts += _section(machine)
    return "\n".join(parts)


def _section(machine: Machine) -> list[str]:
    order, events = list(type(machine.start)), _events(machine)
    rows = []
    for state in order:
        targets = [machine.table[state, event] for event in events]
        cells = ["" if target is state else target.name for target in targets]
        rows.append(f"| **{state.name}** | " + " | ".join(cells) + " |")
    meanings = [
        f"* **{each.name}**: {each.value}"
        for each in (*order, *events)
        if isinstance(each.value, str)
    ]
    return [
        f"## {machine.title}", "", f"{machine.what} The reasons are in `{machine.module}`.", "",
        f"![the state machine]({machine.picture})", "",
        *([*meanings, ""] if meanings else []),
        "| state | " + " | ".join(event.name for event in events) + " |",
        "|---" * (len(events) + 1) + "|", *rows, "",
    ]  # fmt: skip


def _events(machine: Machine) -> list[Enum]:
    kind: type[Enum] = type(next(event for _, event in machine.table))
    return list(kind)


def diagram(machine: Machine) -> str:
    """An SVG, without anything from elsewhere."""
    order = list(type(machine.start))
    centre = {
        state: (WIDTH / 2 - cos(2 * pi * k / len(order)) * (WIDTH / 2 - BOX_W),
                HEIGHT / 2 - sin(2 * pi * k / len(order)) * (HEIGHT / 2 - 2 * BOX_H))
        for k, state in enumerate(order)
    }  # fmt: skip
    lines, labels, boxes = [], [], []
    for state, colour in zip(order, COLOURS, strict=False):
        for target, events in edges(machine.table, state):
            text = ", ".join(event.name.lower() for event in events)
            line, label = _edge(centre[state], centre[target], text)
            lines.append(line)
            labels.append(label)
        x, y = centre[state]
        boxes.append(
            f'<rect x="{x - BOX_W / 2:.1f}" y="{y - BOX_H / 2:.1f}" width="{BOX_W}" height="{BOX_H}" '
            f'rx="8" fill="{colour}" stroke="#444"/><text x="{x:.1f}" y="{y + 5:.1f}" '
            f'font-weight="bold">{escape(state.name)}</text>'
        )
    return "\n".join(
        [f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" '
         'font-family="sans-serif" font-size="13" text-anchor="middle">',
         f"<title>{escape(machine.title)}</title>",
         '<defs><marker id="end" viewBox="0 0 10 10" refX="9" refY="5" markerWidth="8" markerHeight="8" '
         'orient="auto"><path d="M0 0L10 5L0 10z" fill="#444"/></marker></defs>',
         f'<rect width="{WIDTH}" height="{HEIGHT}" fill="#fff"/>', *lines, *boxes, *labels, "</svg>", ""]
    )  # fmt: skip


def _edge(a: tuple[float, float], b: tuple[float, float], text: str) -> tuple[str, str]:
    """A bent arrow from border to border, and its label at the bend."""
    dx, dy = b[0] - a[0], b[1] - a[1]
    length = hypot(dx, dy)
    cx = (a[0] + b[0]) / 2 + dy * BEND
    cy = (a[1] + b[1]) / 2 - dx * BEND
    ax, ay = _border(a, (cx, cy))
    bx, by = _border(b, (cx, cy))
    assert length > 0
    line = (
        f'<path d="M{ax:.1f} {ay:.1f}Q{cx:.1f} {cy:.1f} {bx:.1f} {by:.1f}" fill="none" stroke="#444" '
        'stroke-width="1.3" marker-end="url(#end)"/>'
    )
    x, y = 0.25 * ax + 0.5 * cx + 0.25 * bx, 0.25 * ay + 0.5 * cy + 0.25 * by
    wide = 7.0 * len(text) + 6
    label = (
        f'<rect x="{x - wide / 2:.1f}" y="{y - 9:.1f}" width="{wide:.0f}" height="17" fill="#fff" '
        f'opacity="0.85"/><text x="{x:.1f}" y="{y + 4:.1f}">{escape(text)}</text>'
    )
    return line, label


def _border(centre: tuple[float, float], towards: tuple[float, float]) -> tuple[float, float]:
    dx, dy = towards[0] - centre[0], towards[1] - centre[1]
    share = min(BOX_W / 2 / max(abs(dx), 1e-9), BOX_H / 2 / max(abs(dy), 1e-9))
    return centre[0] + dx * share, centre[1] + dy * share
