"""What `headland task list` and `status` learn of a fleet with more tasks than one digest tells."""

import asyncio
from collections.abc import Callable

import pytest

from agent.delivery.task_registry import TaskRegistry, TransportTask
from protocol.frames.codec import decode, encode
from protocol.frames.delivery_frames import BUCKET_TASKS, TaskBookDigest, TaskOrder
from protocol.frames.frame import Frame
from sim.fleet.virtual_clock import elapse, run_virtual
from tools.inspect.task_outcomes import TaskListener

BEAT_S = 0.05
ADDRESSES = (0x80, 0x81)


class FleetOfRegistries:
    """Two robots that know the same tasks, on a bus that takes everything at once."""

    def __init__(self, tasks: dict[int, TransportTask], began_s: float) -> None:
        self.robots = [TaskRegistry(slot, tasks, 0) for slot in range(len(ADDRESSES))]
        self.began_s, self.sent = began_s, 0
        self._hears: list[Callable[[Frame], None]] = []

    def subscribe(self, hear: Callable[[Frame], None]) -> None:
        self._hears.append(hear)

    def send(self, frame: Frame) -> bool:
        _, message = decode(frame)
        if isinstance(message, TaskBookDigest):
            self.sent += 1
            for robot in self.robots:
                robot.on_message(message, self._now_us())
        return True

    def _now_us(self) -> int:
        return round((self.began_s + asyncio.get_running_loop().time()) * 1e6)

    async def beat(self) -> None:
        while True:
            for address, robot in zip(ADDRESSES, self.robots, strict=True):
                for message in robot.outgoing(self._now_us()):
                    for other in self.robots:
                        if other is not robot and isinstance(message, TaskBookDigest | TaskOrder):
                            other.on_message(message, self._now_us())
                    for hear in self._hears:
                        hear(encode(message, address))
            await elapse(BEAT_S)


def learned(
    tasks: set[int], began_s: float = 0.0, only: int | None = None
) -> tuple[TaskListener, float]:
    """What was learned of a fleet that works for so long already, and how long that took, seconds."""

    async def story() -> tuple[TaskListener, float]:
        fleet = FleetOfRegistries({task: TransportTask(10, 20) for task in tasks}, began_s)
        beats = asyncio.create_task(fleet.beat())
        listener = TaskListener(fleet)  # type: ignore[arg-type]  # no bus, but it does what is asked of one
        assert await listener.learn(only)
        beats.cancel()
        return listener, asyncio.get_running_loop().time()

    return run_virtual(story())


@pytest.mark.parametrize("began_s", [0.0, 7.0, 19.0])
def test_all_of_many_tasks_are_learned(began_s: float) -> None:
    """Found: of 1,152 tasks `headland task list` left out those of no digest in three seconds."""
    tasks = set(range(24 * BUCKET_TASKS))
    listener, took_s = learned(tasks, began_s)
    assert listener.known == listener.orders.keys() == tasks and took_s < 60.0


def test_a_hole_between_numbers_is_asked_about_twice_and_then_left() -> None:
    listener, took_s = learned({0, 1, 200 * BUCKET_TASKS})
    assert listener.known == {0, 1, 200 * BUCKET_TASKS} and took_s < 40.0


@pytest.mark.parametrize("task", [0, 600, 24 * BUCKET_TASKS - 1])
def test_one_of_many_tasks_is_learned_at_once(task: int) -> None:
    """Found: `headland task status` said that no robot knows it."""
    listener, took_s = learned(set(range(24 * BUCKET_TASKS)), only=task)
    assert task in listener.orders and took_s < 10.0


def test_few_tasks_take_no_longer_than_before() -> None:
    _, took_s = learned({0, 1, 2})
    assert took_s < 6.0
