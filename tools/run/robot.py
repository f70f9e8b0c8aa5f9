"""One robot as a process of its own; started by `headland launch`, one line of JSON on stdin.

It ends on SIGTERM (with a graceful leave), and when the launcher is gone for any reason, because then
the pipe on its stdin is at its end.
"""

import asyncio
import json
import secrets
import signal
import sys
from pathlib import Path
from random import Random
from typing import Any

from agent.peer.inputs import Leave
from agent.runtime.peer_runner import PeerRunner
from agent.runtime.sqlite_journal import SqliteJournal
from protocol.links.socketcand_link import SocketcandLink
from sim.fleet.gc_tuning import leave_standing
from sim.fleet.simulated_fleet import peer_of
from sim.record.intent_stream import tell
from sim.record.remote_body import RemoteBody
from sim.scenarios.delivery_scenario import is_warehouse, load_warehouse
from sim.scenarios.delivery_setup import DeliverySetting
from sim.scenarios.field_setup import Setting
from sim.scenarios.scenario import load

GOODBYE_S = 0.2  # for the farewell frame to leave


WRONG = 2  # exit code: what is said in one line must be mended first
AnySetting = Setting | DeliverySetting


class RobotError(Exception):
    """One line for the person."""


def setting_of(
    scenario: str, robots: int | None, seed: int | None, keys: Path | None
) -> AnySetting:
    """A field's, or a warehouse's. Raises ScenarioError."""
    if is_warehouse(scenario):
        return DeliverySetting(load_warehouse(scenario).changed(robots, seed, keys))
    return Setting(load(scenario).changed(robots, seed, keys))


async def run(order: dict[str, Any]) -> None:
    slot = int(order["slot"])
    keys = None if order["keys"] is None else Path(order["keys"])
    setting = setting_of(order["scenario"], order["robots"], order["seed"], keys)
    try:
        journal, recalled = SqliteJournal.opened(Path(order["journal"]))
    except OSError as problem:
        raise RobotError(f"robot {slot}: its journal is not to be had: {problem}") from None
    loop = asyncio.get_running_loop()
    end = asyncio.Event()
    loop.add_signal_handler(signal.SIGTERM, end.set)
    loop.add_signal_handler(signal.SIGINT, lambda: None)  # the launcher decides
    loop.add_reader(sys.stdin, end.set)  # nothing more is ever written: readable means the end
    try:
        body = await RemoteBody(slot).connect(Path(order["bodies"]))
    except OSError as problem:
        raise RobotError(
            f"robot {slot}: no world answers at {order['bodies']}: {problem}"
        ) from None
    await body.ready()
    rng = Random(f"line of robot {slot}")
    bus = SocketcandLink(order["host"], int(order["bus_port"]), order["channel"], rng)
    await bus.up()
    peer = peer_of(
        setting,
        slot,
        PeerRunner.now_us(),
        recalled,
        order["first_boot"],
        secrets.token_hex(16),
        int(order["segment"]),
    )
    shell = PeerRunner(peer, bus, body, journal)
    leave_standing()
    task = asyncio.create_task(shell.run())
    telling = asyncio.create_task(tell(peer, body.tell))
    waiting = asyncio.create_task(end.wait())
    print(f"robot {slot} is up", flush=True)
    await asyncio.wait({task, waiting}, return_when=asyncio.FIRST_COMPLETED)
    if not task.done():
        shell.operate(Leave())
        await asyncio.sleep(GOODBYE_S)
        task.cancel()
    waiting.cancel()
    telling.cancel()
    bus.close()
    body.end()
    journal.close()
    if not task.cancelled() and task.done() and task.exception() is not None:
        raise task.exception()  # type: ignore[misc]


def main() -> None:
    order = json.loads(sys.stdin.readline())
    try:
        asyncio.run(run(order))
    except RobotError as problem:
        print(problem, file=sys.stderr)
        sys.exit(WRONG)


if __name__ == "__main__":
    main()
