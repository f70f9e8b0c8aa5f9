"""The state machine of a peer as a picture in text, with the state it is in lit. From its table."""

from rich.text import Text

from agent.lifecycle import TABLE, Event, State

LIT = {
    "DISCONNECTED": "black on grey70", "IDLE": "black on cyan", "SYNCHRONIZING": "black on yellow",
    "WORKING": "black on green", "EMERGENCY_STOP": "bold white on red",
}  # fmt: skip
WIDTH = max(len(state.name) for state in State) + 2


def edges_from(state: State) -> list[tuple[State, list[Event]]]:
    """Where it can go, and the events that lead there."""
    found: dict[State, list[Event]] = {}
    for event in Event:
        target = TABLE[state, event]
        if target is not state:
            found.setdefault(target, []).append(event)
    return sorted(found.items())


def picture(current: str, before: str = "") -> Text:
    """Five states, a row each; the edge that was taken last is bold."""
    text = Text()
    for state in State:
        lit = state.name == current
        text.append("▶ " if lit else "  ")
        text.append(f" {state.name} ".ljust(WIDTH), style=LIT[state.name] if lit else "dim")
        for target, events in edges_from(state):
            taken = (state.name, target.name) == (before, current)
            style = "bold" if taken else "" if lit else "dim"
            text.append(f"  {'━' if taken else '─'}▶ {target.name}", style=style)
            text.append(f" {'/'.join(e.name.lower() for e in events)}", style="dim")
        text.append("\n")
    return text
