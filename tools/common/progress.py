"""Where a progress bar is of use."""

from rich.console import Console


def shows_progress(console: Console) -> bool:
    """Whether a bar is seen there. Elsewhere rich leaves an empty line of it."""
    return console.is_interactive or console.is_jupyter
