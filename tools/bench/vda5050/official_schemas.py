"""The official JSON schemas of VDA 5050 2.1, as the package vda5050-sdk (MIT) ships them.

Their source is https://github.com/VDA5050/VDA5050, folder json_schemas. They are not ours and no copy is
kept here.
"""

import json
from functools import cache
from importlib.resources import files
from importlib.util import find_spec
from typing import Any

from agent.runtime.vda5050.messages import Topic
from tools.bench.systems import CounterpartAbsent


@cache
def schema_of(topic: Topic) -> Any:
    """The validator of a topic. Raises CounterpartAbsent."""
    for package in ("jsonschema", "vda5050"):
        if find_spec(package) is None:
            raise CounterpartAbsent("pip install jsonschema vda5050-sdk: it has the schemas")
    import jsonschema

    text = files("vda5050.validation").joinpath("schemas", f"{topic}.json").read_text()
    return jsonschema.Draft202012Validator(
        json.loads(text), format_checker=jsonschema.FormatChecker()
    )


def flaws(topic: Topic, message: Any) -> list[str]:
    """Where a message differs from the official schema; empty: it is valid."""
    return [
        f"{'/'.join(map(str, problem.absolute_path))}: {problem.message}"
        for problem in schema_of(topic).iter_errors(message)
    ]
