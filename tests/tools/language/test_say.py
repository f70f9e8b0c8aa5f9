"""`headland say` as people call it: readings, recorded runs, pipes, an endpoint, and one-line errors."""

import asyncio
import errno
import json
import os
import subprocess
import sys
from collections.abc import AsyncIterator, Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread
from typing import Any, cast

import pytest

from sim.files.candump import CandumpWriter
from sim.fleet.simulated_fleet import Cluster
from sim.fleet.virtual_clock import elapse, run_virtual
from sim.scenarios.field_setup import FieldSetup
from sim.scenarios.scenario import load
from tools.inspect.inspection import inspect
from tools.language import conversation
from tools.language.conversation import Conversation
from tools.language.endpoint import ANSWER_BYTES_MAX, Endpoint, EndpointError, meant
from tools.language.goal_queue import GoalQueue
from tools.language.intent import Goal
from tools.language.outcome import Outcome
from tools.language.places import Places
from tools.language.question import Question
from tools.language.say import say
from tools.language.say_options import Options

ROOT = Path(__file__).parents[3]


def headland(
    *words: str, folder: Path, said: str = "", **environment: str
) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(
        [sys.executable, "-m", "tools.cli.headland", *words], cwd=folder, capture_output=True, text=True,
        input=said, check=False, timeout=120.0,
        env={**os.environ, "PYTHONPATH": str(ROOT), **environment},
    )  # fmt: skip


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The log of a small fleet at work."""
    folder = tmp_path_factory.mktemp("runs")
    log = CandumpWriter(folder / "can.log")

    async def main() -> None:
        cluster = Cluster(FieldSetup(load("small")), "say")
        cluster.segment.taps.append(log.write)
        cluster.boot_all()
        await elapse(20.0)
        await cluster.close()

    run_virtual(main())
    log.close()
    return folder


def test_how_a_phrase_is_read_needs_no_bus(tmp_path: Path) -> None:
    done = headland("say", "--read", "send robot 2 to 12.5, -40", folder=tmp_path)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout) == {
        "kind": "goal", "robot": 2, "place": {"x_m": 12.5, "y_m": -40.0}
    }  # fmt: skip
    done = headland("say", "--read", "--json", folder=tmp_path, said="stop\ndrive over it\nwhat\n")
    told = [json.loads(line) for line in done.stdout.splitlines()]
    assert done.returncode == 3
    assert told[0]["intents"] == [{"kind": "control", "action": "stop", "robots": "all"}]
    assert [t["asked_back"] and t["asked_back"]["reason"] for t in told] == [
        None, "unsafe", "not understood",
    ]  # fmt: skip


def test_a_byte_that_is_no_text_ends_no_conversation(tmp_path: Path) -> None:
    """The thread that reads died of it, and every later phrase, a stop too, was not heard."""
    done = subprocess.run(
        [sys.executable, "-m", "tools.cli.headland", "say", "--read", "--json"], cwd=tmp_path,
        input=b"st\xe4tus\nstop\n", capture_output=True, check=False, timeout=60.0,
        env={**os.environ, "PYTHONPATH": str(ROOT), "PYTHONIOENCODING": "utf-8:strict"},
    )  # fmt: skip
    told = [json.loads(line) for line in done.stdout.splitlines()]
    assert told[0]["asked_back"]["reason"] == "not understood"
    assert told[1]["intents"] == [{"kind": "control", "action": "stop", "robots": "all"}]
    assert done.stderr == b""


def test_a_terminal_that_is_gone_ends_a_conversation(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Reading it fails, as with `nohup` after a hang-up. The conversation stayed for ever."""

    class Gone:
        def isatty(self) -> bool:
            return False

        def __iter__(self) -> Iterator[str]:
            raise OSError(errno.EIO, os.strerror(errno.EIO))

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "stdin", Gone())

    async def main() -> int:
        async with asyncio.timeout(10.0):
            return await Conversation(OFFLINE).hold(None)

    assert asyncio.run(main()) == 0


