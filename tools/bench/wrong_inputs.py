"""Wrong files, numbers, folders, ports and names, over all commands: each is one line that names it.

`headland bench people` counts those that are not, and a test has each as a case of its own.
"""

import os
import shlex
import socket
import sys
from collections.abc import Iterator
from contextlib import chdir, contextmanager, redirect_stderr, redirect_stdout
from importlib import import_module
from io import StringIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

from tools.common.child_process import PREFIX

LINE_MAX = 500  # characters that a person reads
# What is typed behind `headland`, and the word by which the line says what is wrong. TAKEN: a port
# in use.
# `loop` and its like are links to themselves: even root cannot read them.
INPUTS = """
new mine.txt | mine.txt
new mine.toml --like nowhere | nowhere
new file/x.toml | file/x.toml
new /proc/x.toml | /proc/x.toml
check nowhere.toml | nowhere.toml
check loop.toml | loop.toml
check dir.toml | dir.toml
check latin.toml | latin.toml
check empty.toml | name
check nan.toml | line 4
check noname.toml | name
fields loop.geojson | loop.geojson
fields folder | TASKDATA.XML
fields bin.zip | bin.zip
plan small --robots -3 | -3
plan small --out file/x | file/x
plan small --done bin.json | bin.json
plan warehouse | delivery
robot dir.toml | dir.toml
robot empty.toml | name
robot robot.toml --slot 99 | 99
tc nan.geojson --port 1 | nan.geojson
tc good.geojson --accuracy nan | --accuracy
tc good.geojson --hitch inf | --hitch
tc good.geojson --keys bin.json --port 1 | bin.json
order 1 set-goal 1e999,0 | 1e999,0
order 1 wait --timeout -1 | --timeout
order 1 wait 3,4 --port 1 | no place
say status --by nobody --port 1 | nobody
say status --timeout nan | --timeout
say status --endpoint nonsense --read | nonsense
say "go home" --places loop.toml --read | loop.toml
task add nan,1 2,3 --port 1 | nan,1
task add --file folder --port 1 | folder
hub --port TAKEN | TAKEN
hub --host nowhere.invalid --port 0 | --host
bridge --segment -1 --listen tcp/127.0.0.1:0 --port 1 | --segment
bridge --segment 1 --config bin.json --port 1 | bin.json
bridge --segment 1 --seconds nan | --seconds
vda5050 --broker ftp://here | ftp://here
vda5050 --scenario small --broker mqtt://127.0.0.1:1 --port 1 | kind
mapf dir.toml | dir.toml
mapf open.map --robots x | --robots
mapf open.map --robots 99 | 99
mapf open.map --robots 2 --loss 7 | --loss
mapf open.map --robots 2 --out file/x | file/x
mapf open.map --robots 2 --picture x.doc | x.doc
export folder --film a.txt | folder
run small --limit nan | --limit
run small --limit -1 | --limit
run nan.toml | line 4
run loop.toml | loop.toml
run small --out loop | loop
launch small --seconds -1 | --seconds
launch small --robots 0 | robots
launch small --metrics soon | soon
launch small --metrics TAKEN --seconds 1 | TAKEN
launch small --foxglove TAKEN --seconds 1 | TAKEN
launch small --keys loop.json | loop.json
inspect empty.log --speed nan | --speed
inspect loop | loop
inspect runx | runx
report empty.log -o folder | folder
keys rotate loop | loop
keys show loop.json | loop.json
keys revoke 1 folder | folder
keys operator "" --folder folder | folder
stop --timeout -1 | --timeout
release --host nowhere.invalid --port 9 | nowhere.invalid
map loop | loop
map empty.log --page-port -1 | --page-port
coverage replay loop | loop
coverage replay nan.json | nan.json
coverage solve open.map --robots 99 | 99
body-check nowhere | nowhere
machine --gnss 0 --orders 0 --wheels TAKEN | TAKEN
chaos --scenario nan.toml | line 4
fuzz frame --input folder | folder
bench people --seed x | --seed
stop --timeout 2s | '2s' is not a number
stop --port 70000 | '70000' should be
stop --host "" --port 5 | :5
order two wait --port 1 | 'two' is not a whole number
order 2 wiat --port 1 | go-home
order 2 set-goal 12,5m --port 1 | 12,5m
release --start yes | yes
task add 1;2 3,4 --port 1 | 1;2
say "" --read | headland say
say --log absent.log status | absent.log
inspect empty.log --why 7x | 7x
inspect noise.asc | noise.asc: not a CAN log: it is no text
map --metrics 1:2:3 --port 1 | 1:2:3: a port
report folder | folder: no such log
map folder | folder: no such log
export folder --bag y --storage sqlite | 'sqlite' is not one of 'mcap', 'sqlite3'
plan small --drive tank | tank
plan small --done absent.geojson | absent.geojson
dbc headland.dbc --addresses 128..133 | 128..133
keys operator bob --folder folder --roles king | king
keys make | keys --help
new file | .toml
run smal | small
run open.map --film | is a grid map
run small --out file | --out file: is a file; name a folder
run small --limit 5min | '5min' is not a number
run small --feature nosuch | nosuch
run small --robots 1000 | 108
launch small --seconds 5s | '5s' is not a number
launch small --hub 99999 | '99999' should be
hub --bitrate fast | 'fast' is not a whole number
hub --bitrate 0 | 1000
bridge --segment 1 --zenoh nonsense --port 1 | nonsense: no endpoint
vda5050 | --broker
chaos --seeds a:b | a:b
doctor now | now
dbc headland.dbc --addresses 300 | 300
dbc folder/x.cdd | x.cdd
"""
CASES = [tuple(line.split(" | ")) for line in INPUTS.strip().splitlines()]
NOISE = bytes(range(256)) * 8
SQUARE = "[[[0,0],[0.002,0],[0.002,0.002],[0,0.002],[0,0]]]"
ROBOTS = '[fleet]\nrobots = 2\n[body]\nfactory = "standing"\n[[machine]]\nslot = 0\n'
TEXTS = {
    "file": "x",
    "empty.log": "",
    "empty.toml": "",
    "bin.json": '{"a":',
    "nan.json": '{"plan": NaN}',
    "nan.toml": 'name = "n"\n[field]\nfile = "small.geojson"\nimplement_width_m = nan\n',
    "noname.toml": 'name = ""\n[field]\nfile = "small.geojson"\n',
    "nan.geojson": '{"type": "Polygon", "coordinates": [[[NaN, 0], [1, 0], [1, 1], [NaN, 0]]]}',
    "good.geojson": f'{{"type": "Polygon", "coordinates": {SQUARE}}}',
    "robot.toml": 'name = "m"\n'
    + ROBOTS
    + '[field]\nfile = "good.geojson"\nimplement_width_m = 3.0\n',
    "open.map": "type octile\nheight 4\nwidth 4\nmap\n" + "....\n" * 4,
}


