"""The layout of a frame, declared once: codec, DBC signals and documentation come from it.

    PROGRESS = FrameLayout(
        WorkProgress, "WORK_PROGRESS", pgn=0xFF13, priority=6, sender=ROBOT,
        fields=(
            integer("section", 16),
            integer("block", 8, "units 40 * block to 40 * block + 39"),
            integer("bits", 40, "bit i is set if unit 40 * block + i is covered"),
        ),
    )

Fields are listed in the order of their bits, lowest bit of byte 0 first; words are little-endian.
The order in the message's class may be another one. From the list, a layout writes the source of
two functions, `pack` and `unpack`, as `collections.namedtuple` does: one `struct` call each, with
shifts and masks for what is not a whole word. They are compiled when they are first called.
"""

from collections.abc import Callable, Iterator, Sequence
from enum import IntEnum
from itertools import accumulate
from struct import Struct
from typing import Any, Generic, NamedTuple, TypeVar

M = TypeVar("M", bound=NamedTuple)

ROBOT, TOOL, GATEWAY, ANY_DEVICE = "robot", "tool", "gateway", ""  # senders
WORDS = {8: "Q", 4: "I", 2: "H", 1: "B"}  # bytes -> format of struct
# Added to a cyclic value, so that truncation rounds down: no robot turns this often.
TURNS = 1 << 20

Choices = tuple[tuple[int, str], ...]  # raw value, name


class FrameField(NamedTuple):
    """One field: `bits` wide, or `repeat` elements of `bits` each. Made by the functions below.

    The value of a raw number is `raw * scale + offset`, or `raw / parts`.
    """

    name: str  # of the attribute in the message; of reserved bits: ""
    bits: int
    meaning: str = ""
    unit: str = ""
    repeat: int = 0  # elements; 0: the field is no list
    octets: bool = False  # the elements are one `bytes`, filled up with 0xFF
    boolean: bool = False
    scale: float = 1
    offset: float = 0
    parts: int = 0  # steps per unit, where that is a whole number
    cyclic: bool = False  # encoded modulo 2^bits
    clamped: bool = False  # encoded as the nearest value that the field has
    # The highest raw value says that there is none; encoded from there on.
    unavailable: bool = False
    accepted: Sequence[int] | None = None  # raw values that are decoded; None: all
    choices: Choices = ()
    enumeration: type[IntEnum] | None = None  # decoded as this
    reserved: int | None = None  # sent with this value; decoded only if `accepted` says so
    signal: str = ""  # name in the DBC, where `name` is a keyword of C or C++
    subfields: tuple[tuple[str, int, int], ...] = ()  # signals in the DBC: name, first bit, bits
    special: Choices = ()  # raw values that are no number, for people; decoded as numbers

    @property
    def width(self) -> int:
        """Bits of the field with all its repetitions."""
        return self.bits * (self.repeat or 1)


def integer(
    name: str, bits: int, meaning: str = "", unit: str = "", accepted: Sequence[int] | None = None,
    signal: str = "", subfields: tuple[tuple[str, int, int], ...] = (), special: Choices = (),
) -> FrameField:  # fmt: skip
    """An unsigned number. Other raw values than those in `accepted` make a frame malformed.

    `special`: raw values that mean something else than a number, with their names.
    """
    return FrameField(
        name, bits, meaning, unit, accepted=accepted, signal=signal, subfields=subfields,
        special=special,
    )  # fmt: skip


def flag(name: str, meaning: str = "") -> FrameField:
    """One bit, as a bool."""
    return FrameField(name, 1, meaning, boolean=True)


def choice(
    name: str, bits: int, choices: type[IntEnum] | Choices, meaning: str = "",
    strict: bool = True, signal: str = "", as_enum: bool = False,
) -> FrameField:  # fmt: skip
    """A number whose values have names. With `strict`, any other value makes a frame malformed."""
    enumeration = choices if as_enum and isinstance(choices, type) else None
    if isinstance(choices, type):
        choices = tuple((int(member), member.name) for member in choices)
    values = tuple(value for value, _ in choices)
    if values == tuple(range(len(values))):
        accepted: Sequence[int] = range(len(values))
    else:
        accepted = values
    return FrameField(
        name, bits, meaning, choices=choices, accepted=accepted if strict else None,
        enumeration=enumeration, signal=signal,
    )  # fmt: skip


def scaled(
    name: str, bits: int, scale: float, unit: str, meaning: str = "", offset: float = 0,
    cyclic: bool = False, clamped: bool = False, unavailable: bool = False,
) -> FrameField:  # fmt: skip
    """A measure in steps of `scale` from `offset`, rounded to the nearest step, ties upwards.

    `scale` and `offset` are numbers of `unit`, which may be empty for a dimensionless measure.
    """
    return FrameField(
        name, bits, meaning, unit, scale=scale, offset=offset, cyclic=cyclic, clamped=clamped,
        unavailable=unavailable,
    )  # fmt: skip


