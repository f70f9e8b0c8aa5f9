"""Real Zenoh on loopback: a bus made of it, TLS with a refused client, access control."""

import asyncio
import contextlib
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from random import Random
from socket import socket

import pytest

from agent.peer.inputs import Press

pytest.importorskip("zenoh", reason="the extra `backbone` is not installed")

from agent.interface.identity import Identity
from agent.runtime.peer_factory import make_peer
from agent.runtime.peer_runner import PeerRunner
from agent.segments.segment_area import Area
from protocol.frames.codec import encode
from protocol.frames.fleet_frames import Member
from protocol.frames.frame import Frame
from protocol.frames.safety_frames import Reason
from protocol.links.zenoh_link import LinkError, ZenohBus, ZenohLink, configure
from protocol.name import fleet_name
from tests.tools.certificates import Authority
from tools.cli.bridge import bridge, read_area
from tools.common.bus_address import AttachError

LIMIT_S = 20.0


def free_port() -> int:
    with socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


async def until(holds: Callable[[], bool], limit_s: float = LIMIT_S) -> bool:
    """Let the loop run until it holds."""
    loop = asyncio.get_running_loop()
    end_s = loop.time() + limit_s
    while not holds() and loop.time() < end_s:
        done = asyncio.Event()
        loop.call_later(0.01, done.set)
        await done.wait()
    return holds()


def test_peers_live_on_the_backbone_itself() -> None:
    """Robots on Wi-Fi: three peers that share a key, no cable, and a stop among them."""

    async def run() -> None:
        loop, at = asyncio.get_running_loop(), f"tcp/127.0.0.1:{free_port()}"
        links = [ZenohLink(configure([], [at]), loop)]
        links += [ZenohLink(configure([at], []), loop) for _ in range(2)]
        assert await until(lambda: all(link.links for link in links))
        runners = []
        for slot, link in enumerate(links):
            identity = Identity(
                slot,
                frozenset(range(3)),
                fleet_name("wifi", slot),
                1,
                started=True,
                first_boot=True,
            )
            peer = make_peer(identity, Random(slot), PeerRunner.now_us(), area=Area(1, 4))
            bus = ZenohBus(link, "headland/test/1/bus")
            runners.append(PeerRunner(peer, bus, None, None))
        tasks = [asyncio.create_task(runner.run()) for runner in runners]
        assert await until(lambda: all(len(s.peer.membership.live) == 3 for s in runners))
        runners[1].operate(Press(Reason.PERSON_IN_FIELD))
        assert await until(lambda: all(s.peer.safety.latched for s in runners))
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        for link in reversed(links):
            link.close()

    asyncio.run(run())


def test_what_is_no_frame_is_counted() -> None:
    async def run() -> None:
        loop, at = asyncio.get_running_loop(), f"tcp/127.0.0.1:{free_port()}"
        far, near = ZenohLink(configure([], [at]), loop), ZenohLink(configure([at], []), loop)
        bus, heard = ZenohBus(near, "k"), list[Frame]()
        bus.subscribe(heard.append)
        assert await until(lambda: near.links > 0)
        sent = encode(Member(1, 1, 1), 128)

        def say() -> bool:  # a subscription takes a moment to be known
            far.put("k/frames", b"")
            far.put("k/frames", bytes(13))
            far.put("k/frames", b"\xff" * 8)
            ZenohBus(far, "k").send(sent)
            return bool(heard)

        assert await until(say) and heard[0] == sent
        assert await until(lambda: bus.refused >= 3)
        near.close()
        far.close()

    asyncio.run(run())


