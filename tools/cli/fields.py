"""`headland fields`: what fields a file has, and what is wrong with which."""

from pathlib import Path
from typing import Final

from agent.runtime.declared_values import FieldTable
from agent.runtime.files.field_error import FieldFileError
from agent.runtime.files.field_file import fields_of, project
from agent.runtime.files.printable_text import printable
from sim.files.strict_json import dumps
from tools.common.exit_codes import WRONG, wrong

HECTARE_M2 = 10_000.0
# The implement with which a field file is run.
WIDTH_M: Final = float(FieldTable.model_fields["implement_width_m"].default)


def fields(file: Path, as_json: bool) -> int:
    """Exit code 0 where at least one field can be worked."""
    rows: list[dict[str, object]] = []
    try:
        outlines, broken = fields_of(file)
    except FieldFileError as problem:
        return wrong(problem)
    for name in sorted({*outlines, *broken}):
        try:
            if name in broken:
                raise broken[name]
            polygon = project(file, name, outlines[name]).polygon
            if polygon.buffer(-WIDTH_M / 2).is_empty:  # as `agent/field/field_division.py` judges
                raise FieldFileError(
                    f"{file}: {name} is nowhere as wide as the implement ({WIDTH_M} m)"
                )
            hectares = polygon.area / HECTARE_M2
            points = sum(map(len, outlines[name]))
            rows.append({"name": name, "hectares": round(hectares, 2), "points": points})
        except FieldFileError as problem:
            rows.append({"name": name, "wrong": str(problem)})
    if as_json:
        print(dumps(rows))
    else:
        for row in rows:
            told = row.get("wrong") or f"{row['hectares']} ha, {row['points']} points"
            print(printable(f"{row['name']}: {told}"))
    if any("wrong" not in row for row in rows):
        return 0
    return WRONG if rows else wrong(f"{file}: no polygon in it")
