"""What is wrong with a graph of ROS is one line, said by `headland ros2`."""

import asyncio
import sys

import pytest

from tools.ros2.command import GraphError, _joined, serve


@pytest.mark.parametrize("namespace", ["a b", "yard/*", "9lives", "a//b", "/", "a\x1b[2J"])
def test_a_namespace_that_ros_cannot_have_is_one_line(
    namespace: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Found: by Zenoh it was a traceback."""
    pytest.importorskip("zenoh", reason="the extra `backbone` is not installed")
    pytest.importorskip("rosbags", reason="the extra `ros` is not installed")
    where = ("socketcand", "can0", 250_000, "127.0.0.1", 1)
    code = serve(where, None, None, None, namespace, None, 0.1, "tcp/127.0.0.1:1")
    told = capsys.readouterr().err
    if namespace == "/":  # the root: then the bus is missed
        assert code == 2 and "cannot open socketcand" in told
    else:
        assert code == 2 and told.startswith("headland: --namespace") and "\x1b" not in told
    assert len(told.splitlines()) == 1


def test_an_rclpy_that_cannot_be_loaded_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    """Found: a ROS for another Python was a traceback, or said that it is not installed."""
    monkeypatch.setitem(sys.modules, "tools.ros2.dds_graph", None)
    with pytest.raises(GraphError, match=r"^rclpy cannot be loaded: "):
        asyncio.run(_joined("headland", None, None))


@pytest.mark.parametrize("domain", ["abc", "-1", "233", "9999999999", "²"])
def test_a_domain_of_the_environment_that_is_none_is_one_line(
    domain: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Found: a traceback."""
    pytest.importorskip("zenoh", reason="the extra `backbone` is not installed")
    pytest.importorskip("rosbags", reason="the extra `ros` is not installed")
    monkeypatch.setenv("ROS_DOMAIN_ID", domain)
    with pytest.raises(GraphError, match=r"ROS_DOMAIN_ID is .* a number from 0 to 232"):
        asyncio.run(_joined("headland", None, "tcp/127.0.0.1:1"))
