"""The `headland` command, also as `python -m headland`."""

from tools.cli.entrance import main

__all__ = ["main"]

if __name__ == "__main__":
    main()
