"""Options that a command was given and would ignore are told: a script means what it says."""

from collections.abc import Collection, Mapping

import typer

from tools.common.exit_codes import wrong


def refuse_unused(context: typer.Context, because: str, used: Collection[str] = ()) -> None:
    """End the command if the command line has an option that does nothing beside `because`.

    `because`: an option that was given, as users write it. `used`: names of the parameters that it goes
    with. Raises SystemExit.
    """
    told = f"with {because}; leave one of them out"
    own = because.removeprefix("--")
    names = {str(each.name) for each in context.command.params} - {own, *used}
    refuse_given(context, dict.fromkeys(names, told))


def refuse_given(context: typer.Context, unfit: Mapping[str, str]) -> None:
    """End the command if the command line has one of these parameters.

    `unfit`: what is said of each after "does nothing". A value of an environment variable, or a default,
    is no word of the user. Raises SystemExit.
    """
    for parameter in context.command.params:
        name = str(parameter.name)
        source = context.get_parameter_source(name)
        if name in unfit and source is not None and source.name == "COMMANDLINE":
            option = max(parameter.opts, key=len)
            raise SystemExit(wrong(f"{option}: does nothing {unfit[name]}"))
