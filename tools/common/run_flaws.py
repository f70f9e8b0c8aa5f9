"""What was wrong with a run, in words, from its figures."""

from typing import Any

from tools.common.counted import counted

# The figures that make a run flawed, each with the words for it.
FLAWS = {
    "contacts": "{} contact{s} of bodies",
    "moved_after_stop": "{} time{s} a robot moved after a stop",
    "implement_contacts": "implements met {} time{s}",
    "things_under_bars": "a lowered implement was over a person or a thing {} time{s}",
    "claims_lost": "{} claim{s} lost",
    "malformed": "{} malformed frame{s}", "uncovered": "{} cell{s} uncovered",
}  # fmt: skip
ALL_COVERED = 0.99995  # COVERAGE_MIN of sim/fleet/outcome.py, which would import numpy


def flaws(figures: dict[str, Any]) -> list[str]:
    """What was wrong with a run, in words, as far as its figures say; never empty."""
    found = []
    if figures.get("finished") is False:
        found.append("not all work was done")
    coverage = figures.get("coverage")
    if isinstance(coverage, float) and coverage < ALL_COVERED:
        left = f"{coverage:.2%} of the area is covered"
        missed, parts = figures.get("missed"), figures.get("unreached")
        if isinstance(missed, str) and missed:
            left += f" ({missed})"
        elif isinstance(parts, list):  # all is worked that can be
            why = "; ".join(str(p["why"]) for p in parts if isinstance(p, dict) and "why" in p)
            left += f" ({why})" if why else ""
        found.append(left)
    for key, told in FLAWS.items():
        count = figures.get(key)
        if isinstance(count, int) and not isinstance(count, bool) and count > 0:
            first = figures.get("first_contact") if key == "contacts" else None
            where = f" ({first})" if isinstance(first, str) and first else ""
            found.append(counted(count, told) + where)
    for key in ("replicas_equal", "maps_equal"):
        if figures.get(key) is False:
            found.append(f"{key.split('_')[0]} differ")
    return found or ["report.json has the figures"]
