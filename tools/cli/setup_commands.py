"""Commands for before a run: what ships, a scenario of one's own, is it right, is this machine ready."""

from pathlib import Path
from typing import Annotated

import typer

from tools.cli.panels import PLAY, SET_UP
from tools.common.options import Json
from tools.common.told_wait import told_loading

app = typer.Typer()


@app.command("list", rich_help_panel=PLAY)
def list_shipped(json: Json = False) -> None:
    """List the scenarios that ship, by kind, with a line about each.

    Example: headland list
    """
    from tools.cli.scenario_files import list_shipped as command

    raise SystemExit(command(json))


@app.command(rich_help_panel=SET_UP)
def new(
    file: Annotated[Path, typer.Argument(help="The scenario file to write: NAME.toml.")],
    like: Annotated[
        str, typer.Option(help="A scenario that ships, to begin from (headland list).")
    ] = "small",
    json: Json = False,
) -> None:
    """Write a scenario of your own, as a copy of one that ships. An existing file is never replaced.

    Example: headland new mine.toml --like rooms, then: headland run mine.toml
    """
    from tools.cli.scenario_files import new as command

    raise SystemExit(command(file, like, json))


@app.command(rich_help_panel=SET_UP)
def check(
    scenarios: Annotated[
        list[str] | None, typer.Argument(help="Scenario files, or names that ship.")
    ] = None,
    schema: Annotated[
        bool, typer.Option("--schema", help="Print the JSON Schema of scenario files instead.")
    ] = False,
    json: Json = False,
) -> None:
    """Check scenarios without running them: keys, values, files, places and faults.

    Exit 2 if one is wrong.
    Example: headland check small rooms
    """
    if schema:
        from sim.files.strict_json import dumps
        from tools.cli.scenario_pages import schema as printed

        print(dumps(printed(), indent=1))
        raise SystemExit(0)
    if not scenarios:
        raise typer.BadParameter("name the scenarios to check, or --schema")
    with told_loading():
        from tools.cli.scenario_check import check as command

    raise SystemExit(command(scenarios, json))


@app.command(rich_help_panel=SET_UP)
def doctor(json: Json = False) -> None:
    """Say whether this machine is ready: Python, packages, kernels, disk, ports, CAN interfaces.

    Exit 1 if something that every run needs is missing.
    Example: headland doctor
    """
    from tools.cli.doctor import doctor as command

    raise SystemExit(command(json))
