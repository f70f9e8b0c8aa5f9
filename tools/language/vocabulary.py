"""The words of the language: each word, or group of words, is one token of the grammar.

A group of words comes before its parts ("go on" is no GO). A word that is not here is no word of the
language, and a phrase with such a word is asked back. Only the words in FILLERS may stand anywhere and
mean nothing. A word that could change the meaning of an order ("not", "if", "then") must never be a
filler.
"""

import re
from collections.abc import Mapping
from typing import NamedTuple

FILLERS = """
please|now|right now|immediately|at once|for me|thanks|thank you|hey|ok|okay|hello|fleet|headland|just
the|could you|can you|would you|will you|can we|i want you to|i would like you to|i'd like you to|kindly
"""

WORDS = {
    "MOVE": "send|move|drive|bring|dispatch|get|take|direct|guide",
    "GO": "go|head|travel|come",
    "TO": "to|over to",
    "HOME": "home|back home|to home|to the start|to base|back to base",
    "RETURN": "return",
    "AND": "and|and also",
    "TELL": "tell|ask|let|make|have|order|command",
    "STOP": "stop|halt|freeze|abort|stand still|stop moving|stop working|brake",
    "ESTOP": "emergency stop|e-stop|estop|e stop|emergency halt|hit the emergency stop|"
    "press the emergency stop",
    "WAIT": "wait|keep waiting|wait there|stay and wait",
    "CONTINUE": "continue|keep going|keep on|go on|carry on|go ahead|proceed|leave it out and go on",
    "REPLAN": "replan|re-plan|plan again|find another way|go around|go round|go around it|go round it|"
    "take another way|drive around it",
    "START": "start|resume|start working|start work|resume work|go back to work|back to work|"
    "start again|get back to work",
    "ROBOT": "robot|robots|rob|machine|machines|vehicle|vehicles|robot number|robots number",
    "NEAREST": "nearest|closest",
    "IDLE": "idle|free|available",
    "ANYONE": "a robot|any robot|some robot|one robot|someone|somebody|anyone|anybody|whoever is nearest|"
    "whoever is free|an idle robot|a free robot|any idle robot|any free robot",
    "THAT": "it|him|her|that|that one|this one|that robot|this robot|the robot|you|yourself",
    "ALL": "all|everyone|everybody|everything|all robots|every robot|all of them|them|the robots|"
    "they|all machines|whole fleet|the fleet|the whole fleet|all the robots",
    "SEVERAL": "some robots|two robots|three robots|both|both robots|several robots|"
    "a few robots|the others",
    "GOAL": "set goal|set a goal|set the goal|new goal|set destination|set the destination",
    "OF": "of|for",
    "WHERE": "where is|where are|where's|position of|positions of|position|positions|locate|location of|"
    "what is the position of|where",
    "DOING": "doing|up to|busy with",
    "WHAT": "what is|what's|what are|what does|what do",
    "BATTERY": "battery|batteries|battery level|battery levels|charge level|state of charge",
    "PROGRESS": "progress|what progress|how much is left|how much is left to do|how much work is left|"
    "how much is done|what is left|what's left|what is left to do|how far are we|how far along are we",
    "FINISHED": "which sections are done|which sections are finished|what is done|what's done|"
    "what is finished|done sections|finished sections|list done sections",
    "IS": "is|are",
    "WELL": "fine|all right|alright|alive|healthy|well",
    "HOWFAR": "how far is|how far are|how far away is|how far|distance|what is the distance|"
    "what is the distance of",
    "FROM": "from|away from",
    "THROUGH": "through|thru",
    "HOW": "how is|how are|how's",
    "STATUS": "status|status of|report|state|state of|report on|fleet status|status report|show status|"
    "what is the status of|what is the state of|what's the status of",
    "WHICH": "which robot is|which robots are|who is|who's|which is|which one is|which robot|who|"
    "what robot is|is anyone|is anybody|are any robots|is any robot",
    "STOPPED": "stopped|standing still|latched|in emergency stop",
    "HAS": "has|works|works on|work on|owns|own|working|working on|is working on|is working|holds|hold",
    "WHY": "why|why has|why does|why is",
    "SECTIONWORD": "section",
    "QUEUE": "queue|queued|what is queued|what's queued|show the queue|show queue|what is in the queue|"
    "what is waiting|list the queue",
    "CLEAR": "clear|empty|forget|cancel|delete",
    "PLACES": "places|list places|show places|what places are there|which places are there|"
    "where can i send them|where can they go|list the places|what places do you know",
    "X": "x|east",
    "Y": "y|north",
    "M": "m|metres|meters|metre|meter",
}

NUMBERS = [
    "zero", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten", "eleven",
    "twelve", "thirteen", "fourteen", "fifteen", "sixteen", "seventeen", "eighteen", "nineteen", "twenty",
]  # fmt: skip
# One number of two words, never two coordinates.
TWENTIES = {f"twenty-{unit}": 20 + NUMBERS.index(unit) for unit in NUMBERS[1:10]}

