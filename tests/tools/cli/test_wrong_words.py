"""Whatever a person gets wrong is one line that begins with our name, never a traceback."""

import os
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from sim.scenarios.scenario import SEED_MAX
from tests.tools.complaint import Complaints
from tools.cli import headland, panels

ROOT = Path(__file__).parents[3]
NOISE = bytes(range(256)) * 8  # neither text nor any format of ours
WORDS = """
run dir.toml | run bin.toml | run bin.zip | run file | run / | run nowhere | run small --robots many
run small --out file | run small --out file/x | run small --log file/x.log | run small --log x.pdf
run small --seed -1 | run small --robots 9999 | run small --robots 0 | run small --drive hover
run small --keys nowhere | run small --keys bin.json | run small --feature zzz | run small --wild
coverage drive --H 8 --W 8 --robots 3 --silence no
run small --map --page-port TAKEN | run small --map --page-port 99999 | run small --page-port -1
run rooms --map | run rooms --out file/x | run warehouse --out file/x | run warehouse --robots 9999
run warehouse --live --port TAKEN --seconds 1 | explore nowhere | explore bin.toml
explore arena --out file/x | explore arena --robots 999 | explore oxted | launch nowhere
launch small --out file/x | launch small --port TAKEN --seconds 1 | launch small --port 99999
launch small --segment 99999 | launch rooms | launch warehouse --segment 2
launch warehouse --out file/x | launch warehouse --robots 9999
launch small --map --page-port TAKEN | replay nowhere | replay noise.log | replay noise.mcap
replay noise.blf | replay text.asc | replay empty.log | replay folder | replay file
replay noise.log -i nonsense | replay runx | report nowhere | report noise.log | report noise.mcap
report noise.blf | report text.asc | report folder | report file | report runx
report empty.log -o page.pdf | export nowhere --geojson x | export folder
export folder --geojson x | export runy --geojson x | dbc file/x | dbc folder | inspect nowhere
inspect noise.mcap | inspect noise.blf | inspect folder --picture x.svg | inspect empty.log
inspect --picture x.svg | inspect empty.log --why S99999999 | inspect empty.log --why
inspect --traces 3 | inspect -i nonsense | inspect --port 1 | inspect --port 99999 | inspect runx
inspect -i socketcan -c nocan9 | inspect -i slcan -c /dev/nothing | map nowhere | map noise.mcap
map folder | map empty.log --scenario nowhere --page-port 0 | map empty.log --page-port TAKEN
map --port 1 | map -i socketcan -c nocan9 | map --keys nowhere -i virtual | estop --port 1
estop --keys nowhere | estop --keys bin.json --port 1 | estop --reason BORED
reset --operator-key nowhere | reset --operator-key bin.json | reset --port 1 | order | order 1
order x wait | order 1 set-goal | order 1 set-goal 1,x | order -1 wait | order 999 wait --port 1
say status --log nowhere | say status --log noise.mcap | say status --log empty.log
say status --places nowhere --read | say "go home" --places bin.toml --read | bridge
bridge --segment 0 | bridge --segment 1 --port 1 | bridge --segment 1 --config nowhere --port 1
bridge --segment 1 --area nowhere --port 1 | bridge --segment 1 --mode wild --port 1
chaos --seeds x | chaos --seeds 5:1 | chaos --profile wild | chaos --out file/x
chaos --scenario nowhere | chaos --scenario bin.toml | chaos --jobs -1 | fuzz wild
fuzz --input nowhere | fuzz frame --input nowhere | fuzz --engine wild | fuzz --runs -5 frame
bench wild | coverage solve nowhere | coverage solve bin.map | coverage solve --H 0 --W 5
coverage replay nowhere | coverage solve --H 8 --W 8 --agents 2 --out file/x
coverage replay bin.json | coverage replay list.json | coverage drive nowhere
coverage solve --H 8 --W 8 --wall-prob 7 | keys new file/x | keys new folder --device 3
keys rotate folder | keys show nowhere | keys show bin.json | keys show list.json | keys show folder
task add | task add 1,2 | task add a b | task add --file nowhere | task add --file bin.csv
task add 1,2 3,4 --scenario nowhere | task add 1,2 3,4 --scenario small | task add 99,99 1.5,8.5
task add 9.5,2.5 1.5,8.5 --port 1 | wild | --wild
"""
CASES = [case.strip() for line in WORDS.strip().splitlines() for case in line.split(" | ")]


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder full of what is not what it is called."""
    folder = tmp_path_factory.mktemp("place")
    for name in (
        "noise.log",
        "noise.mcap",
        "noise.blf",
        "bin.toml",
        "bin.zip",
        "bin.map",
        "bin.csv",
    ):
        (folder / name).write_bytes(NOISE)
    for name, text in (("file", "x"), ("empty.log", ""), ("text.asc", "hello"), ("bin.json", '{"a":'),
                       ("list.json", "[1]")):  # fmt: skip
        (folder / name).write_text(text)
    for name in ("folder", "dir.toml", "runx/can.log", "runy"):
        (folder / name).mkdir(parents=True)
    (folder / "runy" / "work.geojson").write_text('{"type": 3}')
    return folder


@pytest.fixture(scope="module")
def taken() -> Iterator[str]:
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        listener.listen()
        yield str(listener.getsockname()[1])


@pytest.mark.parametrize("words", CASES)
def test_one_line(
    words: str, place: Path, taken: str, monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    said = Complaints(monkeypatch, capfd).of(words.replace("TAKEN", taken), place)
    assert said.code in (1, 2), said


SAID = [
    ("coverage drive small.map --robots 2 --seed -5", "-5: a seed is 0 to 9223372036854775807"),
    ("coverage solve small.map --robots 2 --seed -5", "-5: a seed is 0 to 9223372036854775807"),
    ("mapf small.map --robots 2 --seed -5", "-5: a seed is 0 to 9223372036854775807"),
    ("run small --seed 18446744073709551616", "a seed is 0 to 9223372036854775807"),
    (f"run small --seed {'9' * 4000}", "a seed is 0 to 9223372036854775807"),
    ("coverage drive small.map --robots 2 --loss 2", "--loss is 0 to 0.9"),
    ("mapf small.map --robots 4 --crash 9", "--crash 9: 0 to 3 of 4 robots can crash"),
    ("run small --limit -5", "-5 is too short; it needs more than 0"),
    ("run warehouse --limit 0", "0 is too short; it needs more than 0"),
    ("run small --page-port 9000", "--page-port 9000: does nothing without --map"),
    ("launch small --page-port 0", "--page-port 0: does nothing without --map"),
    ("tc nowhere --hitch 120", "--hitch 120: it is -100 to 100 metres"),
    ("tc nowhere --hitch -1e9", "--hitch -1e+09: it is -100 to 100 metres"),
    ("tc nowhere --accuracy -0.05", "--accuracy -0.05: it is 0 to 100 metres"),
    ("chaos --jobs 99999999999999999999", "--jobs"),
    ("hub --bitrate 800000", "--bitrate 800000: the simulated bus has bits of whole microseconds"),
    ("hub --bitrate 99999999999999999999", "bits of whole microseconds"),
    ("machine --place nan,0,0", "finite"),
    ("machine --place 1e400,0,0", "finite"),
    ("machine --origin 95,0", "latitude is -90 to 90"),
    ("machine --origin nan,0", "finite"),
    ("robot nowhere.toml --slot 0 --json", "--json: does nothing without --check"),
    ("body-check standing --origin inf,0", "finite"),
    ("body-check standing --speed 0", "speed_m_s"),
    ("body-check standing --acceleration 0", "acceleration_m_s2"),
    ("body-check standing --drive ackermann --wheelbase 0", "wheelbase_m"),
    ("body-check standing --track -1", "track_m"),
    ("fuzz --input file", "--input needs one target"),
    ("fuzz frame sync --input file", "--input needs one target"),
    ("plan small --out file", "--out file: is a file; name a folder"),
    ("export folder --isoxml file", "--isoxml file: is a file; name a folder"),
    ("inspect -i virtual --seconds 0", "--seconds 0: a live bus is heard for longer"),
    ("inspect -i virtual --seconds 0 --traces 3", "--seconds 0: a live bus is heard for longer"),
    (
        "inspect empty.log -i nonsense",
        "inspect empty.log: a file needs no bus; leave out --interface",
    ),
    ("inspect empty.log --seconds 5", "--seconds, --traces: of a live bus; leave out empty.log"),
    ("inspect empty.log --traces 3", "--seconds, --traces: of a live bus; leave out empty.log"),
    ("inspect -i virtual --speed 3", "--speed: of a log, and none is given"),
    ("map empty.log -i socketcan", "map empty.log: a file needs no bus; leave out --interface"),
    ("map empty.log --page-port 0 --keys file", "--keys: of a live bus; a recording has no"),
    ("map empty.log --page-port 0 --operator-key file", "--operator-key: of a live bus"),
    ("inspect empty.log -c can7 -b 500000", "leave out --channel, --bitrate"),
    ("inspect empty.log --host nowhere --port 5", "leave out --host, --port"),
    ("coverage replay file --plan bin.json", "--plan bin.json: file is the plan already"),
    ("inspect empty.log --why S²", "a section is written S7"),
    (f"inspect empty.log --why S{'9' * 4500}", "a section is written S7"),
    ("say status --by ²", "needs the number of a robot"),
    ("chaos --only gate-open --seeds 0:1", "--only: does nothing without --mutants"),
    ("chaos --golden --seeds 0:1", "--golden: does nothing without --scenario"),
    ("chaos --mutants --scenario nowhere", "--mutants: does nothing with --scenario"),
    ("chaos --mutants --profile stop --seconds 0", "--profile: does nothing with --mutants"),
    ("chaos --scenario nowhere --seeds 0:9", "--seeds: does nothing with --scenario"),
    ("chaos --report folder --profile stop", "--profile: does nothing with --report"),
    ("chaos --mutants --report folder", "--mutants: does nothing with --report"),
    ("fuzz frame --input file --runs 5", "--runs: does nothing with --input"),
    ("fuzz frame --input file --json", "--json: does nothing with --input"),
    ("robot nowhere.toml --check --dry", "--dry: does nothing with --check"),
    ("machine --tell where --bus vcan0:x", "--bus: does nothing with --tell"),
    ("machine --drive ackermann --bus virtual:x --gnss 0", "--gnss: does nothing with --bus"),
    ("launch small --hub 29536 --port 0", "--port: does nothing with --hub 29536"),
    ("launch small --operator-key file", "--operator-key: does nothing without --map"),
    ("bench house --quick --seconds 20", "--seconds: does nothing here: house"),
    ("compile --kernels --remove", "--remove: does nothing with --kernels"),
    ("run rooms --feature x", "--feature: does nothing here: rooms is a field of errands"),
    ("task add 1.5,8.5 9.5,2.5 --file text.asc", "--file text.asc: 1.5,8.5 is a place already"),
    ("export folder --film nowhere/x.gif", "--film nowhere/x.gif: nowhere is not a folder"),
    ("export folder --film folder", "--film folder: is a folder"),
]


@pytest.mark.parametrize(("words", "said"), SAID)
def test_the_line_says_what_is_wrong(
    words: str, said: str, place: Path, monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    (place / "small.map").write_text("type octile\nheight 3\nwidth 3\nmap\n...\n...\n...\n")
    told = Complaints(monkeypatch, capfd).of(words, place)
    assert told.code == 2 and said in told.line and len(told.line) < 250, told.line


def test_a_default_of_another_program_is_no_word_beside_a_log(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "can.ini").write_text("[default]\ninterface = virtual\nchannel = can7\n")
    (tmp_path / "can.log").write_text("(0.000000) can0 18FEF100#01\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["headland", "inspect", "can.log", "--plain"])
    with pytest.raises(SystemExit) as ended:
        headland.main()
    assert ended.value.code == 0, capsys.readouterr()


@pytest.mark.parametrize(
    "words", ["report 'no\nsuch'", "chaos --seeds '1\n2'", "coverage solve 'no\nsuch.map'"]
)
def test_a_line_end_in_a_name_or_a_value_makes_no_second_line(
    words: str, place: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    assert Complaints(monkeypatch, capfd).of(words, place).code == 2


def test_the_greatest_seed_is_that_of_scenarios() -> None:
    assert panels.SEED_MAX == SEED_MAX


def test_a_gateway_that_is_refused_leaves_no_book(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    told = Complaints(monkeypatch, capfd).of("vda5050 --broker mqtt://127.0.0.1", tmp_path)
    assert told.code == 2 and not list(tmp_path.rglob("*")), told


def test_a_machine_without_a_reader_blames_no_port() -> None:
    reader, writer = os.pipe()
    os.close(reader)
    done = subprocess.run(
        [sys.executable, "-m", "tools.cli.headland", "machine", "--gnss", "0", "--wheels", "0",
         "--orders", "0"],
        stdout=writer, stderr=subprocess.PIPE, text=True, check=False, timeout=60,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    os.close(writer)
    assert (done.returncode, done.stderr) == (1, "")  # as of every command


@pytest.mark.parametrize("columns", ["0", "00", ""])
def test_no_columns_are_an_unknown_number(columns: str) -> None:
    assert "oxted" in process("list", COLUMNS=columns, LINES=columns).stdout


def process(*words: str, **environment: str) -> "subprocess.CompletedProcess[str]":
    code = "import sys; from tools.cli.headland import main; sys.argv[0] = 'headland'; main()"
    return subprocess.run(
        [sys.executable, "-c", code, *words], capture_output=True, text=True, check=False, timeout=60,
        env={**os.environ, "PYTHONPATH": str(ROOT), **environment},
    )  # fmt: skip


def test_without_a_word_there_is_help() -> None:
    done = process()
    assert "report" in done.stdout + done.stderr and "headland:" not in done.stderr


def test_help_loads_nothing_heavy() -> None:
    """So that it takes a fifth of a second: what a command needs it imports when it is called."""
    code = (
        "import sys, tools.cli.headland; print([m for m in ('numba', 'numpy', 'pydantic', 'can', "
        "'matplotlib', 'asyncio', 'shapely') if m in sys.modules])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    assert done.stdout.strip() == "[]"


def test_a_letter_that_the_c_locale_lacks_is_written_in_ascii(tmp_path: Path) -> None:
    name = tmp_path / "F.geojson"
    name.write_text(
        '{"type":"Feature","properties":{"name":"\u00c4"},"geometry":{"type":"Polygon",'
        '"coordinates":[[[0,0],[0.001,0],[0.001,0.001],[0,0.001],[0,0]]]}}', encoding="utf-8",
    )  # fmt: skip
    done = process(
        "fields",
        str(name),
        LC_ALL="C",
        PYTHONUTF8="0",
        PYTHONCOERCECLOCALE="0",
        PYTHONIOENCODING="",
    )
    assert done.returncode == 0 and "Traceback" not in done.stderr, done.stderr
    assert done.stdout.startswith("\\xc4: "), done.stdout


@pytest.mark.parametrize(("typed", "offered"), [("re", {"release", "report"}), ("bri", {"bridge"})])
def test_the_shell_completes_words(typed: str, offered: set[str]) -> None:
    done = process(
        _HEADLAND_COMPLETE="complete_bash", COMP_WORDS=f"headland {typed}", COMP_CWORD="1"
    )
    assert set(done.stdout.split()) == offered, done.stderr


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_can_be_shown(shell: str) -> None:
    done = process("--show-completion", shell, _TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION="1")
    assert done.returncode == 0 and "_HEADLAND_COMPLETE" in done.stdout, done.stderr


def test_types_are_told_by_every_package() -> None:
    import tomllib

    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]
    assert "py.typed" in project["package-data"]["*"]
    for layer in ("crdt", "protocol", "agent", "sim", "tools"):
        assert (ROOT / layer / "py.typed").is_file()
        assert f"{layer}*" in project["packages"]["find"]["include"]
        inside = {path.parent for path in (ROOT / layer).rglob("*.py")}
        assert all((folder / "__init__.py").is_file() for folder in inside), "or it is not packed"
