"""A wait says what it is and how long, to people alone."""

import sys

import pytest

from tools.common.told_wait import CLEAR, told_loading, told_wait


@pytest.mark.parametrize(
    ("terminal", "for_s", "told"), [(True, 5.0, True), (True, 2.0, False), (False, 5.0, False)]
)
def test_a_long_wait_is_told_at_a_terminal(
    terminal: bool, for_s: float, told: bool, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.setattr(sys.stderr, "isatty", lambda: terminal)
    with told_wait("until every robot confirms", for_s):
        said = capsys.readouterr().err
    after = capsys.readouterr().err
    assert said.startswith("until every robot confirms: up to 5 s; Ctrl-C ends it") is told
    assert bool(said) is told and after == (CLEAR if told else "")


def test_loading_is_told_at_a_terminal(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """`headland run small` was silent for two seconds of CPU before its bar."""
    for terminal in (True, False):
        monkeypatch.setattr(sys.stderr, "isatty", lambda terminal=terminal: terminal)
        with told_loading():
            said = capsys.readouterr().err
        assert said.startswith("loading the simulator") is terminal
        assert capsys.readouterr().err == (CLEAR if terminal else "")