# Words by which a phrase that is not of the language is answered better than by "not understood".
UNSAFE = {
    "ignore", "override", "disable", "bypass", "unlock", "release", "reset", "unlatch", "over", "through",
    "ram", "hit", "crash", "into", "faster", "fast", "speed", "person", "people", "human", "man", "woman",
    "child", "dog", "anyway", "force", "off", "without", "safety", "acknowledge",
}  # fmt: skip
NEGATIONS = {
    "not",
    "don't",
    "dont",
    "never",
    "no",
    "nobody",
    "except",
    "but",
    "unless",
    "neither",
    "avoid",
}
SEQUENCES = {
    "then",
    "after",
    "before",
    "when",
    "if",
    "until",
    "while",
    "once",
    "unless",
    "or",
    "later",
    "again",
}

# Words that mean one thing to one person and another to the next.
DOUBTFUL = {
    "hold": ("stop robot 2", "robot 2 wait"), "pause": ("stop robot 2", "robot 2 wait"),
    "cancel": ("clear the queue", "stop robot 2"), "quit": ("stop all", "clear the queue"),
    "back": ("robot 2 go home", "start robot 2"), "follow": ("where is robot 1", "robot 2 go to 3, 4"),
}  # fmt: skip

WORD = re.compile(r"#?-?\d+(?:\.\d+)?(?![\w.]*[a-z])|[a-z][a-z0-9'\-]*|[,;=]|[^\s\w]|\S+")
NUMBER = re.compile(r"#?-?\d+(\.\d+)?")
LABEL = re.compile(r"(?:robot|rob|r)-?(\d+)")
SECTION = re.compile(r"s(?:ection)?(\d+)")
SILENT = frozenset("!?.():\"'")  # punctuation that says nothing, where it stands alone


class Token(NamedTuple):
    """One word, or group of words, of a phrase: its kind in the grammar and its value."""

    kind: str
    value: str


def _table() -> dict[tuple[str, ...], str]:
    table = {tuple(f.split()): "" for line in FILLERS.strip().splitlines() for f in line.split("|")}
    for kind, groups in WORDS.items():
        for group in groups.split("|"):
            known = table.setdefault(tuple(group.split()), kind)
            assert known == kind, f"{group!r} is both {known} and {kind}"
    return table


TABLE = _table()
LONGEST = max(map(len, TABLE))
KNOWN_WORDS = frozenset(word for group in TABLE for word in group) | frozenset(NUMBERS)


def words_of(text: str) -> list[str]:
    """Lower-case words, numbers and the punctuation that means something.

    >>> words_of("Send R2 to 12.5, -40!")
    ['send', 'r2', 'to', '12.5', ',', '-40']
    """
    # A sentence that ends goes on with another one: "and". Decimal points stay.
    text = re.sub(r"[.;]+\s+(?=\S)", " and ", text.strip().lower().replace("’", "'"))
    text = re.sub(r"(?<=[a-z])[.!?]+(?=\s|$)", "", text)
    return [word for word in WORD.findall(text) if word not in SILENT]


def tokens_of(words: list[str], places: Mapping[tuple[str, ...], str]) -> list[Token]:
    """The longest groups first; what is no word of the language comes as kind `WORD`."""
    tokens: list[Token] = []
    at, longest = 0, max([LONGEST, *map(len, places)])
    while at < len(words):
        for length in range(min(longest, len(words) - at), 0, -1):
            group = tuple(words[at : at + length])
            if group in places:
                tokens.append(Token("PLACE", places[group]))
            elif group in TABLE:
                if TABLE[group]:
                    tokens.append(Token(TABLE[group], " ".join(group)))
            else:
                continue
            at += length
            break
        else:
            two = "-".join(words[at : at + 2])
            tokens.append(_single(two if two in TWENTIES else words[at]))
            at += 2 if two in TWENTIES else 1
    return tokens


def _single(word: str) -> Token:
    if NUMBER.fullmatch(word):
        return Token("NUM", word.lstrip("#"))
    if word in NUMBERS:
        return Token("NUM", str(NUMBERS.index(word)))
    if word in TWENTIES:
        return Token("NUM", str(TWENTIES[word]))
    if found := LABEL.fullmatch(word):
        return Token("LABEL", found[1])
    if found := SECTION.fullmatch(word):
        return Token("SECTION", found[1])
    if word in (",", "="):
        return Token("COMMA" if word == "," else "EQUALS", word)
    return Token("WORD", word)


def is_word(group: tuple[str, ...]) -> bool:
    """Would this be read as something else than the name of a place? "shelf 3" would not."""
    return all(word in KNOWN_WORDS or _single(word).kind != "WORD" for word in group)
