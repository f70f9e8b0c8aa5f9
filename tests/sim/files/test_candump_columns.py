"""Logs that are read some thousand lines at a time give what they give line by line."""

from pathlib import Path
from random import Random

import can
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from protocol.frames.frame import Frame
from sim.files import candump
from sim.files.candump import CandumpWriter, FrameColumns, _by_lines, read_candump, read_columns
from sim.record.recording import Recording
from tests.examples import examples

LINES = st.sampled_from(
    [
        b"(1.234567) can0 0CFF1080#0011223344556677\n",
        b"(1.234568) vcan1 18EEFF80#\n",
        b"(1.5) can0 0CFF1080#00\n",  # fewer digits than we write
        b"  (2.000001) can0 0CFF1080#00  \n",
        b"(2.000002) can0 0cff1080#aabb\r\n",
        b"(2.000003) can0 3CFF1080#00\n",  # no 29-bit identifier
        b"(2.000004) can0 123#00\n",
        b"(2.000005) can0 0CFF1080#R\n",
        b"(2.000006) can0 0CFF1080##100\n",
        b"noise (2.000007) can0 0CFF1080#00\n",
        b"(2.000008) can0 0CFF1080#001\n",
        b"\n",
        b"x" * 1500 + b"\n",
        b"(3.000000) " + b"c" * 700 + b" 0CFF1080#00\n",
        b"(3.000001) can0 0CFF1080#00",  # the next line is lost with it, as it is to a person
    ]
)


@settings(max_examples=examples(200))
@given(lines=st.lists(LINES, max_size=30), block=st.integers(1, 900))
def test_blocks_of_any_size_are_the_lines_of_the_file(
    tmp_path_factory: pytest.TempPathFactory, lines: list[bytes], block: int
) -> None:
    path = tmp_path_factory.mktemp("log") / "can.log"
    path.write_bytes(b"".join(lines))
    counts: list[str] = []
    whole = _by_lines(
        path.read_bytes(), lambda: counts.append("damaged"), lambda: counts.append("other")
    )
    found: list[str] = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(candump, "BLOCK_BYTES", block)
        rows = list(
            read_candump(path, lambda: found.append("damaged"), lambda: found.append("other"))
        )
    assert rows == list(whole.rows()) and found == counts


def test_a_log_is_read_as_python_can_reads_it(tmp_path: Path) -> None:
    """Twenty thousand frames of all lengths: four blocks."""
    seed = 31
    rng, path = Random(seed), tmp_path / "can.log"
    log = CandumpWriter(path)
    for k in range(20_000):
        log.write(k * 137, Frame(rng.getrandbits(29), rng.randbytes(rng.randrange(9))))
    log.close()
    theirs = [
        (round(m.timestamp * 1e6), Frame(m.arbitration_id, bytes(m.data)))
        for m in can.LogReader(path)
    ]
    assert list(read_candump(path)) == theirs, f"seed {seed}"
    one_by_one, at_once = Recording(), Recording()
    for t_us, frame in theirs:
        one_by_one.write(t_us, frame)
    for columns in read_columns(path):
        at_once.extend(columns)
    assert list(at_once.rows()) == list(one_by_one.rows()) == theirs
    assert at_once.digest.hex == one_by_one.digest.hex and at_once.count == one_by_one.count
    assert at_once[12_345] == theirs[12_345]


def test_a_time_before_that_of_the_frame_before_is_raised_to_it() -> None:
    recording = Recording()
    recording.extend(FrameColumns([5, 3], [1, 2], b"\0\0", bytes(16)))
    recording.extend(FrameColumns([4, 9], [3, 4], b"\0\0", bytes(16)))
    assert [t_us for t_us, _ in recording.rows()] == [5, 5, 5, 9]
