"""The list of commands, the names that were there before, and where the bus options come from."""

import json
import re
from pathlib import Path
from typing import Any

import pytest
import typer
from typer.testing import CliRunner

from tests.tools.documented import ROOT, parse
from tools.cli.headland import app
from tools.cli.panels import PANELS, Panels, can_defaults

OLD = (
    "explore ring --robots 4", "replay runs/latest", "warmup", "coverage drive --H 8 --W 8 --agents 3",
    "estop", "reset --operator-key keys/operator.json", "coverage solve --agents=3",
    "order 1 wait --operator-key keys/operator.json", "map --operator-key keys/operator.json",
)  # fmt: skip


def shown(*words: str, **environment: str) -> str:
    done = CliRunner().invoke(app, words, env=environment, prog_name="headland")
    assert done.exit_code == 0, done.output
    return done.output


def test_every_command_stands_in_one_of_five_panels() -> None:
    told = shown("--help")
    titles = re.findall(r"^(\S.*):$", told, re.M)
    assert [title for title in titles if title != "Options"] == list(PANELS)
    assert not re.search(r"^ +(explore|replay|warmup|estop|reset) ", told, re.M)


def test_the_page_of_the_command_line_names_every_command_in_its_panel() -> None:
    page = (ROOT / "docs" / "use" / "command_line.md").read_text()
    command = typer.main.get_command(app)
    assert isinstance(command, Panels)
    for name, own in command.commands.items():
        panel = getattr(own, "rich_help_panel", "")
        if not own.hidden:
            assert re.search(rf"^\| {panel} \|.*`{name}`", page, re.M), (panel, name)


def test_every_command_can_print_json() -> None:
    """`vda5050` and `ros2` could not, although they run until they are ended, as others that can."""

    def without(command: Any, name: str) -> list[str]:
        under = getattr(command, "commands", {})
        if under:
            return [each for key, own in under.items() for each in without(own, f"{name} {key}")]
        has = any("--json" in param.opts for param in command.params)
        return [] if has or command.hidden else [name]

    assert without(typer.main.get_command(app), "headland") == []


@pytest.mark.parametrize("words", OLD)
def test_an_old_name_still_works(words: str) -> None:
    parse(["headland", *words.split()], whole=True)


def test_help_uses_the_width_of_the_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    def widest(columns: int) -> int:
        monkeypatch.setenv("COLUMNS", str(columns))
        command = typer.main.get_command(app)
        return max(
            map(len, command.get_help(command.make_context("headland", ["list"])).splitlines())
        )

    assert 80 < widest(160) <= 160 and widest(60) <= 60


def test_each_example_has_a_line_of_its_own() -> None:
    told = shown("run", "--help", COLUMNS="160")
    assert len(re.findall(r"^ *Example: headland run", told, re.M)) == 3


def test_the_help_of_a_robot_says_for_what_it_prints_json() -> None:
    """While it runs it prints lines for people, whatever it was asked for."""
    assert "Of --check: print JSON instead of text." in shown("robot", "--help", COLUMNS="120")


def test_choices_are_in_the_help() -> None:
    assert "mecanum|differential|ackermann" in shown("run", "--help")
    assert "PERSON_IN_FIELD" in shown("stop", "--help")


def leaves() -> list[tuple[str, Any]]:
    """Every command that is listed, with the words that call it."""
    found, waiting = [], [("", typer.main.get_command(app))]
    while waiting:
        words, command = waiting.pop()
        inner = getattr(command, "commands", {})
        waiting += [(f"{words} {n}".strip(), c) for n, c in inner.items() if not c.hidden]
        if not inner:
            found.append((words, command))
    return found


def test_a_help_has_words_for_people_and_no_names_of_types() -> None:
    """`<list[Path]>`, `<int range>` and `0<=x<=65535` stood there."""
    for words, _ in leaves():
        told = shown(*words.split(), "--help", COLUMNS="120")
        assert not re.search(r"<list|range>|<int|<float|<str>|<=x|x[<>]=|INTEGER|FLOAT", told), told


def test_an_option_has_one_name_everywhere() -> None:
    """Of `--out` only the report had a short form, `mapf` said `--agents`, and five had no `--json`."""
    for words, command in leaves():
        options = [set(param.opts) for param in command.params]
        names = set().union(*options)
        assert {"-o", "--out"} in options or "--out" not in names, words
        assert "--agents" not in names, words
        assert "--json" in names, words


def test_bench_without_a_name_measures_nothing() -> None:
    """It began to measure all of them, for hours."""
    told = shown("bench")
    assert re.search(r"^wire +bus load", told, re.M) and re.search(r"^all +", told, re.M)
    assert json.loads(shown("bench", "--json"))["wire"].startswith("bus load")


def test_keys_and_exports_are_told_as_json(tmp_path: Path) -> None:
    made = json.loads(shown("keys", "new", str(tmp_path / "keys"), "--robots", "1", "--json"))
    assert [Path(each["file"]).name for each in made] == [
        "fleet.json", "panel.json", "operator.json", "robot0.json",
    ]  # fmt: skip
    told = json.loads(shown("keys", "show", str(tmp_path / "keys"), "--json"))
    assert [each["ids"] for each in told] == [each["ids"] for each in made[:3]]
    written = json.loads(shown("dbc", str(tmp_path / "headland.dbc"), "--json"))
    assert written["file"] == str(tmp_path / "headland.dbc") and written["frames"] > 50


def test_quiet_prints_nothing_but_json(tmp_path: Path) -> None:
    words = (
        "coverage",
        "solve",
        "--H",
        "4",
        "--W",
        "4",
        "--robots",
        "1",
        "--out",
        str(tmp_path / "p"),
    )
    assert shown(*words, "-q") == "" == shown("-q", *words)
    assert '"ok": true' in shown(*words, "-q", "--json")


def interface_of(*words: str) -> tuple[str, str, int]:
    """Interface, channel and bit rate with which a command of the bus would be called."""
    command = typer.main.get_command(app)
    context = command.make_context("headland", list(words))
    _, found, rest = command.resolve_command(  # type: ignore[attr-defined]
        context, [*context._protected_args, *context.args]
    )
    values = found.make_context(found.name, rest, parent=context).params
    return values["interface"], values["channel"], values["bitrate"]


def test_the_bus_is_that_of_python_can(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Options before variables, variables before its file, and its file before the newest launch."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path))
    for name in ("CAN_INTERFACE", "CAN_CHANNEL", "CAN_BITRATE"):
        monkeypatch.delenv(name, raising=False)
    assert interface_of("stop") == ("socketcand", "can0", 250_000)
    (tmp_path / ".canrc").write_text(
        "[default]\ninterface = slcan\nchannel = can7\nbitrate = 500000\n"
    )
    assert interface_of("stop") == ("slcan", "can7", 500_000)
    from can.util import load_file_config  # the counterpart reads the same

    assert load_file_config() == can_defaults()
    monkeypatch.setenv("CAN_CHANNEL", "vcan1")
    assert interface_of("release") == ("slcan", "vcan1", 500_000)
    assert interface_of("inspect", "-i", "virtual") == ("virtual", "vcan1", 500_000)


def test_a_broken_file_of_python_can_counts_as_none(tmp_path: Path) -> None:
    bad = tmp_path / "can.conf"
    bad.write_bytes(b"\xff\xfe interface")
    assert can_defaults((str(bad),)) == {}