def share(name: str, bits: int, parts: int, meaning: str = "") -> FrameField:
    """A number from 0.0 to 1.0 in steps of 1 / `parts`, rounded as `round` does; more is malformed."""
    return FrameField(
        name, bits, meaning, parts=parts, scale=1 / parts, clamped=True, accepted=range(parts + 1)
    )


def integers(name: str, bits: int, count: int, meaning: str = "") -> FrameField:
    """A tuple of `count` unsigned numbers of `bits` each."""
    return FrameField(name, bits, meaning, repeat=count)


def octets(name: str, count: int, meaning: str = "") -> FrameField:
    """`count` bytes; fewer are filled up with 0xFF when encoding."""
    return FrameField(name, 8, meaning, repeat=count, octets=True)


def reserved(bits: int, ones: bool = False, checked: bool = False) -> FrameField:
    """Bits without a meaning, sent as 0 or, as J1939 requires, as 1. Ignored unless `checked`."""
    value = (1 << bits) - 1 if ones else 0
    return FrameField("", bits, reserved=value, accepted=(value,) if checked else None)


class Signal(NamedTuple):
    """Some bits of a frame, as external tools see them: `raw * scale + offset`."""

    name: str
    start: int  # lowest bit, counted from bit 0 of byte 0
    length: int  # bits
    scale: float = 1
    offset: float = 0
    unit: str = ""
    choices: Choices = ()
    reserved: int | None = None  # always sent with this value, and never read
    meaning: str = ""


class FrameLayout(Generic[M]):
    """A kind of frame: its parameter group, its layout, and its codec.

    Raises AssertionError if the fields are not those of `kind` or do not fill whole bytes.
    """

    # The data of a message. Raises AssertionError or struct.error if a value does not fit.
    pack: Callable[[M], bytes]
    # The message in `length` bytes. Raises ValueError if a value is not accepted.
    unpack: Callable[[bytes], M]

    def __init__(
        self, kind: type[M], name: str, *, pgn: int, priority: int, sender: str,
        fields: tuple[FrameField, ...], padded: bool = False,
    ) -> None:  # fmt: skip
        """`padded`: more bytes than these are taken and not read."""
        self.kind, self.padded = kind, padded
        self.name = name  # as the mission and the standards spell it
        self.pgn, self.priority, self.sender = pgn, priority, sender
        self.fields = fields
        bits = sum(field.width for field in fields)
        self.length = bits // 8  # data bytes
        names = [field.name for field in fields if field.name]
        assert bits % 8 == 0, f"{name} has {bits} bits"
        assert sorted(names) == sorted(self.kind._fields), f"fields of {name}"
        self.pack, self.unpack = self._pack_first, self._unpack_first

    def placed(self) -> Iterator[tuple[FrameField, int]]:
        """Each field with its lowest bit."""
        starts = accumulate((field.width for field in self.fields), initial=0)
        return zip(self.fields, starts, strict=False)

    def signals(self) -> list[Signal]:
        """The signals of the fields, then those of reserved bits. A list is one signal an element.

        Reserved bits are signals with a value, because encoders of other makers would otherwise
        send 0 where J1939 requires 1.
        """
        named, unused = [], []
        for field, start in self.placed():
            name = field.signal or field.name
            if field.reserved is not None:
                run = f"reserved_{start}"
                unused.append(_unused(run, start, field.bits, field.reserved))
            elif field.subfields:
                named += [
                    Signal(
                        sub,
                        start + first,
                        bits,
                        meaning=f"{sub.replace('_', ' ')}, {field.meaning}",
                    )
                    for sub, first, bits in field.subfields
                ]
                unused += _gaps(field, start)
            elif field.repeat:
                named += [
                    Signal(
                        f"{name}_{k}",
                        start + k * field.bits,
                        field.bits,
                        meaning=f"number {k} of {field.repeat}: {field.meaning}",
                    )
                    for k in range(field.repeat)
                ]
            else:
                measure = field.scale, field.offset, field.unit
                choices = field.choices + field.special
                if field.unavailable:
                    choices += (((1 << field.bits) - 1, "NOT_AVAILABLE"),)
                meaning = field.meaning
                named.append(Signal(name, start, field.bits, *measure, choices, meaning=meaning))
        return named + unused

    def _compile(self) -> None:
        """Replace `pack` and `unpack` by functions of this layout."""
        writer = _Writer(self.fields, self.kind._fields)
        names: dict[str, Any] = {
            "KIND": self.kind,
            "NEW": tuple.__new__,  # what a named tuple calls, without a call between
            "PACK": Struct(writer.format(decoded=False)).pack,
            "UNPACK": Struct(writer.format(decoded=True)).unpack,
        }
        names |= {f.name.upper(): f.enumeration for f in self.fields if f.enumeration}
        exec(compile(writer.source(), f"<layout of {self.name}>", "exec"), names)
        self.pack, self.unpack = names["pack"], names["unpack"]

    def _pack_first(self, message: M) -> bytes:
        if self.pack == self._pack_first:
            self._compile()
        return self.pack(message)

    def _unpack_first(self, data: bytes) -> M:
        if self.unpack == self._unpack_first:
            self._compile()
        return self.unpack(data)


