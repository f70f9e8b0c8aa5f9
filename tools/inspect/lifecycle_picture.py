"""The state machine of a peer as a picture in text, with the state it is in lit. From its table."""

from rich.text import Text

from agent.interface.lifecycle import TABLE, Event, State
from protocol.state_machine import edges

LIT = {
    "DISCONNECTED": "black on grey70", "IDLE": "black on cyan", "SYNCHRONIZING": "black on yellow",
    "WORKING": "black on green", "EMERGENCY_STOP": "bold white on red",
}  # fmt: skip
SHORT = {
    State.DISCONNECTED: "DISC", State.IDLE: "IDLE", State.SYNCHRONIZING: "SYNC", State.WORKING: "WORK",
    State.EMERGENCY_STOP: "STOP",
}  # fmt: skip
WIDTH = max(len(state.name) for state in State) + 2


def edges_from(state: State) -> list[tuple[State, list[Event]]]:
    """Where it can go, and the events that lead there."""
    return edges(TABLE, state)


def picture(current: str, before: str = "") -> Text:
    """Five states, a row each; under the current one the edges out of it, with their events.

    `before`: the state it came from; that edge is drawn thick.
    """
    text = Text()
    for state in State:
        lit = state.name == current
        text.append("▶ " if lit else "  ")
        text.append(f" {state.name} ".ljust(WIDTH), style=LIT[state.name] if lit else "dim")
        for target, _ in edges_from(state):
            taken = (state.name, target.name) == (before, current)
            text.append(f" {'━━▶' if taken else '─▶'} ", style="bold" if taken else "dim")
            text.append(SHORT[target], style="bold" if taken else "" if lit else "dim")
        text.append("\n")
        for target, events in edges_from(state) if lit else ():
            names = ", ".join(event.name.lower() for event in events)
            text.append(f"      ╰▶ {target.name.ljust(WIDTH)}{names}\n")
    return text
