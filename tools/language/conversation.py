"""A conversation in plain language with a fleet on a bus, or with a recorded run."""

import asyncio
import sys
import threading
from collections.abc import AsyncIterator
from contextlib import suppress

from protocol.links.bus import CanBus
from protocol.links.socketcand_link import SocketcandLink
from sim.files.strict_json import dumps
from tools.common.bus_address import LAUNCH, AttachError
from tools.common.bus_attach import attach, stay_attached
from tools.common.launch_keys import own_keys
from tools.inspect.inspector import Inspector
from tools.inspect.log_frames import SourceError, frames_of
from tools.language.alarm import may_be_alarm
from tools.language.answer import answer
from tools.language.authorize import weigh
from tools.language.command_session import CommandSession
from tools.language.endpoint import Endpoint, EndpointError
from tools.language.goal_queue import GoalQueue, QueueError
from tools.language.intent import AnyIntent, Query
from tools.language.outcome import Outcome
from tools.language.parse import read
from tools.language.places import Places, PlacesError
from tools.language.question import Question, QuestionReason
from tools.language.say_options import Options, own_queue
from tools.language.view import as_heard
from tools.operate.device_keys import DeviceKeys
from tools.operate.reset import operator_keys

WRONG_WORDS = (AttachError, PlacesError, QueueError, SourceError, EndpointError)
PROMPT = "> "
QUESTIONS_ONLY = Question(
    QuestionReason.NOT_NOW, "a recorded run takes no orders; ask it something"
)


