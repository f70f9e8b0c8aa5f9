"""`headland robot`: one robot as a process on a machine.

It imports nothing that only a person needs: no library of the command line, and no checks.
"""

import asyncio
import sys
import traceback
from contextlib import AbstractContextManager, nullcontext
from importlib.util import find_spec
from pathlib import Path
from shlex import quote
from tempfile import TemporaryFile

from agent.runtime.body_plugins import factory_of
from agent.runtime.ready_kernels import are_ready
from agent.runtime.robot_body import FactoryError, named
from agent.runtime.robot_file import Changes, RobotError, RobotFile
from agent.runtime.robot_process import until_told
from agent.runtime.sqlite_journal import MARK_SUFFIX
from tools.build.kernel_cache import WAIT
from tools.common.exit_codes import INTERRUPTED, NO_ROOM
from tools.common.verbosity import Verbosity
from tools.run.needed_kernels import missing_kernels

BLIND = (
    "no range sensors: it does not see people, animals, or anything else that is not a member; "
    "fences and members it keeps clear of"
)
KEYLESS = "NO KEYS: any device on the bus can stop and release it"
BEFORE = "it stands meanwhile. `headland compile --kernels` does it before"
NO_SLOT = ("robot: is missing", "robot.slot: is missing")  # of a file for several machines
WHICH = "say which robot of the fleet this machine is: --slot NUMBER"
RED, PLAIN = "\x1b[1;31m", "\x1b[0m"  # of a terminal


def robot(
    file: Path, changes: Changes, *, first_boot: bool, dry: bool, metrics: str | None = None,
    foxglove: int | None = None,
) -> int:  # fmt: skip
    """The exit code of `headland robot`: 0 after a farewell, 1 if the robot failed, 2 if a person has to
    mend something first, 75 if a device was not there and a later start may find it.

    `metrics`: PORT or HOST:PORT of figures for Prometheus. `foxglove`: a port for viewers."""
    import_from(file.parent)
    try:
        declared = declared_in(file, changes)
        viewers: AbstractContextManager[None] = nullcontext()
        if metrics is not None or foxglove is not None:
            from tools.run.robot_viewers import check_viewers, viewers_beside

            check_viewers(metrics, foxglove)
            viewers = viewers_beside(declared, metrics, foxglove)
        if wrong := memory_wrong(declared):
            raise RobotError(f"robot {declared.robot.slot}: robot.journal: {wrong}")
        if not first_boot and not is_written(memory(declared)):
            print(
                f"headland: robot {declared.robot.slot} has no memory in {memory(declared).parent}; "
                "it stays stopped until a reset. A new machine starts with --first-boot",
                file=sys.stderr,
            )
        if not sees(declared):
            print(f"headland: robot {declared.robot.slot}: {BLIND}", file=sys.stderr)
        if declared.fleet.keys is None:
            line = f"headland: robot {declared.robot.slot}: {KEYLESS}"
            print(f"{RED}{line}{PLAIN}" if sys.stderr.isatty() else line, file=sys.stderr)
        if lacks_kernels(declared):
            print(f"headland: robot {declared.robot.slot}: {WAIT}; {BEFORE}", file=sys.stderr)
        with viewers:
            asyncio.run(until_told(declared, first_boot=first_boot, dry=dry))
    except RobotError as problem:
        if Verbosity.verbose:
            traceback.print_exc()
        print(f"headland: {problem}", file=sys.stderr)
        return problem.code
    except KeyboardInterrupt:
        return INTERRUPTED
    return 0


def declared_in(file: Path, changes: Changes) -> RobotFile:
    """What a robot file says of this robot. Raises RobotError, which says how to name the robot where the
    file is that of the whole fleet."""
    try:
        return RobotFile.read(file, changes)
    except RobotError as problem:
        if changes.slot is None and str(problem).endswith(NO_SLOT):
            raise RobotError(f"{problem}; {WHICH}") from None
        raise


def import_from(folder: Path) -> None:
    """Modules of a driver are found beside the robot file and in the working folder."""
    for place in (str(folder.resolve()), str(Path.cwd())):
        if place not in sys.path:
            sys.path.insert(0, place)


def memory(declared: RobotFile) -> Path:
    """The file of its durable memory."""
    return declared.folder / declared.robot.journal / f"robot{declared.robot.slot}.sqlite"


def memory_wrong(declared: RobotFile) -> str:
    """Why its durable memory cannot be kept, and what a person can do; empty if it can."""
    folder = memory(declared).parent
    if not folder.exists():
        return f"there is no folder {folder}: make it (mkdir -p {quote(str(folder))})"
    if not folder.is_dir():
        return f"{folder} is no folder"
    try:
        with TemporaryFile(dir=folder):  # without a name where the system can: it leaves nothing
            return ""
    except OSError as problem:
        if problem.errno in NO_ROOM:
            return ""  # a full disk is the matter of the journal
        return f"the folder {folder} cannot be written: {problem.strerror}"


def is_written(memory: Path) -> bool:
    """Whether a robot has ever had this memory. One that could not start leaves a file without records:
    only the first record brings the mark of the newest one beside it."""
    return memory.exists() and memory.with_name(memory.name + MARK_SUFFIX).exists()


def sees(declared: RobotFile) -> bool:
    """Whether its body has range sensors, as far as its class is known before it is opened."""
    body = declared.body
    factory = body.factory if body.plugin is None else factory_of(body.plugin)
    try:
        made = named(factory or "")
    except FactoryError:
        return True  # what is wrong is told when it is opened
    return bool(getattr(made, "has_range_sensors", True))


def lacks_kernels(declared: RobotFile) -> bool:
    """Whether it has to compile kernels before it works: none are ready, and the cache has not all that
    its work needs. To be asked before anything runs that compiles some of them."""
    if are_ready() or find_spec("numba") is None:
        return False
    return bool(missing_kernels(declared))