class ToldOfInput(NamedTuple):
    """How a command ended."""

    code: object
    text: str  # of standard error
    good: bool  # one short line of ours with the word, and exit code 1 or 2


def make_place(folder: Path) -> None:
    """The files of the cases: few of them are what they are called."""
    for name, text in TEXTS.items():
        (folder / name).write_text(text, encoding="utf-8")
    (folder / "bin.zip").write_bytes(NOISE)
    (folder / "noise.asc").write_bytes(NOISE)
    (folder / "latin.toml").write_bytes('name = "Grün"'.encode("latin-1"))
    for name in ("folder", "dir.toml", "runx/can.log"):
        (folder / name).mkdir(parents=True)
    for name in ("loop", "loop.toml", "loop.json", "loop.geojson"):
        (folder / name).symlink_to(name)


@contextmanager
def taken_port() -> Iterator[str]:
    """A port of loopback that another program listens on."""
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        listener.listen()
        yield str(listener.getsockname()[1])


def ending(words: str, word: str, taken: str) -> ToldOfInput:
    """The end of one call in this process and the present folder. What is no end of ours goes up."""
    # As a program, like `python -m`, but in this process: its imports are paid for once.
    headland = import_module(PREFIX + "tools.cli.headland")
    said, code, before = StringIO(), None, sys.argv
    sys.argv = ["headland", *shlex.split(words.replace("TAKEN", taken))]
    try:
        with redirect_stderr(said), redirect_stdout(StringIO()):
            headland.main()
    except SystemExit as end:
        code = end.code
    finally:
        sys.argv = before
    text = said.getvalue()
    line = text.startswith("headland: ") and text.count("\n") == 1 and len(text) <= LINE_MAX
    return ToldOfInput(code, text, code in (1, 2) and line and word.replace("TAKEN", taken) in text)


def answers() -> Iterator[tuple[tuple[str, ...], ToldOfInput]]:
    """Each input with what is said about it."""
    with TemporaryDirectory() as folder, taken_port() as taken, chdir(folder):
        make_place(Path())
        os.environ.pop("CAN_INTERFACE", None)
        for words, word in CASES:
            yield (words, word), ending(words, word, taken)