def _gaps(field: FrameField, start: int) -> Iterator[Signal]:
    """The bits of a field that are in none of its subfields: always 0."""
    end = 0
    for _, first, bits in (*field.subfields, ("", field.bits, 0)):
        if first > end:
            yield _unused(f"reserved_{start + end}", start + end, first - end, 0)
        end = first + bits


def _unused(name: str, start: int, bits: int, value: int) -> Signal:
    meaning = f"reserved: sent as {value:#x}, not read"
    return Signal(name, start, bits, reserved=value, meaning=meaning)


class _Element(NamedTuple):
    """What is packed as one number, or as one `bytes`."""

    field: FrameField
    raw: str  # the variable that holds its raw value; of reserved bits: the value
    start: int
    bits: int

    @property
    def end(self) -> int:
        return self.start + self.bits


class _Word(NamedTuple):
    """One item of the struct format."""

    start: int
    bits: int
    elements: list[_Element]  # that have bits in it

    @property
    def end(self) -> int:
        return self.start + self.bits

    @property
    def octets(self) -> bool:
        return self.elements[0].field.octets

    @property
    def skipped(self) -> bool:
        """Whether decoding does not look at it."""
        return all(e.field.reserved is not None and not e.field.accepted for e in self.elements)


class _Writer:
    """Writes the source of a codec."""

    def __init__(self, fields: tuple[FrameField, ...], order: tuple[str, ...]) -> None:
        self.order = order  # of the values in the message
        self.fields = fields
        self.elements = list(_elements(fields))
        self.words = list(_words(self.elements))

    def format(self, decoded: bool) -> str:
        """Of struct: words, or padding for what decoding does not look at."""
        parts = []
        for word in self.words:
            size = word.bits // 8
            if word.octets:
                parts.append(f"{size}s")
            else:
                parts.append(f"{size}x" if decoded and word.skipped else WORDS[size])
        return "<" + "".join(parts)

    def source(self) -> str:
        pack = [f"({', '.join(self.order)},) = message", *self._raws(), *self._fits()]
        pack.append(f"return PACK({', '.join(self._packed(word) for word in self.words)})")
        unpack = [f"({', '.join(self._words_read())},) = UNPACK(data)", *self._checks()]
        values = [
            self._value(next(f for f in self.fields if f.name == name)) for name in self.order
        ]
        unpack.append(f"return NEW(KIND, ({', '.join(values)},))")
        parts = ("def pack(message):", *pack), ("def unpack(data):", *unpack)
        return "\n".join("\n    ".join(part) for part in parts) + "\n"

    # ---- encoding

    def _raws(self) -> Iterator[str]:
        """Statements that turn values into raw numbers."""
        for field in self.fields:
            name, top = field.name, (1 << field.bits) - 1
            if field.octets:
                yield f"assert len({name}) <= {field.repeat}"
                yield f"{name} = {name}.ljust({field.repeat}, b'\\xff')"
            elif field.repeat:
                yield f"({', '.join(e.raw for e in self._of(field))},) = {name}"
            elif field.parts or field.scale != 1:
                yield from self._steps(field, top)

    def _steps(self, field: FrameField, top: int) -> Iterator[str]:
        """Statements that turn a measure into a raw number; `int` rounds down what is positive."""
        name = field.name
        if field.parts:
            steps, highest = f"round({name} * {field.parts})", field.parts
        else:
            shift = 0.5 - field.offset / field.scale + (TURNS << field.bits) * field.cyclic
            steps, highest = f"int({name} / {field.scale!r} + {shift!r})", top
        if field.cyclic:
            yield f"{name} = {steps} & {top}"
        elif field.unavailable:
            known = f"min({steps}, {top - 1})"
            yield f"{name} = {top} if {name} >= {top * field.scale!r} else {known}"
        elif field.clamped:
            yield f"{name} = {steps}"
            yield f"{name} = 0 if {name} < 0 else {highest} if {name} > {highest} else {name}"
        else:
            yield f"{name} = {steps}"

    def _fits(self) -> Iterator[str]:
        """An assertion that no number overflows into its neighbour; struct checks whole words."""
        shared = {e for word in self.words if len(word.elements) > 1 for e in word.elements}
        over = [
            f"{e.raw} >> {e.bits}" for e in self.elements
            if e in shared and e.field.reserved is None and not e.field.cyclic
            and not e.field.boolean
        ]  # fmt: skip
        if over:
            yield f"assert not ({' | '.join(over)}), message"

    def _packed(self, word: _Word) -> str:
        """The expression of one item."""
        parts = []
        for element in word.elements:
            raw = element.raw
            if element.field.reserved == 0:
                continue
            if element.end > word.end:  # its upper bits are in the next word
                raw = f"({raw} & {(1 << word.end - element.start) - 1})"
            shift = element.start - word.start
            parts.append(
                f"{raw} << {shift}" if shift > 0 else f"{raw} >> {-shift}" if shift else raw
            )
        return " | ".join(parts) or "0"

    # ---- decoding

    def _words_read(self) -> list[str]:
        return [f"w{k}" for k, word in enumerate(self.words) if word.octets or not word.skipped]

    def _read(self, element: _Element) -> str:
        """The expression of a raw value from the words that it has bits in."""
        parts = []
        for k, word in enumerate(self.words):
            low, high = max(word.start, element.start), min(word.end, element.end)
            if low >= high:
                continue
            expression = f"w{k}"
            if low > word.start:
                expression += f" >> {low - word.start}"
            if high < word.end:
                expression += f" & {(1 << high - low) - 1}"
            if low > element.start:
                masked = f"({expression})" if high < word.end else expression
                expression = f"{masked} << {low - element.start}"
            parts.append(expression)
        return " | ".join(parts)

    def _checks(self) -> Iterator[str]:
        """Statements that reject values; a value that is looked at becomes a variable."""
        wrong = []
        for element in self.elements:
            field = element.field
            if field.accepted is None:
                continue
            if field.reserved is not None:
                wrong.append(f"({self._read(element)}) != {field.reserved}")
                continue
            yield f"{element.raw} = {self._read(element)}"
            wrong.append(_outside(element.raw, field))
        wrong = [each for each in wrong if each]
        if wrong:
            yield f"if {' or '.join(wrong)}: raise ValueError('range')"

    def _value(self, field: FrameField) -> str:
        """The expression of what the message has, from raw values."""
        elements = self._of(field)
        raws = [e.raw if field.accepted is not None else self._read(e) for e in elements]
        raw = raws[0]
        if field.octets:
            return raw
        if field.repeat:
            return f"({', '.join(raws)},)"
        if field.boolean:
            bit = elements[0].start
            k, word = next((k, w) for k, w in enumerate(self.words) if w.start <= bit < w.end)
            return f"w{k} & {1 << bit - word.start} != 0"
        if field.enumeration:
            return f"{field.name.upper()}({raw})"
        if field.parts:
            return f"({raw}) / {field.parts}"
        if field.scale != 1:
            moved = f" + {field.offset!r}" if field.offset else ""
            return f"({raw}) * {field.scale!r}{moved}"
        return raw

    def _of(self, field: FrameField) -> list[_Element]:
        return [element for element in self.elements if element.field is field]


