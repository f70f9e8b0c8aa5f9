"""The `headland` command, also as `python -m headland`."""

import signal

INTERRUPTED = 130


def main() -> None:
    """The command. Ctrl-C while its modules are loaded, a second on a small machine, is no traceback,
    nor is it one after the last line of the result."""
    try:
        from tools.cli.entrance import main as entrance

        entrance()
    except KeyboardInterrupt:
        raise SystemExit(INTERRUPTED) from None
    finally:
        # From now on Ctrl-C is the end, as for any tool.
        signal.signal(signal.SIGINT, signal.SIG_DFL)


if __name__ == "__main__":
    main()
