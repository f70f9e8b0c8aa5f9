"""`python -m tools.chaos.fuzz_atheris TARGET [libFuzzer options]`: the process that `headland
fuzz` starts."""

import sys

import atheris

from tools.common.child_process import PREFIX

INSTRUMENTED = (
    "protocol", "crdt", "agent.peer.durable_records", "agent.safety.stop_controller",
    "agent.peer.peer", "agent.peer.membership",
)  # fmt: skip

with atheris.instrument_imports(include=[PREFIX + name for name in INSTRUMENTED]):
    from sim.chaos.fuzz_targets import TARGETS


def main() -> None:
    """Give the target that the command line names to libFuzzer, which ends the process."""
    target = TARGETS[sys.argv[1]]
    atheris.Setup([sys.argv[0], *sys.argv[2:]], target)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
