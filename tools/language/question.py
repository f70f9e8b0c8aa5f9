"""What is asked back instead of being obeyed, and why."""

from enum import StrEnum
from typing import NamedTuple


class QuestionReason(StrEnum):
    """Why a phrase is not obeyed."""

    NOT_UNDERSTOOD = "not understood"
    AMBIGUOUS = "ambiguous"
    UNSAFE = "unsafe"
    UNKNOWN_PLACE = "unknown place"
    UNKNOWN_ROBOT = "unknown robot"
    NOT_NOW = "not now"


class Question(NamedTuple):
    """One line for the person, and what could be said instead."""

    reason: QuestionReason
    text: str
    instead: tuple[str, ...] = ()

    def __str__(self) -> str:
        hint = f" (say: {'; or: '.join(self.instead)})" if self.instead else ""
        return f"{self.text}{hint}"
