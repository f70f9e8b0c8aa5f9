"""One page of HTML that needs nothing else: pictures are in it, and it may load nothing."""

from collections.abc import Iterable, Sequence
from html import escape
from typing import Any

from tools.common.run_flaws import flaws
from tools.inspect.inspector import NO_KEYS
from tools.report.chapter import ROWS_MAX, Chapter, Table

POLICY = "default-src 'none'; style-src 'unsafe-inline'; base-uri 'none'; form-action 'none'"
STYLE = """
:root { color-scheme: light dark; --ground: #fff; --text: #222; --dim: #595959; --edge: #ccc;
        --bad: #b00020; --good: #1a7f37; --note: #8a4b00; }
body { font: 15px/1.5 system-ui, sans-serif; margin: 2rem auto; max-width: 70rem; padding: 0 1rem;
       color: var(--text); background: var(--ground); }
h1 { font-size: 1.6rem; margin-bottom: 0.2rem; } .about { color: var(--dim); margin-top: 0; }
h2 { font-size: 1.2rem; margin-top: 2.5rem; border-bottom: 1px solid var(--edge); }
.picture { overflow-x: auto; } svg { max-width: 100%; height: auto; border-radius: 6px; }
.table { overflow-x: auto; }
@media (max-width: 40rem) { svg { max-width: none; min-width: 40rem; } h1 { font-size: 1.3rem; } }
table { border-collapse: collapse; margin: 0.7rem 0; font-size: 0.9rem; }
th, td { text-align: left; padding: 0.15rem 0.9rem 0.15rem 0; border-bottom: 1px solid var(--edge);
         font-variant-numeric: tabular-nums; vertical-align: top; }
a { color: inherit; } summary { cursor: pointer; margin-top: 1rem; }
.missing { color: var(--note); } .more { color: var(--dim); font-size: 0.85rem; }
.bad { color: var(--bad); font-weight: bold; } .good { color: var(--good); font-weight: bold; }
nav a { margin-right: 1rem; }
.tiles { display: grid; grid-template-columns: repeat(auto-fit, minmax(9rem, 1fr)); gap: 0.7rem;
         margin: 1rem 0; padding: 0; list-style: none; }
.tiles li { border: 1px solid var(--edge); border-radius: 8px; padding: 0.6rem 0.9rem; }
.tiles span { color: var(--dim); font-size: 0.85rem; display: block; }
.tiles b { font-size: 1.5rem; font-weight: normal; }
@media (prefers-color-scheme: dark) {
  :root { --ground: #12181b; --text: #e6edf0; --dim: #a5b4bc; --edge: #38474f;
          --bad: #ff8a94; --good: #6fdc93; --note: #ffc878; }
}
@media print { nav { display: none; } h2 { break-after: avoid; } svg { break-inside: avoid; } }
"""


def page(
    title: str, figures: dict[str, Any], chapters: Sequence[Chapter], beside: str, about: str = ""
) -> str:
    """`beside`: the folder of the files that lie next to it, for the names that it tells. `about`: a line
    below the title."""
    below = f'<p class="about">{escape(about)}</p>\n' if about else ""
    body = "".join(_chapter(chapter, beside) for chapter in chapters)
    links = "".join(f'<a href="#{c.name}">{escape(c.title)}</a>' for c in chapters)
    return (
        "<!doctype html>\n"
        f'<html lang="en"><head><meta charset="utf-8"><title>{escape(title)} · Headland</title>'
        f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">'
        '<meta name="viewport" content="width=device-width">'
        f"<style>{STYLE}</style></head><body><main>\n<h1>{escape(title)}</h1>\n{below}<nav>{links}</nav>\n"
        f"{_figures(figures)}{body}</main></body></html>\n"
    )


def _figures(figures: dict[str, Any]) -> str:
    """What the run said of itself: single values; what is nested is in its report.json."""
    if not figures:
        return (
            '<p class="missing">No report.json lies beside this log: no figures of the run.</p>\n'
        )
    verdict = ""
    if isinstance(figures.get("success"), bool):
        good = figures["success"]
        told = "without a flaw" if good else f"not without a flaw: {'; '.join(flaws(figures))}"
        verdict = f'<p class="{"good" if good else "bad"}">{escape(told)}</p>\n'
    if figures.get("authenticated") is False:
        verdict += f'<p class="bad">{escape(NO_KEYS)}</p>\n'
    rows = [
        (key.replace("_", " "), f"{value:.6g}" if isinstance(value, float) else value)
        for key, value in figures.items()
        if isinstance(value, str | int | float | bool)
    ]
    table = table_of((("figure", "value"), rows), len(rows))
    return f"{verdict}{_tiles(figures)}<details><summary>All figures</summary>{table}</details>\n"


