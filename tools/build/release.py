"""A release by one command: `make release VERSION=0.5.0`.

It moves the fragments of `changes/` into the changelog, sets the version, builds and checks the wheel,
commits, and tags. Nothing is pushed.
"""

import argparse
import re
import subprocess
import sys
import tomllib
from datetime import UTC, date, datetime
from pathlib import Path
from zipfile import ZipFile

from packaging.version import InvalidVersion, Version

ROOT = Path(__file__).parents[2]
HEADING = re.compile(r"^## ", re.MULTILINE)
SUBJECTS = {  # of the numbers that fragments begin with
    "24": "Working a field", "25": "Code", "26": "Planning", "27": "Machines", "28": "Trust and keys",
    "29": "The bus", "30": "Other systems", "31": "People",
}  # fmt: skip
OTHER = "Other changes"


class ReleaseError(Exception):
    """One line for the person."""


def section(version: str, day: date, fragments: dict[str, str]) -> str:
    """The text of a release in the changelog. `fragments`: their texts by file name."""
    by_subject: dict[str, list[str]] = {}
    for name, text in sorted(fragments.items()):
        subject = SUBJECTS.get(name.partition("-")[0], OTHER)
        by_subject.setdefault(subject, []).append(text.strip())
    parts = [f"### {subject}\n\n" + "\n".join(items) for subject, items in by_subject.items()]
    return f"## {version} ({day:%Y-%m-%d})\n\n" + "\n\n".join(parts) + "\n\n"


def with_section(changelog: str, text: str) -> str:
    """The changelog with a release before all others. Raises ReleaseError."""
    found = HEADING.search(changelog)
    if found is None:
        raise ReleaseError("CHANGELOG.md: no release is in it")
    return changelog[: found.start()] + text + changelog[found.start() :]


def checked(new: str, old: str) -> str:
    """The new version in its normal form. Raises ReleaseError unless it is above the old one."""
    try:
        version = Version(new)
    except InvalidVersion:
        raise ReleaseError(f"{new}: not a version; write it as 0.5.0") from None
    if version <= Version(old):
        raise ReleaseError(f"{new}: not above {old}, which is the version of pyproject.toml")
    return str(version)


def check_wheel(wheel: Path, version: str) -> None:
    """Raises ReleaseError where the wheel has another version, or installs another name."""
    with ZipFile(wheel) as archive:
        tops = {name.split("/")[0] for name in archive.namelist()}
    if tops != {"headland", f"headland-{version}.dist-info"}:
        raise ReleaseError(f"{wheel.name}: installs {', '.join(sorted(tops))}")


def release(new: str, root: Path = ROOT, *, dry: bool = False) -> str:
    """Make the release; returns its section of the changelog. Raises ReleaseError.

    `dry`: change nothing."""
    project = root / "pyproject.toml"
    old = tomllib.loads(project.read_text())["project"]["version"]
    version = checked(new, old)
    files = [path for path in sorted((root / "changes").glob("*.md")) if path.name != "README.md"]
    if not files:
        raise ReleaseError("changes/: nothing to release")
    if not dry and _run(root, "git", "status", "--porcelain"):
        raise ReleaseError("the working tree has changes that are not committed")
    today = datetime.now(UTC).date()
    text = section(version, today, {path.name: path.read_text() for path in files})
    if dry:
        return text
    changelog = root / "CHANGELOG.md"
    changelog.write_text(with_section(changelog.read_text(), text))
    project.write_text(
        project.read_text().replace(f'version = "{old}"', f'version = "{version}"', 1)
    )
    for path in files:
        path.unlink()
    print("building the wheel, about half a minute ...", file=sys.stderr)
    _run(root, sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "-w", "dist", ".")
    check_wheel(root / "dist" / f"headland-{version}-py3-none-any.whl", version)
    _run(root, "git", "commit", "--quiet", "--all", "--message", f"Release {version}")
    _run(root, "git", "tag", "--annotate", f"v{version}", "--message", f"Headland {version}")
    return text


def _run(root: Path, *words: str) -> str:
    done = subprocess.run(words, cwd=root, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        lines = done.stderr.strip().splitlines() or ["it failed"]
        raise ReleaseError(f"{' '.join(words[:4])}: {lines[-1]}")
    return done.stdout


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(prog="python -m tools.build.release", description=__doc__)
    parser.add_argument("version", help="above that of pyproject.toml, for example 0.5.0")
    parser.add_argument("--dry-run", action="store_true", help="only print the changelog's section")
    options = parser.parse_args()
    try:
        text = release(options.version, dry=options.dry_run)
    except (ReleaseError, OSError) as problem:
        print(f"release: {problem}", file=sys.stderr)
        sys.exit(2)
    if options.dry_run:
        print(text)
    else:
        print(f"released: tag v{options.version}, the wheel is in dist; git push --follow-tags")


if __name__ == "__main__":
    main()