class Conversation:
    """One phrase, or those of a person who types, until the end."""

    def __init__(self, options: Options) -> None:
        """Raises PlacesError, EndpointError."""
        self.options = options
        self.places = _places(options)
        self.endpoint = Endpoint.given(options.endpoint, options.model)
        self.lines: asyncio.Queue[str | None] = asyncio.Queue()
        self.code = 0

    async def hold(self, phrase: str | None) -> int:
        """The exit code. Raises those of `WRONG_WORDS`."""
        if phrase is None:
            self._listen()
        phrases = self._one(phrase) if phrase is not None else self._typed()
        if self.options.read_only or self.options.log is not None:
            inspector = self._recorded() if self.options.log is not None else None
            async for each in phrases:
                self.tell(await self._without_bus(each, inspector))
            return self.code
        interface, _, _, host, port = self.options.bus
        key = self.options.key or own_keys(interface, host, port)
        keys = operator_keys(key)
        bus: CanBus | SocketcandLink
        if (
            phrase is None or self.options.wait
        ):  # it goes on without an end, also when the bus was away
            bus = await stay_attached(*self.options.bus, "say")
        else:
            bus = attach(*self.options.bus)
        try:
            await self._on_bus(bus, keys, phrases, phrase is None)
        finally:
            bus.close()
        return self.code

    async def _on_bus(
        self, bus: CanBus | SocketcandLink, keys: DeviceKeys | None, phrases: AsyncIterator[str],
        talking: bool,
    ) -> None:  # fmt: skip
        options = self.options
        queue = GoalQueue(options.queue or own_queue(options.bus))
        speaker = CommandSession(
            bus, keys, self.places, queue, self.read, self.ask, options.timeout_s, options.by
        )
        serving: asyncio.Task[None] | None = None
        async for phrase in phrases:
            outcome = await speaker.say(phrase)
            self.tell(outcome)
            if talking and (serving is None or serving.done()):
                serving = asyncio.create_task(self._serve(speaker))
            if outcome.queued and not talking:
                await self._wait(speaker, queue)
        if serving is not None:
            serving.cancel()
            with suppress(asyncio.CancelledError):
                await serving

    async def _serve(self, speaker: CommandSession) -> None:
        """Beside what is typed: a disk that is full must not end it, nor stay untold."""
        try:
            await speaker.serve(self.tell)
        except (QueueError, OSError) as problem:
            why = problem.strerror if isinstance(problem, OSError) else None
            print(
                f"headland: goals wait until the next phrase: {why or problem}",
                file=sys.stderr, flush=True,
            )  # fmt: skip

    async def _wait(self, speaker: CommandSession, queue: GoalQueue) -> None:
        """This command serves the queue until its goals are given."""
        if not self.options.wait:
            return
        print(
            f"waiting for an idle robot, for: {', '.join(queue.names)}. Robots that work go on. Ctrl-C "
            f"leaves it queued in {queue.path}; 'headland say \"clear the queue\"' drops it",
            file=sys.stderr,
        )
        await speaker.serve(self.tell)

    # ---------------------------------------------------------------- words

    async def read(self, phrase: str) -> tuple[tuple[AnyIntent, ...] | Question, bool]:
        """The grammar; what it has no reading for at all goes to the endpoint, if there is one."""
        reading = read(phrase, self.places)
        vague = isinstance(reading, Question) and reading.reason is QuestionReason.NOT_UNDERSTOOD
        if vague and self.endpoint is not None:
            return await self.endpoint.read(phrase, self.places), True
        return reading, False

    async def _without_bus(self, phrase: str, inspector: Inspector | None) -> Outcome:
        reading, by_model = await self.read(phrase)
        if isinstance(reading, Question):
            if self.options.read_only and may_be_alarm(phrase, self.places):
                print("this may be an alarm: on a bus all robots would be held", file=sys.stderr)
            return Outcome(phrase, question=reading)
        outcome = Outcome(phrase, reading, by_model=by_model)
        if inspector is None:
            return outcome
        if not all(isinstance(intent, Query) for intent in reading):
            outcome.question = QUESTIONS_ONLY
            return outcome
        fleet = as_heard(inspector)
        verdict = weigh(reading, fleet, self.places)
        if isinstance(verdict, Question):
            outcome.question = verdict
            return outcome
        outcome.answers = [answer(query, fleet, self.places, ()) for query in verdict.queries]
        return outcome

    def _recorded(self) -> Inspector:
        inspector = Inspector()
        assert self.options.log is not None
        for t_us, frame in frames_of(self.options.log):
            inspector.hear(t_us / 1e6, frame)
        return inspector

    # ---------------------------------------------------------------- people

    async def ask(self, question: str) -> bool:
        if self.options.yes:
            return True
        if not sys.stdin.isatty():
            return False
        if not self.options.as_json:
            print(f"{question} [y/N] ", end="", flush=True)
        self._listen()
        line = await self.lines.get()
        return line is not None and line.strip().lower() in ("y", "yes")

    def tell(self, outcome: Outcome) -> None:
        self.code = max(self.code, outcome.code)
        if self.options.as_json:
            print(dumps(outcome.to_dict()), flush=True)
            return
        if self.options.read_only and outcome.question is None:
            print(
                "\n".join(intent.model_dump_json(exclude_none=True) for intent in outcome.intents)
            )
            return
        print("\n".join(outcome.lines()), flush=True)

    @staticmethod
    async def _one(phrase: str) -> AsyncIterator[str]:
        yield phrase

    async def _typed(self) -> AsyncIterator[str]:
        """Lines of the terminal or of a pipe, until its end."""
        while True:
            if sys.stdin.isatty():
                print(PROMPT, end="", flush=True)
            line = await self.lines.get()
            if line is None:
                return
            if line.strip():
                yield line.strip()

    def _listen(self) -> None:
        """A thread reads: a loop cannot wait for every kind of stdin. It dies with the command."""
        if any(thread.name == PROMPT for thread in threading.enumerate()):
            return
        loop = asyncio.get_running_loop()

        def pump() -> None:
            with suppress(RuntimeError):  # the loop is closed, so no listener is left
                with suppress(OSError):  # the terminal is gone: as its end
                    for line in sys.stdin:
                        loop.call_soon_threadsafe(self.lines.put_nowait, line)
                loop.call_soon_threadsafe(self.lines.put_nowait, None)

        threading.Thread(target=pump, name=PROMPT, daemon=True).start()


def _places(options: Options) -> Places:
    """The file that was named; else that of the newest launch; else none has a name."""
    path = options.places or LAUNCH.with_name("places.toml")
    return Places.read(path) if options.places is not None or path.exists() else Places({})