def test_a_queue_that_cannot_be_written_is_told_and_ends_no_conversation(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """Goals were not given any more, without a word, and at its end came the traceback of a task."""

    served = asyncio.Event()

    class Speaker:
        async def say(self, phrase: str) -> Outcome:
            return Outcome(phrase)

        async def serve(self, tell: object) -> None:
            served.set()
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    async def typed() -> AsyncIterator[str]:
        for phrase in ("status", "stop"):
            yield phrase
            await served.wait()
            served.clear()

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(conversation, "CommandSession", lambda *_: Speaker())
    GoalQueue(tmp_path / "queue.json").add("gate", (1.0, 2.0))
    talking = Conversation(Options(NO_BUS, queue=tmp_path / "queue.json"))
    asyncio.run(talking._on_bus(cast(Any, None), None, typed(), True))
    line = f"headland: goals wait until the next phrase: {os.strerror(errno.ENOSPC)}"
    assert capfd.readouterr().err.splitlines() == [line] * 2


def test_a_damaged_queue_ends_no_conversation(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """It ended after the first phrase, whatever that was."""

    class Speaker:
        async def say(self, phrase: str) -> Outcome:
            return Outcome(phrase)

        async def serve(self, tell: object) -> None:
            len(queue)

    async def typed() -> AsyncIterator[str]:
        for phrase in ("status", "stop"):
            yield phrase

    monkeypatch.setattr(conversation, "CommandSession", lambda *_: Speaker())
    queue = GoalQueue(tmp_path / "queue.json")
    queue.path.write_text("{")
    talking = Conversation(Options(NO_BUS, queue=queue.path))
    asyncio.run(talking._on_bus(cast(Any, None), None, typed(), True))
    assert talking.code == 0 and capfd.readouterr().out.splitlines() == ["done"] * 2


def test_a_recorded_run_answers_and_takes_no_orders(recorded: Path, tmp_path: Path) -> None:
    asked = "".join(
        f"who has S{k}\n" for k in range(14)
    )  # the plan decides which are claimed by then
    phrases = f"where is robot 1\n{asked}send robot 1 to 3, 4\nstatus\n"
    done = headland("say", "--log", str(recorded), "--json", folder=tmp_path, said=phrases)
    where, *sections, refused, status = (json.loads(line) for line in done.stdout.splitlines())
    assert done.returncode == 3 and refused["asked_back"]["reason"] == "not now"
    assert where["answers"][0][0]["slot"] == 1
    owners = {told["answers"][0]["owner"] for told in sections if told["answers"][0]}
    assert owners - {None} == {0, 1, 2}
    assert [robot["state"] for robot in status["answers"][0]] == ["WORKING"] * 3


NO_BUS = ("socketcand", "can0", 250_000, "127.0.0.1", 0)
NOBODY = ("socketcand", "can0", 250_000, "127.0.0.1", 1)
OFFLINE = Options(NO_BUS, read_only=True)
WRONG = {
    "no bus": (Options(NO_BUS), "headland launch"),
    "no such log": (Options(NO_BUS, log=Path("nowhere")), "nowhere"),
    "by whom": (Options(NO_BUS, by="bob"), "--by bob"),
    "no places": (OFFLINE._replace(places=Path("nowhere.toml")), "nowhere.toml"),
    "wrong places": (OFFLINE._replace(places=Path("bad.toml")), "not TOML"),
    "no URL": (OFFLINE._replace(endpoint="file:///etc/x"), "--endpoint"),
    "half a URL": (OFFLINE._replace(endpoint="http://[::1/v1"), "--endpoint http://[::1/v1"),
    "by no number": (Options(NO_BUS, by="9" * 5000), "--by 999"),
    "no key": (Options(NOBODY, key=Path("nowhere")), "nowhere"),
    "nobody listens": (Options(NOBODY), "cannot open socketcand at 127.0.0.1:1"),
    "no such interface": (Options(("nonsense", *NO_BUS[1:])), "cannot open nonsense"),
}


@pytest.mark.parametrize("case", WRONG)
def test_what_a_person_can_do_wrong_is_one_line(
    case: str, tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    options, why = WRONG[case]
    monkeypatch.chdir(tmp_path)
    (tmp_path / "bad.toml").write_text("[places\n")
    assert say(["status"], options) == 2
    told = capfd.readouterr()
    assert told.err.count("\n") == 1 and told.out == ""
    assert told.err.startswith("headland: ") and why in told.err


def inspected(source: Path | None, why: str | None, as_json: bool, picture: Path | None) -> int:
    return inspect(source, *NO_BUS, None, False, why, as_json, picture=picture)


def test_why_is_told_with_its_frames(recorded: Path, capfd: pytest.CaptureFixture[str]) -> None:
    claimed = [k for k in range(14) if inspected(recorded, f"S{k}", False, None) == 0]
    text = capfd.readouterr().out
    assert "claims it, bid" in text and "because of 1." in text
    assert inspected(recorded, f"{claimed[0]}", True, None) == 0
    steps = json.loads(capfd.readouterr().out)
    assert [step["phase"] for step in steps] == ["CLAIMED", "STARTED"]
    assert steps[1]["because"][0]["data"] == steps[0]["data"]
    for source, why, picture, code in (
        (recorded, "S999", None, 1), (recorded, "S7x", None, 2), (None, None, Path("x.svg"), 2),
    ):  # fmt: skip
        assert inspected(source, why, False, picture) == code
        assert capfd.readouterr().err.count("\n") == 1


# -------------------------------------------------------------------- a language model


class Model(ThreadingHTTPServer):
    """An endpoint that says what it is told to, and remembers what it was asked."""

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), _Answering)
        self.content: str | None = ""
        self.status = 200
        self.asked: list[dict[str, Any]] = []
        self.keys: list[str | None] = []

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.server_address[1]}/v1"


