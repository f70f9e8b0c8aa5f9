"""Known faults of the locked dependencies, from the advisory service of the index, where there is one.

`python -m tools.build.audit` is the last step of continuous integration. It tells what it finds and does
not fail: an advisory that is published later must not break a commit that was good. Without an advisory
service it says so. `make lock` writes a new lock file.
"""

import json
import subprocess
import sys
import tempfile
import venv
from pathlib import Path

ROOT = Path(__file__).parents[2]
LOCK = ROOT / "requirements.lock"
INSTALL_S, ASK_S = 120, 180  # time limits: continuous integration has 90 min in all


def audited(lock: Path = LOCK) -> str:
    """What is known, in lines for people."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        venv.create(folder, with_pip=True)
        bin_folder = folder / ("Scripts" if sys.platform == "win32" else "bin")
        install: list[str | Path] = [
            bin_folder / "python",
            "-m",
            "pip",
            "install",
            "--quiet",
            "pip-audit",
        ]
        ask: list[str | Path] = [
            bin_folder / "pip-audit", "--requirement", lock, "--disable-pip", "--no-deps",
            "--format", "json", "--progress-spinner", "off",
        ]  # fmt: skip
        try:
            subprocess.run(install, capture_output=True, timeout=INSTALL_S, check=True)
            done = subprocess.run(
                ask, capture_output=True, text=True, timeout=ASK_S, check=False, cwd=folder
            )
        except (OSError, subprocess.SubprocessError) as problem:
            return f"audit skipped: {type(problem).__name__}: pip-audit or its service is not to be had"
    return told(done.stdout, done.stderr)


def told(answer: str, errors: str = "") -> str:
    """The answer of pip-audit, JSON, in lines for people."""
    try:
        found = json.loads(answer)["dependencies"]
        faults = [
            f"audit: {each['name']} {each['version']}: {fault['id']}, mended in "
            f"{', '.join(fault['fix_versions']) or 'no version'}"
            for each in found for fault in each.get("vulns", ())
        ]  # fmt: skip
        unknown = sum("skip_reason" in each for each in found)
    except (KeyError, TypeError, ValueError):
        last = errors.strip().splitlines()[-1:] or ["no answer"]
        return f"audit skipped: no advisory service: {last[0][:200]}"
    if unknown == len(found):
        return "audit skipped: the advisory service knows none of the packages"
    count = f"audit: {len(faults)} known faults in {len(found)} packages, of which {unknown} are unknown"
    return "\n".join([*faults, count])


if __name__ == "__main__":
    print(audited())
