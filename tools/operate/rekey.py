"""`headland keys revoke` and `rotate --running`: new keys for the robots on a bus, while they work."""

import asyncio
import sys
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any

from agent.runtime.files.key_file import KeyFileError
from agent.runtime.files.key_folder import KeyFolder, owned, unread_people
from protocol.frames.codec import decode
from protocol.frames.frame import Frame
from protocol.frames.key_frames import KeysHeld
from protocol.rekeying import NOBODY, Rekeying, confirmed, own_key, seal
from sim.files.strict_json import dumps
from tools.common.bus_address import Attached, AttachError, robots_of_launch
from tools.common.bus_attach import attach
from tools.common.exit_codes import code_of, wrong
from tools.common.launch_keys import own_keys
from tools.common.told_wait import told_wait
from tools.operate.estop import NOT_ALL
from tools.operate.operator_device import Operator

LISTEN_S = 0.7  # every robot has beaten by then
PART_S = 0.004  # between two frames: seven for each of 108 robots take 3 s, an eighth of the bus
ROUND_S = 0.4  # robots confirm at most five times a second
SWITCHES = 5  # repeats in a row: one frame that all hear makes all switch at the same time
SWITCH_S = 0.01
DEFAULT = Path("keys")
HAS_NOT_SWITCHED = "HAS NOT SWITCHED: it stands; give it its new file and restart it"
HAS_NOT_TAKEN = (
    "HAS NOT TAKEN THE NEW KEYS: it goes on with the old ones; only a robot with a key file of its own "
    "takes any"
)


class Rekeyer:
    """Gives the new secret to the robots on a bus, and makes them switch."""

    def __init__(self, operator: Operator, keys: KeyFolder, rekeying: Rekeying) -> None:
        self.operator, self.keys, self.rekeying = operator, keys, rekeying
        self.heard: dict[tuple[int, bool], KeysHeld] = {}  # whose tag is right

    def hear(self, frame: Frame) -> None:
        """A frame of the bus. A confirmation that is not of this change is no word of its robot: anybody
        could take back by it what the robot has confirmed."""
        _, message = decode(frame)
        if isinstance(message, KeysHeld) and confirmed(self.rekeying, [message], message.switched):
            self.heard[message.slot, message.switched] = message

    @property
    def wanted(self) -> set[int]:
        """Robots that are heard, without the revoked one."""
        return {robot.slot for robot in self.operator.live} - {self.rekeying.revoked}

    @property
    def unheard(self) -> set[int]:
        """Robots of the launch, and those that others have named, that have a file and are not heard."""
        return {robot.slot for robot in self.operator.silent} & self.keys.slots - {
            self.rekeying.revoked
        }

    def done(self, switched: bool) -> set[int]:
        """Robots that have confirmed that they hold the secret, or use it."""
        return confirmed(self.rekeying, list(self.heard.values()), switched)

    async def give(self, timeout_s: float) -> None:
        """Until all that are heard hold the secret, or the time is over."""
        loop = asyncio.get_running_loop()
        end_s = loop.time() + timeout_s
        while loop.time() < end_s:
            missing = (self.wanted | self.keys.slots) - self.done(False) - {self.rekeying.revoked}
            for slot in sorted(missing):
                for part in seal(self.rekeying, own_key(self.keys.root, slot), slot):
                    self.operator.send(part)
                    await asyncio.sleep(PART_S)
            await asyncio.sleep(ROUND_S)
            self.operator.now_s = loop.time()
            if self.wanted and self.wanted <= self.done(False):
                return

    async def switch(self, timeout_s: float) -> None:
        """Until all that hold the secret use it, or the time is over."""
        loop = asyncio.get_running_loop()
        end_s = loop.time() + timeout_s
        while True:
            for _ in range(SWITCHES):
                self.operator.send(self.rekeying.switch())
                await asyncio.sleep(SWITCH_S)
            await asyncio.sleep(ROUND_S)
            self.operator.now_s = loop.time()
            if self.done(False) <= self.done(True) or loop.time() >= end_s:
                return


