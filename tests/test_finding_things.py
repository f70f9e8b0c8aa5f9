"""Questions of a newcomer, each with the file whose name alone must answer it.

The list was written before the modules were moved. A change that renames a file changes its row: ask
somebody who has not read the code whether the new name answers the question. With nothing but the
file names, newcomers gave 37 of 43 answers on 2026-11-23 and 40 of 46 on 2026-11-25. Each time some of
the files that were not found have been renamed. On 2026-11-30 two newcomers gave 44 of 46 each. Both
looked for a robot in one's own program in `headland`, and for the faults of chaos in `sim/chaos/`.
"""

from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
QUESTIONS = {
    "Why does this robot stand, and what clears each cause?": "agent/safety/stop_cause.py",
    "Where is the last word before the wheels are told to drive?": "agent/safety/stop_controller.py",
    "Who may press a stop or release it?": "agent/safety/command_authentication.py",
    "Which states does a robot have, and which events change them?": "agent/interface/lifecycle.py",
    "Where do all limits of the core stand, with their reasons?": "agent/interface/config.py",
    "Which axes does a point have, and which a cell?": "agent/interface/geometry.py",
    "What must a new mission implement?": "agent/interface/mission.py",
    "What does a body tell its robot?": "agent/interface/observation.py",
    "What can come out of the core?": "agent/interface/effects.py",
    "What happens in one control period?": "agent/peer/control_cycle.py",
    "What does a robot do with a frame that it receives?": "agent/peer/routing.py",
    "How does a robot know which others are alive?": "agent/peer/membership.py",
    "How is a leader elected?": "agent/peer/leader_election.py",
    "How does a robot claim a section?": "agent/peer/section_claims.py",
    "How does a robot notice that its position is old or frozen?": "agent/peer/sense_freshness.py",
    "Where is Theta*?": "agent/paths/theta_star.py",
    "When does each robot begin each section of a plan?": "agent/field/plan_schedule.py",
    "Where is ORCA?": "agent/avoidance/orca.py",
    "Where is PIBT?": "agent/mapf/pibt.py",
    "Where are Dubins paths?": "agent/paths/dubins.py",
    "How is a field cut into rows and sections?": "agent/field/field_division.py",
    "How do the rings along the fences turn in the tip of a field?": "agent/field/headland_rings.py",
    "How does a robot stop before a person?": "agent/motion/obstacle_stop.py",
    "How are transport tasks put into tours?": "agent/delivery/tour_auction.py",
    "Where are frontiers of an unknown building found?": "agent/exploration/frontier.py",
    "Where is a robot's durable memory written?": "agent/runtime/sqlite_journal.py",
    "Where is a peer made?": "agent/runtime/peer_factory.py",
    "What work can a robot file declare?": "agent/runtime/robot_work.py",
    "How does a robot run as a process?": "agent/runtime/robot_process.py",
    "What must the body of my vehicle implement?": "agent/runtime/robot_body.py",
    "Where are key files read?": "agent/runtime/files/key_file.py",
    "Where is the outline of a field read?": "agent/runtime/files/field_file.py",
    "How do I run a robot from my own program?": "agent/runtime/engine.py",
    "Which source address does a device take, and what if two want the same?": "protocol/address.py",
    "What is in an emergency-stop frame?": "protocol/frames/safety_frames.py",
    "How are long messages sent in frames of eight bytes?": "protocol/transport.py",
    "How are replicas made equal after a partition?": "protocol/sync/synchronizer.py",
    "Which claim of a section wins when two robots claimed it?": "crdt/claim_register.py",
    "How does the simulated wire arbitrate?": "sim/can/can_wire.py",
    "Which steps does pymunk make?": "sim/world/pymunk_engine.py",
    "Which faults can chaos play?": "sim/fleet/fault_injector.py",
    "Who judges what robots covered?": "sim/world/coverage_truth.py",
    "Which bugs are planted to test the judges?": "sim/chaos/planted_bugs.py",
    "What does `headland stop` do?": "tools/operate/estop.py",
    "What does `headland launch` start?": "tools/run/launch.py",
    "Which subcommands are there?": "tools/cli/headland.py",
    "How are commands in plain language understood?": "tools/language/parse.py",
}


@pytest.mark.parametrize("question", QUESTIONS)
def test_the_file_of_a_question_is_there(question: str) -> None:
    assert (ROOT / QUESTIONS[question]).is_file(), question


def test_there_are_thirty_questions_about_every_layer() -> None:
    assert len(QUESTIONS) >= 30
    assert {file.split("/")[0] for file in QUESTIONS.values()} == {
        "crdt", "protocol", "agent", "sim", "tools",
    }  # fmt: skip