TILES = (  # what it is called, keys of which the first one that there is counts, how it is told
    ("covered", ("coverage",), "{:.2%}"), ("explored", ("explored",), "{:.1%}"),
    ("delivered", ("delivered",), "{}"), ("arrived", ("arrived",), "{}"),
    ("time", ("makespan_s", "time_s", "simulated_s"), "{:.0f} s"), ("contacts", ("contacts",), "{}"),
    ("moved after a stop", ("moved_after_stop",), "{}"), ("replicas equal", ("replicas_equal",), "{}"),
    ("bus load", ("bus_load",), "{:.1%}"), ("driven", ("travel_m",), "{:.0f} m"),
)  # fmt: skip
TILES_MAX = 6
FIGURE_MAX = 1e15


def _tiles(figures: dict[str, Any]) -> str:
    """The six figures that people look for first."""
    found = []
    for name, keys, form in TILES:
        if name == "time" and figures.get("finished") is False:
            # Its makespan is when it last worked, 0 where it never did.
            keys = ("simulated_s", *keys)
        value = next((figures[key] for key in keys if key in figures), None)
        if isinstance(value, bool):
            text = "yes" if value else "no"
        elif isinstance(value, int | float) and abs(value) < FIGURE_MAX:
            text = form.format(value)
        else:
            continue  # what others wrote may be anything
        found.append(f"<li><span>{escape(name)}</span> <b>{escape(text)}</b></li>")
    return f'<ul class="tiles">{"".join(found[:TILES_MAX])}</ul>\n' if found else ""


def _chapter(chapter: Chapter, beside: str) -> str:
    parts = [f'<h2 id="{chapter.name}">{escape(chapter.title)}</h2>\n']
    if chapter.warning:
        parts.append(f'<p class="bad">{escape(chapter.warning)}</p>\n')
    if chapter.about:
        parts.append(f"<p>{escape(chapter.about)}</p>\n")
    if chapter.missing:
        parts.append(f'<p class="missing">{escape(chapter.missing)}</p>\n')
    if chapter.picture is not None:
        # In the page itself: its words can be searched, and a mark says what it is at the pointer.
        name = escape(f"picture: {chapter.title}", quote=True)
        drawn = chapter.picture.svg.decode()
        parts.append(
            f'<div class="picture" role="group" aria-label="{name}" tabindex="0">{drawn}</div>\n'
        )
    if chapter.table is not None:
        about = escape(f"table: {chapter.title}", quote=True)
        table = table_of(chapter.table, ROWS_MAX)
        parts.append(
            f'<div class="table" role="group" aria-label="{about}" tabindex="0">{table}</div>\n'
        )
    names = [f"{chapter.name}.{kind}" for kind in files(chapter)]
    if names:
        links = ", ".join(
            f'<a href="{escape(f"{beside}/{name}", quote=True)}">{escape(name)}</a>'
            for name in names
        )
        parts.append(f'<p class="more">{links}</p>\n')
    return "".join(parts)


def files(chapter: Chapter) -> Iterable[str]:
    """The kinds of file that a chapter leaves beside the page."""
    if chapter.picture is not None:
        yield "svg"
    if chapter.values is not None:
        yield "csv"


def table_of(table: Table, most: int) -> str:
    """HTML of a table, with at most `most` rows, and a line that says how many more there are."""
    head, rows = table
    cells = "".join(f"<th>{escape(str(name))}</th>" for name in head)
    lines = "".join(
        "<tr>" + "".join(f"<td>{escape(str(value))}</td>" for value in row) + "</tr>\n"
        for row in rows[:most]
    )
    more = f'<p class="more">{len(rows) - most} more rows</p>\n' if len(rows) > most else ""
    return f"<table><thead><tr>{cells}</tr></thead><tbody>\n{lines}</tbody></table>\n{more}"
