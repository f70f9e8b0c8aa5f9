"""A process of ours that is started as a module of this very installation.

`python -m` searches the working folder first, where a person may have a `tools` or an `agent` of their
own. `-P` excludes that folder.
"""

import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def module_command(module: str) -> list[str]:
    """The words that start it; its own arguments follow."""
    start = (
        f"import runpy, sys; sys.path.append({str(ROOT)!r}); "
        f"runpy.run_module({module!r}, run_name='__main__', alter_sys=True)"
    )
    return [sys.executable, "-P", "-c", start]
