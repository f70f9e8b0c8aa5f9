"""`headland keys`: make, rotate and show the key files of a fleet. Secrets are never printed."""

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, NoReturn

import typer

from tools.common.exit_codes import WRONG, code_of, wrong
from tools.common.options import Bitrate, Channel, Host, Interface, Json, Port, Timeout

NOT_PROVEN = "it had no key file of its own, and any robot can make its tags"
FLEET_FILE, PANEL_FILE, OPERATOR_FILE = "fleet.json", "panel.json", "operator.json"
app = typer.Typer(
    help="Make, rotate, revoke and show the keys of a fleet.", no_args_is_help=True,
    pretty_exceptions_enable=False, rich_markup_mode=None,
)  # fmt: skip
Folder = Annotated[Path, typer.Argument(help="Folder of the key files.")]


@app.command()
def new(
    folder: Folder = Path("keys"),
    device: Annotated[int, typer.Option(help="Number of the operator's device, 192 to 254.")] = 249,
    robots: Annotated[int, typer.Option(min=0, max=108, help="Robots that get a file each.")] = 0,
    json: Json = False,
) -> None:
    """Make the keys of a fleet: a file for each robot, panel.json to stop, operator.json to release.

    panel.json is for panels and gateways, fleet.json for simulations and task controllers.

    Example: headland keys new keys --robots 6, then: headland launch --robots 6 --keys keys
    """
    from agent.runtime.files.key_file import DEVICE_MAX, fresh, robot_path, write
    from protocol.authentication import OPERATOR_FIRST

    fleet, panel, operator = (folder / name for name in (FLEET_FILE, PANEL_FILE, OPERATOR_FILE))
    if not OPERATOR_FIRST <= device <= DEVICE_MAX:
        _wrong(f"--device {device}: use {OPERATOR_FIRST} to {DEVICE_MAX}")
    for path in (fleet, panel, operator):
        if path.exists():
            _wrong(f"{path} is there already: 'headland keys rotate {folder}' replaces it")
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        write(fleet, operator, fresh(), device, range(robots))
    except OSError as problem:
        _wrong(f"{folder}: {problem.strerror}", code_of(problem))
    _tell([fleet, panel, operator, *(robot_path(folder, slot) for slot in range(robots))], json)


@app.command()
def rotate(
    folder: Annotated[
        Path | None, typer.Argument(help="Folder of the files (none: the launch's own, or keys).")
    ] = None,
    running: Annotated[
        bool, typer.Option("--running", help="Give the new keys to the robots on a bus, now.")
    ] = False,
    interface: Interface = "socketcand", channel: Channel = "can0", bitrate: Bitrate = 250_000,
    host: Host = "127.0.0.1", port: Port = 0, timeout_s: Timeout = 5.0, json: Json = False,
) -> None:  # fmt: skip
    """Replace all keys: for a fleet that is switched off, or with --running for one at work.

    Without --running the old files are kept beside the new ones; robots take the new at a restart.
    Example: headland keys rotate keys
    """
    from agent.runtime.files.key_file import (
        FLEET,
        OPERATOR,
        KeyFile,
        KeyFileError,
        fresh,
        read,
        replace,
        texts,
    )
    from agent.runtime.files.key_folder import (
        free_numbers,
        named,
        owned,
        people_texts,
        unread_people,
    )
    from protocol.rekeying import ALWAYS_S, GENERATION_MAX, NOBODY

    if running:
        from tools.operate.rekey import rekey

        bus = (interface, channel, bitrate, host, port)
        raise SystemExit(rekey(NOBODY, ALWAYS_S, folder, bus, timeout_s, json))
    folder = folder or Path("keys")
    fleet, operator = folder / FLEET_FILE, folder / OPERATOR_FILE
    try:
        old, owner = read(fleet, FLEET), owned(folder)
        begun = owner.begun
        if begun is not None and begun.revoked != NOBODY:
            _wrong(f"{folder}: 'headland keys {named(begun)}' was begun: finish it first")
        generation = 1 + owner.spent
        if generation > GENERATION_MAX:
            _wrong(f"{folder}: too many generations: make new keys")
        keys = fresh()._replace(generation=generation)  # above what robots remember
        made = texts(fleet, operator, keys, owner.device, sorted(owner.slots), owner.root)
        made |= people_texts(folder, KeyFile(operator, OPERATOR, keys, root=owner.root))
        replace(made, kept=old.ids["fleet"])
        free_numbers(folder)
        owner.forget()
    except KeyFileError as problem:
        _wrong(str(problem))
    except OSError as problem:
        _wrong(f"{folder}: {problem.strerror}", code_of(problem))
    for why in unread_people(folder):
        print(f"headland: {why}; it has NO NEW KEYS: make it again", file=sys.stderr)
    if not json:
        print(
            f"the keys {old.ids['fleet']} are no longer used; restart the robots with the new file"
        )
    _tell([fleet, folder / PANEL_FILE, operator], json)


