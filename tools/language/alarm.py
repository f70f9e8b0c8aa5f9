"""Whether a phrase may be an alarm. Then every robot is held, before a question is asked.

A hold latches nothing, takes no work away and ends with a start. A false alarm costs a stop of some
seconds. A missed alarm may cost a person. So a phrase is an alarm if any part of it may be one.
"""

from collections.abc import Sequence

from tools.language.places import Places
from tools.language.vocabulary import KNOWN_WORDS, words_of

# Words that are said when something must stop. A phrase that is understood never comes here.
ALARM_WORDS = frozenset((
    "stop", "stops", "stopp", "halt", "freeze", "brake", "abort", "estop", "whoa", "woah", "wow",
    "hold", "pause", "help", "emergency", "emergencies", "danger", "dangerous", "careful",
    "caution", "warning", "alarm", "mayday", "sos", "accident", "collision", "collide", "hurt",
    "injured", "injury", "blood", "fire", "smoke", "child", "children", "kid", "kids", "baby",
    "person", "people", "human", "man", "men", "woman", "women", "boy", "girl", "worker",
    "pedestrian", "dog", "cat", "animal", "horse", "cow", "deer", "trapped", "stuck", "crush",
    "crushed", "kill", "terminate", "shutdown", "shut", "deactivate", "disarm", "deenergize",
    "unplug", "power", "off", "cease", "desist", "quit", "enough",
))  # fmt: skip
# Groups of words that mean standing still although no word of them does.
ALARM_GROUPS = (
    "do not move", "don't move", "dont move", "nobody move", "no one move", "nobody moves",
    "no one moves", "no moving", "no more", "not move", "stay where you are", "stay there", "stay put",
    "stay still", "stand still", "keep still", "sit still", "look out", "watch out", "not so fast",
    "in the way", "in front of", "run over", "get out", "kill switch", "let go", "cut it", "cut the",
    "back off", "hands off", "turn it off", "turn off", "turn them off", "switch off", "switch it off",
    "switch them off",
)  # fmt: skip
# Ordinary words one letter away from a word of stopping. They are no misspelling.
NO_MISSPELLING = frozenset((
    "shop", "step", "steps", "top", "tops", "spot", "spots", "slop", "stow", "atop", "crop",
    "drop", "sop", "stomp", "strop", "malt", "salt", "hall", "halo", "hale", "shalt", "hat",
    "break", "broke", "brave", "brace", "bake", "brakes", "breeze", "about", "abode",
))  # fmt: skip
MISSPELT_OF = ("stop", "halt", "freeze", "brake", "abort", "estop", "emergency")
LETTERS_MIN = 3  # a shorter word is one letter away from too many others


def may_be_alarm(phrase: str, places: Places) -> bool:
    """Whether somebody that says this may want everything to stand. Names of places do not count.

    >>> may_be_alarm("sotp", Places({})), may_be_alarm("where is robot 2", Places({}))
    (True, False)
    """
    words = words_of(phrase)
    named = {word for group in places.groups for word in group}
    said = [word for word in words if word not in named]
    text = f" {' '.join(words)} "
    if any(f" {group} " in text for group in ALARM_GROUPS):
        return True
    return any(word in ALARM_WORDS or is_misspelt_stop(word) for word in said)


def is_misspelt_stop(word: str) -> bool:
    """One letter is another, missing, doubled, or two neighbours have changed places.

    >>> [is_misspelt_stop(word) for word in ("stp", "stoop", "shop", "stopped", "emergncy")]
    [True, True, False, False, True]
    """
    if len(word) < LETTERS_MIN or word in NO_MISSPELLING or word in KNOWN_WORDS:
        return False
    return any(letters_apart(word, meant) <= 1 for meant in MISSPELT_OF)


def letters_apart(one: Sequence[str], two: Sequence[str]) -> int:
    """Optimal string alignment distance: letters changed, missing, added, or swapped with a neighbour.

    >>> letters_apart("sotp", "stop"), letters_apart("broken", "brake")
    (1, 2)
    """
    before, row = list[int](), list(range(len(two) + 1))
    for i, a in enumerate(one, 1):
        next_row = [i]
        for j, b in enumerate(two, 1):
            cost = min(row[j] + 1, next_row[j - 1] + 1, row[j - 1] + (a != b))
            if i > 1 and j > 1 and a == two[j - 2] and one[i - 2] == b:
                cost = min(cost, before[j - 2] + 1)
            next_row.append(cost)
        before, row = row, next_row
    return row[-1]
