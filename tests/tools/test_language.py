"""The language: a hundred phrases with their meaning, and what must never be understood wrongly."""

import json
import string
import tomllib
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tools.language.fleet_now import FleetNow, RobotNow
from tools.language.intent import INTENTS, At, Control, Goal, plain
from tools.language.places import Places, PlacesError
from tools.language.question import Question, Reason
from tools.language.reading import read
from tools.language.vocabulary import TABLE
from tools.language.weighing import Verdict, weigh

pytest.importorskip("lark")

FILE = Path(__file__).with_name("phrases.toml")
PHRASES: list[dict[str, Any]] = tomllib.loads(FILE.read_text())["phrase"]
PLACES = Places(
    {"shelf": (10.0, 0.0), "loading dock": (-20.0, 8.0), "dock": (0.0, 30.0), "gate": (50.0, 50.0)},
    {"S3": (70.0, 5.0), "S7": (-60.0, 40.0)},
)