def rekey(
    revoked: int,
    void_for_s: int,
    folder: Path | None,
    bus: Attached,
    timeout_s: float,
    as_json: bool,
) -> int:
    """The exit code: 0 if every robot that is or was there uses the new keys, 1 if one does not or is not
    heard, 2 if there is no bus or the folder is not the owner's.

    `revoked`: slot, or `NOBODY`. `void_for_s`: what it said up to this long ago is void."""
    interface, _, _, host, port = bus
    place = folder or own_keys(interface, host, port) or DEFAULT
    try:
        keys = owned(place)
        used = keys.begun is not None  # a command before this one may have made robots switch
        rekeying = keys.begin(revoked, void_for_s)
        return asyncio.run(_rekey(keys, rekeying, used, bus, timeout_s, as_json))
    except (KeyFileError, AttachError) as problem:
        return wrong(problem)
    except OSError as problem:
        return wrong(f"{place}: {problem.strerror}", code_of(problem))


async def _rekey(
    keys: KeyFolder, rekeying: Rekeying, used: bool, bus: Attached, timeout_s: float, as_json: bool
) -> int:
    """`used`: robots may use these keys already."""
    with ExitStack() as at_end:
        # Keys that no robot uses would hold up another change, such as that of the right robot.
        at_end.callback(lambda: None if used else keys.drop(rekeying))
        can_bus = at_end.enter_context(closing(attach(*bus)))
        operator = Operator(can_bus, None)
        operator.expect(robots_of_launch(bus[0], bus[3], bus[4], keys.folder))
        rekeyer = Rekeyer(operator, keys, rekeying)
        loop = asyncio.get_running_loop()

        def listen(frame: Frame) -> None:  # a bus has one listener
            operator.hear(loop.time(), frame)
            rekeyer.hear(frame)

        can_bus.subscribe(listen)
        operator.ask_who()
        await operator.listen(LISTEN_S)
        operator.check_address()
        if not rekeyer.wanted:
            print("headland: no robot is heard on this bus; nothing is changed", file=sys.stderr)
            return NOT_ALL
        with told_wait("until every robot holds the new keys", timeout_s):
            await rekeyer.give(timeout_s)
        used = used or bool(rekeyer.done(False))
        if used:
            with told_wait("until every robot uses the new keys", timeout_s):
                await rekeyer.switch(timeout_s)
        use, heard = rekeyer.done(True), rekeyer.wanted
        if use:
            keys.finish(rekeying)
            for why in unread_people(keys.folder):
                print(f"headland: {why}; it has NO NEW KEYS: make it again", file=sys.stderr)
        return _tell(rekeying, use, heard - use, rekeyer.unheard - use - heard, as_json, used)


def _tell(
    rekeying: Rekeying, use: set[int], missing: set[int], unheard: set[int], as_json: bool,
    switched: bool = True,
) -> int:  # fmt: skip
    """`use`: robots that use the new keys. `switched`: robots were told to use them."""
    revoked = None if rekeying.revoked == NOBODY or not use else rekeying.revoked
    told: dict[str, Any] = {
        "generation": rekeying.generation, "switched": sorted(use), "not_switched": sorted(missing),
        "not_heard": sorted(unheard), "revoked": revoked,
    }  # fmt: skip
    if as_json:
        print(dumps(told))
    else:
        names = " ".join(map(str, sorted(use))) or "none"
        print(f"keys {rekeying.generation}: used by robots {names}")
        if revoked is not None:
            print(f"robot {revoked} is revoked: its key signs nothing that is believed")
        elif rekeying.revoked != NOBODY:
            print(f"robot {rekeying.revoked} is NOT REVOKED")
        for slot in sorted(missing):
            print(f"robot {slot}: {HAS_NOT_SWITCHED if switched else HAS_NOT_TAKEN}")
        for slot in sorted(unheard):
            print(
                f"robot {slot}: NOT HEARD: it stands when it is back, until the same command is called"
            )
    return 0 if use and not (missing or unheard) else NOT_ALL