class RefusingRelay:
    """Stands between a client and a router, and refuses sessions by their identity from a time on."""

    def __init__(self, port: int) -> None:
        self.port, self.refused = port, b""
        self.turned_away = 0
        self._writers: list[asyncio.StreamWriter] = []

    async def start(self) -> int:
        """Accept connections; returns the port."""
        self.server = await asyncio.start_server(self._accept, "127.0.0.1", 0)
        return int(self.server.sockets[0].getsockname()[1])

    async def _accept(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        first = await reader.read(65536)  # the first message of a session names it
        if self.refused and self.refused in first:
            self.turned_away += 1
            writer.close()
            return
        far_reader, far_writer = await asyncio.open_connection("127.0.0.1", self.port)
        far_writer.write(first)
        self._writers += [writer, far_writer]
        await asyncio.gather(self._pump(reader, far_writer), self._pump(far_reader, writer))

    @staticmethod
    async def _pump(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with contextlib.suppress(OSError):
            while data := await reader.read(65536):
                writer.write(data)
        writer.close()

    def refuse(self, identity: bytes) -> None:
        """Cut what is connected and turn this session away from now on."""
        self.refused = identity
        for writer in self._writers:
            writer.close()


@pytest.mark.slow
def test_a_session_that_is_refused_for_good_is_replaced() -> None:
    """Seen after a link that carried one way: the router knew the old session and took no other."""

    async def run() -> None:
        loop, port = asyncio.get_running_loop(), free_port()
        router = ZenohLink(configure([], [f"tcp/127.0.0.1:{port}"]), loop)
        relay = RefusingRelay(port)
        at = f"tcp/127.0.0.1:{await relay.start()}"
        client = ZenohLink(configure([at], []), loop, silence_for_s=1.0)
        heard, answered = list[bytes](), list[bytes]()
        client.subscribe("router", heard.append)
        router.subscribe("client", answered.append)

        def both_hear() -> bool:
            router.put("router", b"x")
            client.put("client", b"x")
            return bool(heard and answered)

        assert await until(both_hear)
        assert client.renewed == 0 and client.session is not None
        identity = int(str(client.session.info.zid()), 16)
        relay.refuse(identity.to_bytes(16, "little").rstrip(bytes(1)))  # as it is on the wire
        assert await until(lambda: relay.turned_away > 0), "Zenoh tries the same session"
        heard.clear()
        answered.clear()
        assert await until(both_hear), f"{client.renewed} times renewed"
        assert client.renewed >= 1
        client.close()
        router.close()
        relay.server.close()

    asyncio.run(run())


def tls(folder: Path, authority: Authority, name: str, accepts: bool = False) -> dict[str, object]:
    """What Zenoh has to be told for TLS on both sides; see docs/use/scale.md."""
    certificate, secret = authority.issue(name)
    side = "listen" if accepts else "connect"
    return {
        "root_ca_certificate": str(authority.file), "enable_mtls": True,
        f"{side}_certificate": str(certificate), f"{side}_private_key": str(secret),
    }  # fmt: skip


def write(folder: Path, name: str, config: Mapping[str, object]) -> Path:
    path = folder / f"{name}.json5"
    path.write_text(json.dumps(config))
    return path


@pytest.mark.slow
def test_tls_lets_in_who_has_a_certificate_and_nobody_else(tmp_path: Path) -> None:
    ours, theirs = Authority(tmp_path / "ours"), Authority(tmp_path / "theirs", "stranger")
    server = write(
        tmp_path, "server", {"transport": {"link": {"tls": tls(tmp_path, ours, "hub", True)}}}
    )
    friend = write(
        tmp_path, "friend", {"transport": {"link": {"tls": tls(tmp_path, ours, "yard")}}}
    )
    forged = tls(tmp_path, theirs, "yard") | {"root_ca_certificate": str(ours.file)}
    stranger = write(tmp_path, "stranger", {"transport": {"link": {"tls": forged}}})

    async def run() -> None:
        loop, at = asyncio.get_running_loop(), f"tls/127.0.0.1:{free_port()}"
        hub = ZenohLink(configure([], [at], file=server), loop)
        refused = ZenohLink(configure([at], [], file=stranger), loop)
        let_in = ZenohLink(configure([at], [], file=friend), loop)
        heard = list[bytes]()
        hub.subscribe("k/**", heard.append)
        assert await until(lambda: let_in.links > 0), let_in.refusal

        def say() -> bool:
            let_in.put("k/stops", b"from a friend", urgent=True)
            refused.put("k/stops", b"from a stranger", urgent=True)
            return bool(heard)

        assert await until(say)
        assert not await until(lambda: refused.links > 0, 2.0)
        assert set(heard) == {b"from a friend"}
        for link in (refused, let_in, hub):
            link.close()

    asyncio.run(run())


def test_access_control_by_the_name_in_the_certificate(tmp_path: Path) -> None:
    """Both have valid certificates; only the gateway's name may put stops."""
    authority = Authority(tmp_path / "ca")
    rules = {
        "enabled": True, "default_permission": "deny",
        "rules": [
            {"id": "all", "permission": "allow", "flows": ["ingress", "egress"],
             "messages": ["put", "declare_subscriber"], "key_exprs": ["headland/**"]},
        ],
        "subjects": [{"id": "gateways", "cert_common_names": ["gateway"]}],
        "policies": [{"rules": ["all"], "subjects": ["gateways"]}],
    }  # fmt: skip
    link = {"link": {"tls": tls(tmp_path, authority, "hub", True)}}
    server = write(tmp_path, "server", {"transport": link, "access_control": rules})

    async def run() -> None:
        loop, at = asyncio.get_running_loop(), f"tls/127.0.0.1:{free_port()}"
        hub = ZenohLink(configure([], [at], file=server), loop)
        clients = {}
        for name in ("gateway", "visitor"):
            told = {"transport": {"link": {"tls": tls(tmp_path, authority, name)}}}
            file = write(tmp_path, name, told)
            clients[name] = ZenohLink(configure([at], [], file=file), loop)
        heard = list[bytes]()
        clients["gateway"].subscribe("headland/**", heard.append)
        far = list[bytes]()
        clients["visitor"].subscribe("headland/**", far.append)
        both = clients.values()
        assert await until(lambda: all(c.links for c in both)), [c.refusal for c in both]
        second = write(
            tmp_path, "second",
            {"transport": {"link": {"tls": tls(tmp_path, authority, "gateway")}}},
        )  # fmt: skip
        other = ZenohLink(configure([at], [], file=second), loop)

        def say() -> bool:
            other.put("headland/f/1/stops", b"from a gateway", urgent=True)
            clients["visitor"].put("headland/f/1/stops", b"from a visitor", urgent=True)
            return bool(heard)

        assert await until(say), "a gateway is heard"
        await until(lambda: False, 0.5)
        assert set(heard) == {b"from a gateway"} and not far, "a visitor is not, and hears nothing"
        for each in (*both, other, hub):
            each.close()

    asyncio.run(run())


def test_mistakes_are_told_in_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def said(connect: list[str], area: Path | None = None, segment: int = 1) -> str:
        code = bridge(
            segment, "zenoh", "x", 250_000, "", 0, "f", connect, [], "", None, area, 0.1, False
        )
        assert code == 2
        return capsys.readouterr().err

    assert "--zenoh tcp/HOST:PORT" in said([])
    assert "from 1 to" in said(["tcp/127.0.0.1:1"], segment=0)
    broken = tmp_path / "area.toml"
    broken.write_text("home = [")
    assert "does not describe an area" in said(["tcp/127.0.0.1:1"], broken)
    assert said(["nonsense"]).count("\n") == 1
    with pytest.raises(LinkError):
        configure(["tcp/127.0.0.1:1"], [], file=tmp_path / "none.json5")


@pytest.mark.parametrize("fleet", ["", "a/b", "*", "a*", "$*", "a?b", "a#b"])
def test_a_fleet_whose_name_is_no_part_of_a_key_is_refused_in_one_line(
    capsys: pytest.CaptureFixture[str], fleet: str
) -> None:
    """Most ended with a traceback, and a pattern sent stops and resets to every fleet on the backbone."""
    hub = [f"tcp/127.0.0.1:{free_port()}"]
    assert bridge(1, "zenoh", "x", 250_000, "", 0, fleet, [], hub, "", None, None, 0.1, False) == 2
    said = capsys.readouterr().err
    assert said == f"headland: --fleet {fleet!r}: a name without any of /*$?#\n"


def test_an_area_from_its_file(tmp_path: Path) -> None:
    file = tmp_path / "area.toml"
    file.write_text(
        "home = 40\nlent = [{ section = 39, to = [2] }]\n"
        "borrowed = [{ section = 40, of = 2, there = 0 }]\n"
    )
    area = read_area(1, file)
    assert area.neighbours == (2,) and area.borrowed[40] == (2, 0) and area.lent[39] == {2}


@pytest.mark.parametrize(
    "said",
    [
        "home = 100000",
        "home = 40\nlent = [{ section = 39, to = [70000] }]",
        "home = 40\nlent = [{ section = 39, to = [1] }]",
        "home = 40\nborrowed = [{ section = 40, of = 2, there = 70000 }]",
        "home = 40\nborrowed = [{ section = 40, of = 0, there = 0 }]",
    ],
)
def test_an_area_that_no_message_can_tell_is_refused(tmp_path: Path, said: str) -> None:
    """The gateway could not send its summaries, or the others could not read them."""
    file = tmp_path / "area.toml"
    file.write_text(said)
    with pytest.raises(AttachError, match="does not describe an area"):
        read_area(1, file)


@pytest.mark.parametrize(
    ("said", "why"),
    [
        ("home = 40\nlend = [{ section = 39, to = [2] }]", "lend is none of home, lent, borrowed"),
        ("home = 40\nlent = [{ section = 39, to = [2], by = 1 }]", "by is none of section, to"),
        ("home = 40\nlent = [{ section = 39.9, to = [2] }]", "39.9 is no whole number"),
        ("home = inf", "inf is no whole number"),
        ("home = 40\nlent = [{ section = 40, to = [2] }]", "section 40 is lent, and home is 40"),
        (
            "borrowed = [{ section = 40, of = 2, there = 0 }, { section = 40, of = 3, there = 0 }]",
            "section 40 is borrowed twice",
        ),
        (
            "borrowed = [{ section = 40, of = 2, there = 0 }, { section = 41, of = 2, there = 0 }]",
            "section 0 of segment 2 is borrowed twice",
        ),
    ],
)
def test_an_area_of_which_a_part_would_not_count_is_refused(
    tmp_path: Path, said: str, why: str
) -> None:
    """The segment would work alone what it meant to share."""
    file = tmp_path / "area.toml"
    file.write_text(said)
    with pytest.raises(AttachError) as problem:
        read_area(1, file)
    assert str(problem.value).endswith(why)


def test_a_section_that_is_lent_in_two_rows_is_lent_to_both(tmp_path: Path) -> None:
    """Only the last row counted, so two segments worked the section."""
    file = tmp_path / "area.toml"
    file.write_text("home = 1\nlent = [{ section = 0, to = [2] }, { section = 0, to = [3] }]\n")
    assert read_area(1, file).lent == {0: {2, 3}}
