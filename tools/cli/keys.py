"""`headland keys`: make, rotate and show the key files of a fleet. Secrets are never printed."""

import sys
from pathlib import Path
from typing import Annotated, NoReturn

import typer

FLEET_FILE, OPERATOR_FILE = "fleet.json", "operator.json"
WRONG = 2
app = typer.Typer(
    help="Make, rotate and show the key files of a fleet.", no_args_is_help=True,
    pretty_exceptions_enable=False, rich_markup_mode=None,
)  # fmt: skip
Folder = Annotated[Path, typer.Argument(help="Folder of the two key files.")]


@app.command()
def new(
    folder: Folder = Path("keys"),
    device: Annotated[int, typer.Option(help="Number of the operator's device, 192 to 254.")] = 249,
) -> None:
    """Make the keys of a fleet: fleet.json for its robots and stop panels, operator.json to release.

    Example: headland keys new keys, then: headland launch --keys keys/fleet.json
    """
    from agent.runtime.files.key_file import DEVICE_MAX, fresh, write
    from protocol.authentication import OPERATOR_FIRST

    fleet, operator = folder / FLEET_FILE, folder / OPERATOR_FILE
    if not OPERATOR_FIRST <= device <= DEVICE_MAX:
        _wrong(f"--device {device}: use {OPERATOR_FIRST} to {DEVICE_MAX}")
    for path in (fleet, operator):
        if path.exists():
            _wrong(f"{path} is there already: 'headland keys rotate {folder}' replaces it")
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        write(fleet, operator, fresh(), device)
    except OSError as problem:
        _wrong(f"{folder}: {problem.strerror}")
    _tell(fleet)
    _tell(operator)


@app.command()
def rotate(folder: Folder = Path("keys")) -> None:
    """Replace both keys. The old files are kept beside the new ones; robots take the new at a restart.

    Example: headland keys rotate keys
    """
    from agent.runtime.files.key_file import (
        FLEET,
        OPERATOR,
        KeyFileError,
        counter_path,
        fresh,
        read,
        write,
    )

    fleet, operator = folder / FLEET_FILE, folder / OPERATOR_FILE
    try:
        old, device = read(fleet, FLEET), read(operator, OPERATOR).device
        assert device is not None
        for path in (fleet, operator, counter_path(operator)):
            if path.exists():
                path.rename(path.with_name(f"{path.name}.{old.ids['fleet']}"))
        write(fleet, operator, fresh(), device)
    except KeyFileError as problem:
        _wrong(str(problem))
    except OSError as problem:
        _wrong(f"{folder}: {problem.strerror}")
    print(f"the keys {old.ids['fleet']} are no longer used; restart the robots with the new file")
    _tell(fleet)
    _tell(operator)


@app.command()
def show(
    file: Annotated[Path, typer.Argument(help="A key file, or the folder of both.")] = Path("keys"),
) -> None:
    """Say what a key file is for, by its ids: two files of one fleet show the same operator id.

    Example: headland keys show keys
    """
    for path in [file / FLEET_FILE, file / OPERATOR_FILE] if file.is_dir() else [file]:
        _tell(path)


def _tell(path: Path) -> None:
    from agent.runtime.files.key_file import KeyFileError, counter, read

    try:
        found = read(path)
        ids = ", ".join(f"{name} {value}" for name, value in found.ids.items())
        device = ""
        if found.device is not None:
            device = f", device {found.device}, {counter(path)} frames reserved"
        print(f"{path}: {found.kind}: {ids}{device}")
    except KeyFileError as problem:
        _wrong(str(problem))


def _wrong(message: str) -> NoReturn:
    print(f"headland: {message}", file=sys.stderr)
    raise SystemExit(WRONG)
