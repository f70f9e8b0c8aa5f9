"""The reference and the schema of scenario files agree with what the reader accepts."""

import json
import tomllib
from pathlib import Path

import jsonschema
import pytest

from sim.scenarios.scenario_kind import all_shipped
from tests.tools.complaint import Complaints
from tools.cli.scenario_pages import KINDS, meaning, schema

FIELD = 'name = "x"\n[field]\nfile = "small.geojson"\n'
WRONG = {
    'name = "x"\n[feild]\nfile = "small.geojson"\n': "line 2: feild: unknown key; did you mean 'field'",
    FIELD + '[vehicle]\ndrive = "ackermann"\n': "line 4: vehicle: unknown key",  # also a kind of fault
    FIELD + '[[fault]]\nkind = "heal"\nat_s = 1\ncrash = 2\n': "line 7: fault.0.crash: unknown key",
    FIELD + "[fleet]\nrobotz = 3\n": "line 5: fleet.robotz: unknown key; did you mean 'robots'",
    FIELD + '[fleet]\nrobots = "six"\n': "line 5: fleet.robots: not a whole number: 'six'",
    FIELD + '[fleet]\ndrive = "mecanun"\n': "did you mean 'mecanum'",
    FIELD + '[[fault]]\nkind = "partion"\nat_s = 1\n': "line 4: fault.0.kind: not 'partion'; did you",
    FIELD + '[[fault]]\nat_s = 1\n': "line 4: fault.0.kind: is missing",
    FIELD + '[[fault]]\nkind = "heal"\nat_s = 1\n[[fault]]\nkind = "crash"\nat = 30\nrobot = 1\n':
        "line 9: fault.1.at: unknown key; did you mean 'at_s'",
    FIELD + '[[fault]]\nkind = "estop"\nat_s = 1\nrobot = 0\nreason = "PERSON"\n': "PERSON_IN_FIELD",
    FIELD + '[[fault]]\nkind = "crash"\nat_s = 1\nrobot = 9\n': "line 7: fault.0.robot: robot 9",
    FIELD + '[[fault]]\nkind = "one_way"\nat_s = 3\nsender = 50\nreceiver = 0\n': "fault.0.sender",
    FIELD + '[[fault]]\nkind = "box"\nat_s = 3\nx_m = 5000\ny_m = 0\nfor_s = 3\n': "outside of the field",
    FIELD + '[[fault]]\nkind = "order"\norder = "set_goal"\nat_s = 3\nrobot = 0\nx_m = 900\n': "outside",
    FIELD + '[[fault]]\nkind = "partition"\nat_s = 3\nislands = [[0, 1], [1]]\n': "on two islands",
    'mission = "feild"\n' + FIELD: "line 1: mission: not 'feild'; did you mean 'field'",
    'mission = "explore"\n' + FIELD: "exploration",
    'name = "x"\nmission = "delivery"\n[warehouse]\nmap = "x"\nbay = []\n': "did you mean 'bays'",
}  # fmt: skip


@pytest.mark.parametrize("text", WRONG)
def test_a_wrong_scenario_is_named_with_line_and_what_was_meant(
    text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "bad.toml").write_text(text)
    said = Complaints(monkeypatch, capfd).of("check bad.toml", tmp_path)
    assert said.code == 2 and WRONG[text] in said.line


@pytest.mark.parametrize("name", all_shipped())
def test_the_schema_accepts_what_ships(name: str) -> None:
    jsonschema.Draft202012Validator.check_schema(schema())
    document = tomllib.loads(all_shipped()[name].read_text())
    jsonschema.validate(document, schema(), cls=jsonschema.Draft202012Validator)


@pytest.mark.parametrize(
    "text", [text for text, why in WRONG.items() if "line" in why and "9" not in why]
)
def test_the_schema_refuses_what_the_reader_refuses(text: str) -> None:
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(tomllib.loads(text), schema())


def test_every_key_has_its_meaning() -> None:
    document = schema()
    for name, table in document["$defs"].items():
        assert all(meaning(name, key) for key in table["properties"])
    assert len(document["oneOf"]) == len(KINDS) and json.loads(json.dumps(document)) == document
