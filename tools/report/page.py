"""One page of HTML that needs nothing else: pictures are in it, and it may load nothing."""

from base64 import b64encode
from collections.abc import Iterable, Sequence
from html import escape
from typing import Any

from tools.report.chapter import ROWS_MAX, Chapter, Table

POLICY = (
    "default-src 'none'; img-src data:; style-src 'unsafe-inline'; base-uri 'none'; "
    "form-action 'none'"
)
STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; margin: 2rem auto; max-width: 70rem; padding: 0 1rem;
       color: #222; background: #fff; }
h1 { font-size: 1.6rem; } h2 { font-size: 1.2rem; margin-top: 2.5rem; border-bottom: 1px solid #ccc; }
img { max-width: 100%; height: auto; }
table { border-collapse: collapse; margin: 0.7rem 0; font-size: 0.9rem; }
th, td { text-align: left; padding: 0.15rem 0.9rem 0.15rem 0; border-bottom: 1px solid #e5e5e5;
         font-variant-numeric: tabular-nums; vertical-align: top; }
.missing { color: #8a4b00; } .more { color: #666; font-size: 0.85rem; }
.bad { color: #b00020; font-weight: bold; } .good { color: #1a7f37; font-weight: bold; }
nav a { margin-right: 1rem; }
@media print { nav { display: none; } h2 { break-after: avoid; } img { break-inside: avoid; } }
"""


def page(title: str, figures: dict[str, Any], chapters: Sequence[Chapter], beside: str) -> str:
    """`beside`: the folder of the files that lie next to it, for the names that it tells."""
    body = "".join(_chapter(chapter, beside) for chapter in chapters)
    links = "".join(f'<a href="#{c.name}">{escape(c.title)}</a>' for c in chapters)
    return (
        "<!doctype html>\n"
        f'<html lang="en"><head><meta charset="utf-8"><title>{escape(title)}</title>'
        f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">'
        '<meta name="viewport" content="width=device-width">'
        f"<style>{STYLE}</style></head><body>\n<h1>{escape(title)}</h1>\n<nav>{links}</nav>\n"
        f"{_figures(figures)}{body}</body></html>\n"
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
        told = "without a flaw" if good else "not without a flaw"
        verdict = f'<p class="{"good" if good else "bad"}">{told}</p>\n'
    rows = [
        (key.replace("_", " "), f"{value:.6g}" if isinstance(value, float) else value)
        for key, value in figures.items()
        if isinstance(value, str | int | float | bool)
    ]
    return verdict + table_of((("figure", "value"), rows), len(rows))


def _chapter(chapter: Chapter, beside: str) -> str:
    parts = [f'<h2 id="{chapter.name}">{escape(chapter.title)}</h2>\n']
    if chapter.about:
        parts.append(f"<p>{escape(chapter.about)}</p>\n")
    if chapter.missing:
        parts.append(f'<p class="missing">{escape(chapter.missing)}</p>\n')
    if chapter.picture is not None:
        data = b64encode(chapter.picture).decode()
        parts.append(f'<img alt="{escape(chapter.title)}" src="data:image/png;base64,{data}">\n')
    if chapter.table is not None:
        parts.append(table_of(chapter.table, ROWS_MAX))
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
        yield "png"
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