@app.command()
def revoke(
    robot: Annotated[int, typer.Argument(min=0, max=107, help="Number of the robot.")],
    folder: Annotated[
        Path | None, typer.Argument(help="Folder of the files (none: the launch's own, or keys).")
    ] = None,
    since: Annotated[
        float | None, typer.Option(help="What it said in the last so many seconds is void (all).")
    ] = None,
    interface: Interface = "socketcand", channel: Channel = "can0", bitrate: Bitrate = 250_000,
    host: Host = "127.0.0.1", port: Port = 0, timeout_s: Timeout = 5.0, json: Json = False,
) -> None:  # fmt: skip
    """Take a robot out of its fleet for good: all others get new keys, and what only it said is void.

    A robot that is away stands when it comes back; the same command again gives it the new keys.
    Example: headland keys revoke 3
    """
    from protocol.rekeying import ALWAYS_S
    from tools.operate.rekey import rekey

    if since is not None and not 0.0 <= since < ALWAYS_S:
        _wrong(f"--since {since:g}: use 0 to {ALWAYS_S - 1}")
    void_for_s = ALWAYS_S if since is None else round(since)
    raise SystemExit(
        rekey(robot, void_for_s, folder, (interface, channel, bitrate, host, port), timeout_s, json)
    )


@app.command()
def operator(
    person: Annotated[str, typer.Argument(help="For whom it is; shown with what was released.")],
    roles: Annotated[
        str, typer.Option(help="What it allows: some of stop, release, direct, task.")
    ] = "stop",
    days: Annotated[
        int, typer.Option(min=0, max=3650, help="Days until it expires; 0: never.")
    ] = 90,
    device: Annotated[
        int, typer.Option(min=0, max=254, help="Number of the device, from 192; 0: the next one.")
    ] = 0,
    folder: Annotated[Path, typer.Option(help="Folder of the owner's files.")] = Path("keys"),
    json: Json = False,
) -> None:
    """Make a key file for one person, restricted to roles, which every robot checks at each act.

    Give the person the file. To take the key away, delete it and call 'headland keys rotate --running'.
    Example: headland keys operator Anna --roles stop,release --days 90
    """
    import time

    from agent.runtime.files.key_file import (
        DAY_MAX,
        OPERATOR,
        PERSON_MAX,
        KeyFileError,
        create,
        given_path,
        operator_path,
        operator_text,
        read,
    )
    from agent.runtime.files.key_folder import owned
    from agent.runtime.files.private_file import OWNER
    from protocol.authentication import OPERATOR_FIRST
    from protocol.operator_badges import DAY_S, NEVER, Badge, Role

    if not person.isprintable():
        _wrong("PERSON: use characters that can be printed")
    wanted, known = Role(0), ", ".join(str(role.name).lower() for role in Role)
    for word in roles.split(","):
        if word.strip().upper() not in Role.__members__:
            _wrong(f"--roles {word!r}: use some of {known}")
        wanted |= Role[word.strip().upper()]
    if Badge(OPERATOR_FIRST, wanted, NEVER if days == 0 else DAY_MAX).owner:
        _wrong(
            "--days 0: all roles without an end are the owner's own key, which can speak for everybody: "
            "leave a role out, or give it an end"
        )
    try:
        owner = owned(folder)
        free = [
            n
            for n in range(OPERATOR_FIRST, owner.device)
            if not (operator_path(folder, n).exists() or given_path(folder, n).exists())
        ]
        number = device or (free[0] if free else 0)
        if not OPERATOR_FIRST <= number <= 254 or number == owner.device:
            _wrong(f"--device {number}: use {OPERATOR_FIRST} to 254, but not {owner.device}")
        day = NEVER if days == 0 else min(int(time.time()) // DAY_S + days, DAY_MAX)
        path, given = operator_path(folder, number), given_path(folder, number)
        if given.exists() and not path.exists():
            _wrong(f"{folder}: device {number} has a file elsewhere: rotate the keys first")
        text = operator_text(
            read(folder, OPERATOR), Badge(number, wanted, day), person[:PERSON_MAX]
        )
        given.touch(mode=OWNER)
        create(path, text)
    except FileExistsError:
        _wrong(f"{folder}: device {number} has a file already: delete it and rotate the keys first")
    except KeyFileError as problem:
        _wrong(str(problem))
    except OSError as problem:
        _wrong(f"{folder}: {problem.strerror}", code_of(problem))
    _tell([path], json)


@app.command("log")
def log_command(
    folder: Annotated[
        Path, typer.Argument(help="Folder of a launch, or of robots' memories.")
    ] = Path("runs/launch"),
    keys: Annotated[
        Path | None, typer.Option(help="The owner's folder (none: the launch's own).")
    ] = None,
    verify: Annotated[
        bool,
        typer.Option(
            "--verify", help="Exit code 1 if a log was changed or has no proof, or none is there."
        ),
    ] = False,
    json: Json = False,
) -> None:
    """Say who released what, as each robot has written it down and signed it.

    Example: headland keys log runs/launch --verify
    """
    from datetime import UTC, datetime

    from agent.runtime.files.given_file import GivenFileError
    from agent.runtime.files.key_file import KeyFileError
    from sim.files.strict_json import dumps
    from tools.common.release_records import release_records

    try:
        found = release_records(folder, keys)
    except (GivenFileError, KeyFileError) as problem:
        _wrong(str(problem))
    except OSError as problem:
        _wrong(f"{folder}: {problem.strerror}", code_of(problem))
    releases = sorted(
        (r for one in found.logs for r in one.releases), key=lambda r: r.released_at_s
    )
    failed = bool(found.broken or found.shared) or not (found.root and found.logs)
    if json:
        print(dumps({
            "releases": [r._asdict() | {"who": found.who(r.device)} for r in releases],
            "broken": {str(robot): why for robot, why in found.broken.items()},
            "lacking": {str(robot): sorted(what) for robot, what in found.lacking.items()},
            "shared": found.shared, "signed": found.root, "logs": len(found.logs),
        }))  # fmt: skip
    else:
        for release in releases:
            at = datetime.fromtimestamp(release.released_at_s, UTC).strftime("%Y-%m-%d %H:%M:%S")
            print(
                f"{at} UTC  robot {release.robot}  {release.what}  by {found.who(release.device)}"
            )
        for robot, why in found.broken.items():
            print(f"robot {robot}: CHANGED: {why}")
        for robot in found.shared:
            print(f"robot {robot}: NOT PROVEN: {NOT_PROVEN}")
        for robot, what in found.lacking.items():
            print(
                f"robot {robot}: no line about {', '.join(sorted(what))}: was it off, or is the end cut?"
            )
        checked = "tags and hashes" if found.root else "hashes; the owner's key is not there"
        print(f"{len(found.logs)} logs, {len(releases)} releases; checked: {checked}")
    raise SystemExit(1 if verify and failed else 0)


@app.command()
def show(
    file: Annotated[Path, typer.Argument(help="A key file, or the folder of all.")] = Path("keys"),
    json: Json = False,
) -> None:
    """Say what a key file is for, by its ids: two files of one fleet show the same operator id.

    Example: headland keys show keys
    """
    people = sorted(file.glob("operator-*.json")) if file.is_dir() else []
    panel = file / PANEL_FILE
    panels = [panel] if panel.exists() else []  # not in a folder of an older version
    both = [file / FLEET_FILE, *panels, file / OPERATOR_FILE, *people]
    _tell(both if file.is_dir() else [file], json)


def _tell(paths: Sequence[Path], as_json: bool) -> None:
    """Say what each key file is for, a line each, or all as one array."""
    from agent.runtime.files.key_file import KeyFileError, counter, date_of, read, roles_named

    files: list[dict[str, object]] = []
    try:
        for path in paths:
            found = read(path)
            told: dict[str, object] = {"file": str(path), "kind": found.kind, "ids": found.ids}
            ids = ", ".join(f"{name} {value}" for name, value in found.ids.items())
            device = ""
            if found.device is not None:
                device = f", device {found.device}, {counter(path)} frames reserved"
                told |= {"device": found.device, "frames_reserved": counter(path)}
            if found.badge is not None:
                day, roles = found.badge.expires_day, roles_named(found.badge.roles)
                device += f", {found.person}: {roles}" + (f", until {date_of(day)}" if day else "")
                until = str(date_of(day)) if day else None
                told |= {"person": found.person, "roles": roles, "until": until}
            files.append(told)
            if not as_json:
                print(f"{path}: {found.kind}: {ids}{device}")
    except KeyFileError as problem:
        _wrong(str(problem))
    if as_json:
        from sim.files.strict_json import dumps

        print(dumps(files))


def _wrong(message: str, code: int = WRONG) -> NoReturn:
    raise SystemExit(wrong(message, code))