def _outside(raw: str, field: FrameField) -> str:
    """The condition that a raw value is not accepted; empty if every value is."""
    accepted = field.accepted
    if not isinstance(accepted, range):
        return f"{raw} not in {tuple(accepted or ())!r}"
    least, most = accepted[0], accepted[-1]
    above = f"{raw} > {most}" if most < (1 << field.bits) - 1 else ""
    below = f"{raw} < {least}" if least else ""
    return " or ".join(part for part in (below, above) if part)


def _elements(fields: tuple[FrameField, ...]) -> Iterator[_Element]:
    start = 0
    for field in fields:
        if field.reserved is not None:
            yield _Element(field, str(field.reserved), start, field.bits)
        elif field.repeat and not field.octets:
            for k in range(field.repeat):
                yield _Element(field, f"{field.name}_{k}", start + k * field.bits, field.bits)
        else:
            yield _Element(field, field.name, start, field.width)
        start += field.width


def _words(elements: list[_Element]) -> Iterator[_Word]:
    """The frame cut into words at bytes, as few as possible; few elements are in two words."""
    run: list[_Element] = []
    for element in elements:
        run.append(element)
        if element.end % 8:
            continue
        start, left = run[0].start, element.end - run[0].start
        whole = run[0].field.octets or (left == 64 and len(run) == 1)
        while left:
            bits = left if whole else 32 if left >= 32 else 16 if left >= 16 else 8
            within = [e for e in run if e.start < start + bits and e.end > start]
            yield _Word(start, bits, within)
            start, left = start + bits, left - bits
        run = []
