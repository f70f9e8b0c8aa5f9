"""The chart of the README: robot-hours of chaos, the faults in them, and the rules that were broken.

The figures are those of `docs/measured/chaos_runs`, so the chart cannot say more than was measured.
"""

from html import escape
from pathlib import Path

from tools.chaos.chaos_report import survived

RUNS = Path(__file__).parents[2] / "docs" / "measured" / "chaos_runs"
WIDE, ROW, TOP, LEFT, RIGHT = 840, 22, 74, 170, 90  # pixels
KINDS = 24  # bars; rarer kinds are one bar more
NAMES = {
    "crash": "robots killed", "crash_working": "killed at work", "restart": "robots restarted",
    "estop": "stops pressed", "partition": "bus splits", "heal": "bus joined again",
    "errors": "CAN error bursts", "duplicate": "frames doubled", "loss": "frames lost",
    "omission": "frames heard by some", "freeze": "robots frozen", "one_way": "one-way links",
    "bus_off": "bus-off", "babble": "babbling nodes", "clock_jump": "clock jumps",
    "foreign": "foreign devices", "nonsense": "nonsense frames", "reset": "stops released",
    "disk_full": "full disks", "clone": "cloned robots", "twin": "same name twice",
    "blind": "blind robots", "join": "late robots", "order": "operator orders", "late": "late frames",
}  # fmt: skip


def chart() -> str:
    """An SVG that can be read on light and dark ground. Raises ReportError."""
    found = survived(RUNS)
    rows = [(NAMES.get(kind, kind.replace("_", " ")), n) for kind, n in found.faults.most_common()]
    rest = sum(count for _, count in rows[KINDS:])
    bars = rows[:KINDS] + ([(f"{len(rows) - KINDS} other kinds", rest)] if rest else [])
    most = max(count for _, count in bars)
    high = TOP + ROW * len(bars) + 16
    title = (
        f"{found.robot_hours:,.0f} robot-hours, {sum(found.faults.values()):,} injected faults, "
        f"{found.broken} rules broken"
    )
    note = f"{found.runs:,} simulated runs of the protocol; faults by kind; every run judged from outside"
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDE} {high}" width="{WIDE}" '
        f'height="{high}" role="img" font-family="system-ui, sans-serif">',
        f"<title>{escape(title)}</title>",
        f'<rect width="{WIDE}" height="{high}" rx="8" fill="#0e1316"/>',
        f'<text x="20" y="34" font-size="20" font-weight="600" fill="#e6edf0">{escape(title)}</text>',
        f'<text x="20" y="56" font-size="13" fill="#9db0ba">{escape(note)}</text>',
    ]
    for number, (name, count) in enumerate(bars):
        y = TOP + ROW * number
        wide = max((WIDE - LEFT - RIGHT) * count / most, 1)
        parts += [
            f'<text x="{LEFT - 8}" y="{y + 14}" font-size="13" fill="#e6edf0" text-anchor="end">'
            f"{escape(name)}</text>",
            f'<rect x="{LEFT}" y="{y + 2}" width="{wide:.0f}" height="16" rx="3" fill="#3b8ede"/>',
            f'<text x="{LEFT + wide + 8:.0f}" y="{y + 14}" font-size="12" fill="#9db0ba">'
            f"{count:,}</text>",
        ]
    return "\n".join([*parts, "</svg>"]) + "\n"
