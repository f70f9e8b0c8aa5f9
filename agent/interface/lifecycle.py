"""The lifecycle of a peer in the fleet: five states, as one total table.

Printed by `headland inspect --mermaid`. Edges beyond the basic diagram, each with its reason:

* DISCONNECTED -> EMERGENCY_STOP: a robot that is powered but has not joined can move (by hand, or
  while joining), so it must obey a stop as well.
* WORKING -> SYNCHRONIZING: after a network cut has healed, the other side's work must be merged
  before this robot decides what to do next. A section it has started stays its own and is resumed.
* WORKING -> WORKING on CLAIMED: the next section was claimed while this one was being worked.
* any -> DISCONNECTED on BUS_LOST: bus-off or a lost address, so nobody receives this robot.
  EMERGENCY_STOP is the exception: only a person ends a latch, regardless of the bus.
* any moving state -> DISCONNECTED on LEFT: a graceful leave.
"""

from enum import IntEnum

from protocol.state_machine import matrix


class State(IntEnum):
    """The states of a peer. The values travel in three bits of POSE and HEARTBEAT."""

    DISCONNECTED = 0  # not part of the fleet
    IDLE = 1  # a member that others receive, without work
    SYNCHRONIZING = 2  # merging the fleet's state into its own
    WORKING = 3  # holds a section and works it
    EMERGENCY_STOP = 4  # all motion and work ceased; latched until a person resets this machine


class Event(IntEnum):
    """What moves a peer from one state to another; in brackets the names of the requirements."""

    FLEET_JOINED = 0  # address claimed and announced (mission: on_fleet_join)
    SYNC_RECEIVED = 1  # fleet state differs from ours and is arriving (on_state_sync_received)
    SYNC_COMPLETE = 2  # digests agree, or no member is left to ask (on_sync_complete)
    CLAIMED = 3  # the contention window passed and our claim still wins (on_task_claim_successful)
    TASK_COMPLETE = 4  # finished, released, or lost to a better claim (on_task_complete)
    EMERGENCY = 5  # a stop dot that is not cleared (on_emergency_message)
    MANUAL_RESET = 6  # a person at this machine, with no stop dot left (on_manual_reset)
    BUS_LOST = 7  # bus-off, or the source address was lost
    LEFT = 8  # graceful leave


DISCONNECTED, IDLE, SYNCHRONIZING, WORKING, EMERGENCY_STOP = State
STOP, stay = EMERGENCY_STOP, None
ABLE = (IDLE, WORKING, SYNCHRONIZING)  # states of robots that drive; others do not drive at all

# fmt: off
TABLE = matrix(
    Event,
    # state         JOINED SYNC_RCVD      SYNC_DONE CLAIMED  COMPLETE EMERGENCY RESET         BUS_LOST      LEFT
    (DISCONNECTED,  IDLE,  stay,          stay,     stay,    stay,    STOP,     stay,         stay,         stay),
    (IDLE,          stay,  SYNCHRONIZING, stay,     WORKING, stay,    STOP,     stay,         DISCONNECTED, DISCONNECTED),
    (SYNCHRONIZING, stay,  stay,          IDLE,     stay,    stay,    STOP,     stay,         DISCONNECTED, DISCONNECTED),
    (WORKING,       stay,  SYNCHRONIZING, stay,     stay,    IDLE,    STOP,     stay,         DISCONNECTED, DISCONNECTED),
    (EMERGENCY_STOP,stay,  stay,          stay,     stay,    stay,    stay,     DISCONNECTED, stay,         stay),
)
# fmt: on
