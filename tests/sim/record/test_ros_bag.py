"""A bag of a run, as `rosbags` and `mcap-ros2-support` read it."""

from math import atan2, pi, remainder
from pathlib import Path

import numpy as np
import pytest

from sim.record.recording import Recording
from sim.record.ros_bag import BagError, CoverageGrid, Storage, write_bag
from tools.run.export import export
from tools.run.run_field import run as work

highlevel = pytest.importorskip("rosbags.highlevel", reason="the extra ros is not installed")
reader = pytest.importorskip("mcap_ros2.reader", reason="mcap-ros2-support is not installed")


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("run") / "small"
    assert work("small", 2, 3, folder, False, None, [], None, None, None, 40.0) in (0, 1)
    return folder


def recorded(run: Path) -> Recording:
    from sim.record.mcap_log import read_recording

    return read_recording(run / "run.mcap")


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_rosbags_reads_every_message(run: Path, tmp_path: Path, storage: Storage) -> None:
    bag = tmp_path / "bag"
    assert export(run, None, None, bag, storage) == 0
    intents = recorded(run).intents
    with highlevel.AnyReader([bag]) as opened:
        found = {
            topic: [
                (t_ns, opened.deserialize(data, connection.msgtype))
                for connection, t_ns, data in opened.messages(
                    [c for c in opened.connections if c.topic == topic]
                )
            ]
            for topic in opened.topics
        }
    assert {
        "/robot0/odom",
        "/robot1/plan",
        "/tf",
        "/diagnostics",
        "/estop",
        "/coverage",
        "/field",
    } <= {*found}
    assert len(found["/tf"]) == len(intents)
    for slot in (0, 1):
        own = [(t_us, each) for t_us, each in intents if each["slot"] == slot]
        told = found[f"/robot{slot}/odom"]
        assert len(told) == len(own)
        for (t_us, each), (t_ns, message) in zip(own, told, strict=True):
            pose = message.pose.pose
            heading_rad = 2 * atan2(pose.orientation.z, pose.orientation.w)
            stamp = message.header.stamp
            assert t_ns == 1000 * t_us == stamp.sec * 10**9 + stamp.nanosec
            assert (pose.position.x, pose.position.y) == (each["x"], each["y"])
            assert remainder(heading_rad - each["heading"], 2 * pi) == pytest.approx(0.0, abs=1e-6)
            speed_m_s = np.hypot(message.twist.twist.linear.x, message.twist.twist.linear.y)
            assert speed_m_s == pytest.approx(np.hypot(each["vx"], each["vy"]), abs=1e-9)
    grid = found["/coverage"][-1][1]
    assert grid.info.width * grid.info.height == len(grid.data)
    assert 0 < np.count_nonzero(grid.data == 100) < len(grid.data)


def test_mcap_ros2_support_reads_the_same(run: Path, tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    counts = write_bag(recorded(run), bag, "mcap")
    with (bag / "bag.mcap").open("rb") as file:
        told = [
            (m.channel.topic, m.log_time_ns, m.ros_msg) for m in reader.read_ros2_messages(file)
        ]
    assert len(told) == counts.total()
    with highlevel.AnyReader([bag]) as opened:
        ours = [
            (connection.topic, t_ns, opened.deserialize(data, connection.msgtype))
            for connection, t_ns, data in opened.messages()
        ]
    key = {"/tf": lambda m: m.transforms[0].transform.translation.x}
    for topic in counts:
        one = [(t, m) for name, t, m in told if name == topic]
        other = [(t, m) for name, t, m in ours if name == topic]
        assert [t for t, _ in one] == [t for t, _ in other]
        if topic in key:
            assert [key[topic](m) for _, m in one] == [key[topic](m) for _, m in other]
        if topic.endswith("odom"):
            places = [[m.pose.pose.position.x for _, m in each] for each in (one, other)]
            assert places[0] == places[1]


def test_a_bag_is_never_written_over_another_and_never_half(run: Path, tmp_path: Path) -> None:
    (tmp_path / "bag").mkdir()
    with pytest.raises(BagError, match="exists"):
        write_bag(recorded(run), tmp_path / "bag", "mcap")
    with pytest.raises(BagError, match="no recorded places"):
        write_bag(Recording(), tmp_path / "other", "mcap")
    broken = recorded(run)
    broken.intents.append((broken.intents[-1][0], {"slot": 0}))
    with pytest.raises(KeyError):
        write_bag(broken, tmp_path / "third", "mcap")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["bag"]


@pytest.mark.parametrize("name", ["bag[1]", 'it\'s a: "bag"', "b\u00fcg"])
def test_a_bag_of_any_name_has_the_files_that_its_metadata_names(
    run: Path, tmp_path: Path, name: str
) -> None:
    """The file of `bag[1]` kept the name `bag[1].part.mcap`: the name was taken for a pattern."""
    counts = write_bag(recorded(run), tmp_path / name, "mcap")
    with highlevel.AnyReader([tmp_path / name]) as opened:
        assert sum(1 for _ in opened.messages()) == counts.total()
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_a_bag_removes_nothing_beside_it(run: Path, tmp_path: Path) -> None:
    """`--bag day` deleted a folder that was called `day.part`."""
    mine = tmp_path / "bag.part" / "notes.txt"
    mine.parent.mkdir()
    mine.write_text("kept")
    write_bag(recorded(run), tmp_path / "bag", "mcap")
    assert mine.read_text() == "kept"


def test_a_folder_without_a_run_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert export(tmp_path, None, None, tmp_path / "bag", "mcap") == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_a_swath_marks_the_cells_under_the_bar() -> None:
    grid = CoverageGrid([(0.0, 0.0), (20.0, 0.0), (20.0, 10.0), (0.0, 10.0)], 4.0)
    for x_m in (2.0, 4.0, 6.0):
        grid.take({"slot": 0, "x": x_m, "y": 5.0, "heading": 0.0, "tool": True})
    grid.take({"slot": 0, "x": 8.0, "y": 5.0, "heading": 0.0, "tool": False})
    rows, columns = np.nonzero(grid.cells == 100)
    area_m2 = len(rows) * grid.cell_m**2
    assert area_m2 == pytest.approx(16.0, rel=0.3)
    assert columns.max() * grid.cell_m <= 6.5 and rows.min() * grid.cell_m >= 2.5
