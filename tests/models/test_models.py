"""The Spin models beside this file: the right ones hold in every state, the wrong ones are found wrong.

By hand: spin -a -DVARIANT stop.pml && cc -O2 -DSAFETY -o pan pan.c && ./pan -m1000000 -E
"""

import re
import shutil
import subprocess
from pathlib import Path

import pytest

HERE = Path(__file__).parent
COMPILER = shutil.which("gcc") or shutil.which("cc")
LIMIT_S = 120
HOLDS, FAILS = True, False
MODELS = [
    ("stop", "", HOLDS),
    ("stop", "AMNESIA", FAILS),
    ("stop", "AMNESIA FRESH_DOTS", FAILS),
    ("stop", "AMNESIA FRESH_DOTS BOOT_LATCHED", FAILS),
    ("stop", "REACH", FAILS),
    ("stop_epoch", "", FAILS),
    ("claim", "", HOLDS),
    ("claim", "AMNESIA", FAILS),
    ("claim", "LOCAL", FAILS),
    ("claim", "ONE_PEER", FAILS),
    ("claim", "REACH", FAILS),
    ("rejoin", "", HOLDS),
    ("rejoin", "HOLD_LOST", FAILS),
    ("rejoin", "RESET_STARTS", FAILS),
    ("rejoin", "NO_EXCHANGE", FAILS),
    ("rejoin", "REACH", FAILS),
]

pytestmark = [
    pytest.mark.skipif(shutil.which("spin") is None, reason="spin is not installed (apt: spin)"),
    pytest.mark.skipif(COMPILER is None, reason="no C compiler to build what spin writes"),
]


def call(folder: Path, *words: str) -> str:
    done = subprocess.run(
        words, cwd=folder, capture_output=True, text=True, check=False, timeout=LIMIT_S
    )
    assert done.returncode == 0, f"{words[0]}: {done.stdout}{done.stderr}"
    return done.stdout


@pytest.mark.sampled(3)
@pytest.mark.parametrize(("model", "variant", "holds"), MODELS)
def test_model(model: str, variant: str, holds: bool, tmp_path: Path) -> None:
    flags = [f"-D{name}" for name in variant.split()]
    call(tmp_path, "spin", "-a", *flags, str(HERE / f"{model}.pml"))
    assert COMPILER is not None
    # The search of a wrong model ends at once: there the compiler would take the longest.
    call(tmp_path, COMPILER, "-w", "-O2" if holds else "-O0", "-DSAFETY", "-o", "pan", "pan.c")
    said = call(tmp_path, str(tmp_path / "pan"), "-m1000000", "-E")
    found = re.search(r"errors: (\d+)", said)
    assert found is not None, said
    assert "max search depth too small" not in said and "out of memory" not in said, said
    assert (found[1] == "0") == holds, said
    if not holds:
        assert "assertion violated" in said, said


def test_every_variant_is_checked() -> None:
    """A variant that a model declares and no test builds would rot."""
    checked = {(model, name) for model, variant, _ in MODELS for name in variant.split()}
    declared = {
        (path.stem, name)
        for path in HERE.glob("*.pml")
        for name in re.findall(r"#ifn?def (\w+)", path.read_text())
    }
    sizes = {"PRESSES", "RESETS", "CRASHES"}
    assert {(model, name) for model, name in declared if name not in sizes} == checked
