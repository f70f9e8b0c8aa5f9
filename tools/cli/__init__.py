"""The command line: `headland` and its groups of commands."""