class _Answering(BaseHTTPRequestHandler):
    server: Model

    def do_POST(self) -> None:
        body = self.rfile.read(int(self.headers["Content-Length"]))
        self.server.asked.append(json.loads(body))
        self.server.keys.append(self.headers["Authorization"])
        content = self.server.content
        answer = json.dumps({"choices": [{"message": {"content": content}}]}).encode()
        self.send_response(self.server.status)
        self.end_headers()
        self.wfile.write(answer)

    def log_message(self, format: str, *args: object) -> None: ...


@pytest.fixture
def model() -> Iterator[Model]:
    server = Model()
    thread = Thread(target=server.serve_forever, daemon=True)
    thread.start()
    yield server
    server.shutdown()
    server.server_close()


def test_a_model_is_asked_only_for_what_the_grammar_cannot_read(
    model: Model, tmp_path: Path
) -> None:
    model.content = json.dumps({"intents": [{"kind": "goal", "robot": 1, "place": "gate"}]})
    (tmp_path / "places.toml").write_text("[places]\ngate = [1.0, 2.0]\n")
    said = "robot 1 go to the gate\nrobot uno, a la puerta\ndrive over the person\nstop\n"
    done = headland(
        "say", "--read", "--json", "--endpoint", model.url, "--places", "places.toml",
        "--model", "some-model", folder=tmp_path, said=said, HEADLAND_LLM_KEY="k",
    )  # fmt: skip
    told = [json.loads(line) for line in done.stdout.splitlines()]
    assert [t["by_model"] for t in told] == [False, True, False, False], done.stderr
    assert told[0]["intents"] == told[1]["intents"]
    [asked] = model.asked
    assert asked["model"] == "some-model" and model.keys == ["Bearer k"]
    assert asked["messages"][1] == {"role": "user", "content": "robot uno, a la puerta"}
    assert "gate" in asked["messages"][0]["content"]


@pytest.mark.parametrize("status", [200, 404, 500])
def test_an_endpoint_that_does_not_help_is_one_line(
    status: int, model: Model, capfd: pytest.CaptureFixture[str]
) -> None:
    model.status, model.content = status, None
    assert say(["gibberish"], OFFLINE._replace(endpoint=model.url)) == 3
    assert capfd.readouterr().out.count("\n") == 1


GOAL = {"kind": "goal", "robot": 1, "place": "gate"}
BAD = [
    "", "not json", "[]", "null", "{}", '{"intents": []}', '{"intents": "stop"}',
    json.dumps({"intents": [GOAL], "also": "reset"}),
    json.dumps({"intents": [{**GOAL, "speed": 9}]}),
    json.dumps({"intents": [{**GOAL, "robot": "1"}]}),
    json.dumps({"intents": [{**GOAL, "robot": 500}]}),
    json.dumps({"intents": [{**GOAL, "place": {"x_m": 1e9, "y_m": 0}}]}),
    '{"intents": [{"kind": "goal", "robot": 1, "place": {"x_m": NaN, "y_m": 0}}]}',
    json.dumps({"intents": [{"kind": "reset"}]}),
    json.dumps({"intents": [{"kind": "control", "action": "manual_reset", "robots": "all"}]}),
    json.dumps({"intents": [GOAL, {"kind": "control", "action": "go_home", "robots": [1]}]}),
    json.dumps({"intents": [GOAL] * 9}),
    "[" * 100_000, " " * (ANSWER_BYTES_MAX + 1),
    json.dumps({"question": 7}),
]  # fmt: skip


@pytest.mark.parametrize("content", [*BAD, None, 7], ids=lambda c: str(c)[:40])
def test_what_a_model_says_is_an_intent_or_nothing(content: object) -> None:
    assert isinstance(meant(content), Question)


def test_a_model_may_ask_back() -> None:
    told = meant(json.dumps({"question": "which\n shelf?"}))
    assert isinstance(told, Question) and told.text == "which shelf?"
    assert meant(json.dumps({"intents": [GOAL]})) == (Goal(robot=1, place="gate"),)
    with pytest.raises(EndpointError):
        Endpoint("ftp://example.org", "m")
    assert Endpoint.given(None, "m") is None or Places({})
