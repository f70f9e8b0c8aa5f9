"""Wrong words of scenario files: each must be one line that names what is wrong, and where."""

import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from sim.scenarios.field_setup import FieldSetup
from sim.scenarios.navigation_scenario import load_mission
from sim.scenarios.scenario import Scenario, ScenarioError

WHOLE = """name = "mine"
mission = "field"

[field]
file = "small.geojson"
implement_width_m = 4.0
overlap_m = 0.2
section_length_m = 60.0

[fleet]
robots = 3
radius_m = 0.8
speed_m_s = 2.5
silence = "continue"

[run]
seed = 1

[[fault]]
kind = "partition"
at_s = 10.0
islands = [[0, 1], [2]]

[[fault]]
kind = "estop"
at_s = 40.0
robot = 2
reason = "PERSON_IN_FIELD"

[[fault]]
kind = "box"
at_s = 50.0
x_m = 0.0
y_m = 0.0
for_s = 10.0
"""
# What is written instead of what, and the word that the error has to have.
TYPOS = """
[field] | [feild] | feild
[fleet] | [fleets] | fleets
[run] | [runs] | runs
[[fault]] | [[faults]] | faults
mission = "field" | mission = "feild" | feild
mission = "field" | mission = 3 | mission
name = "mine" | nmae = "mine" | nmae
name = "mine" | name = 7 | name
file = "small.geojson" | flie = "small.geojson" | flie
file = "small.geojson" | file = "smal.geojson" | smal.geojson
file = "small.geojson" | file = 5 | file
file = "small.geojson" | file = "" | file
implement_width_m = 4.0 | implement_width = 4.0 | implement_width
implement_width_m = 4.0 | implement_width_m = "wide" | implement_width_m
implement_width_m = 4.0 | implement_width_m = 0.0 | implement_width_m
implement_width_m = 4.0 | implement_width_m = -4.0 | implement_width_m
implement_width_m = 4.0 | implement_width_m = nan | implement_width_m
implement_width_m = 4.0 | implement_width_m = 4,0 | line 6
overlap_m = 0.2 | overlap = 0.2 | overlap
overlap_m = 0.2 | overlap_m = 9.0 | overlap
overlap_m = 0.2 | overlap_m = -0.2 | overlap_m
section_length_m = 60.0 | section_lenght_m = 60.0 | section_lenght_m
section_length_m = 60.0 | section_length_m = 0 | section_length_m
robots = 3 | robot = 3 | robot
robots = 3 | robots = "three" | robots
robots = 3 | robots = 0 | robots
robots = 3 | robots = 3.5 | robots
robots = 3 | robots = 100000 | robots
robots = 3 | robots = -1 | robots
robots = 3 | robots = 2 | robot
robots = 3 | robots = | line 11
radius_m = 0.8 | radius = 0.8 | radius
radius_m = 0.8 | radius_m = 0 | radius_m
speed_m_s = 2.5 | speed_ms = 2.5 | speed_ms
speed_m_s = 2.5 | speed_m_s = -2.5 | speed_m_s
speed_m_s = 2.5 | speed_m_s = inf | speed_m_s
silence = "continue" | silence = "contineu" | silence
silence = "continue" | silence = continue | line 14
silence = "continue" | silnce = "continue" | silnce
silence = "continue" | silence = true | silence
seed = 1 | sed = 1 | sed
seed = 1 | seed = "one" | seed
seed = 1 | seed = 1.5 | seed
kind = "partition" | kind = "partion" | partition
kind = "partition" | knd = "partition" | kind
kind = "partition" | kind = "" | kind
kind = "partition" | kind = 3 | kind
at_s = 10.0 | at = 10.0 | at_s
at_s = 10.0 | at_s = -1 | at_s
at_s = 10.0 | at_s = "soon" | at_s
at_s = 10.0 | at_s = nan | at_s
islands = [[0, 1], [2]] | islands = [[0, 1], [9]] | 9
islands = [[0, 1], [2]] | islands = [[0, 1], [1]] | two islands
islands = [[0, 1], [2]] | islands = [0, 1] | islands
islands = [[0, 1], [2]] | island = [[0, 1], [2]] | island
islands = [[0, 1], [2]] | islands = [["a"]] | islands
robot = 2 | robot = 3 | robot 3
robot = 2 | robot = -1 | robot
robot = 2 | robt = 2 | robt
reason = "PERSON_IN_FIELD" | reason = "PERSON" | reason
reason = "PERSON_IN_FIELD" | reason = "person_in_field" | reason
reason = "PERSON_IN_FIELD" | raeson = "PERSON_IN_FIELD" | raeson
x_m = 0.0 | x_m = 5000.0 | outside
x_m = 0.0 | x = 0.0 | fault.2.x
x_m = 0.0 | x_m = "here" | x_m
for_s = 10.0 | for_s = 0 | for_s
for_s = 10.0 | fors = 10.0 | for_s
for_s = 10.0 | for_s = 10.0 s | line
"""
CASES = [tuple(line.split(" | ")) for line in TYPOS.strip().splitlines()]


class ToldOfTypo(NamedTuple):
    """What a person is told about one wrong file."""

    text: str  # empty: it was taken
    good: bool  # one line, short, with the word


def answers() -> Iterator[tuple[tuple[str, ...], ToldOfTypo]]:
    """Each typo with what is said about it. What is not a ScenarioError goes up as it is."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "mine.toml")
        for case in CASES:
            right, wrong, word = case
            assert right in WHOLE, right
            path.write_text(WHOLE.replace(right, wrong, 1))
            text = ""
            try:
                scenario = load_mission(str(path))
                assert isinstance(scenario, Scenario)
                FieldSetup(scenario)
            except ScenarioError as problem:
                text = str(problem)
            good = 0 < len(text) <= 500 and "\n" not in text and word in text
            yield case, ToldOfTypo(text, good)
