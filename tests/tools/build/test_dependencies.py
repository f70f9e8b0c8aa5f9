"""The lock file fits what the packages declare, and the audit of it says what it could do."""

import json
import re
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version

from tools.build.audit import LOCK, ROOT, audited, told

PIN = re.compile(r"^([A-Za-z0-9._-]+)(?:\[[^\]]*\])?==([^\s;\\]+)", re.MULTILINE)
HASH = re.compile(r"--hash=sha256:[0-9a-f]{64}\b")


def locked() -> dict[str, list[str]]:
    found: dict[str, list[str]] = {}
    for name, version in PIN.findall(LOCK.read_text()):
        found.setdefault(canonicalize_name(name), []).append(version)
    return found


def declared() -> list[Requirement]:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    texts = list(project["dependencies"])
    for extra in project["optional-dependencies"].values():
        texts += extra
    return [r for r in map(Requirement, texts) if canonicalize_name(r.name) != "headland"]


def test_every_declared_package_is_locked_in_a_version_that_fits() -> None:
    versions = locked()
    for requirement in declared():
        found = versions.get(canonicalize_name(requirement.name), [])
        assert found, f"{requirement}: not in requirements.lock: call 'make lock'"
        for version in found:
            assert requirement.specifier.contains(Version(version), prereleases=True), (
                f"{requirement}: locked is {version}: call 'make lock'"
            )


def test_every_locked_package_has_hashes() -> None:
    blocks = re.split(r"\n(?=[A-Za-z0-9])", LOCK.read_text())
    pinned = [block for block in blocks if PIN.match(block)]
    assert len(pinned) == sum(map(len, locked().values())) > 50
    for block in pinned:
        assert HASH.search(block), block.splitlines()[0]


def test_the_lock_names_no_other_index() -> None:
    text = LOCK.read_text()
    assert "://" not in text and "--index" not in text and "--find-links" not in text


def test_the_audit_tells_faults_and_their_mended_versions() -> None:
    answer = {"dependencies": [
        {"name": "a", "version": "1", "vulns": [{"id": "PYSEC-1", "fix_versions": ["2"]}]},
        {"name": "b", "version": "1", "vulns": []}, {"name": "c", "skip_reason": "unknown"},
    ]}  # fmt: skip
    text = told(json.dumps(answer))
    assert (
        "a 1: PYSEC-1, mended in 2" in text
        and "1 known faults in 3 packages, of which 1 are unknown" in text
    )


@pytest.mark.parametrize("answer", ["", "no JSON", "[]", '{"dependencies": [{"vulns": [{}]}]}'])
def test_an_audit_without_an_answer_is_skipped_with_a_reason(answer: str) -> None:
    assert (
        told(answer, "first\nno such service\n")
        == "audit skipped: no advisory service: no such service"
    )


@pytest.mark.slow
def test_the_audit_ends_in_time_wherever_it_runs(tmp_path: Path) -> None:
    lock = tmp_path / "requirements.lock"
    lock.write_text(LOCK.read_text())
    assert audited(lock).splitlines()[-1].startswith(("audit: ", "audit skipped: "))
