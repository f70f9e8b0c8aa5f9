"""Seeds of the newest campaigns that broke a rule, and what was mended: they keep every rule now.

A profile that is drawn differently later plays other scenarios; smaller tests then hold what was mended.
"""

import pytest

from sim.chaos.fault_profiles import draw
from sim.chaos.verdict import judge

MENDED = {
    # The bar swung the wrong way round a corner, and a quarter of a disc was left.
    ("body", 12000021): "agent/field/bar_swing.py",
    ("all", 20000060): "agent/field/bar_swing.py",
    # A standing robot whose place had jumped was believed to have gained speed since.
    ("senses", 20500156): "agent/peer/sense_freshness.py",
    ("senses", 20500070): "agent/peer/sense_freshness.py",
    # A robot that had just been told to drive at full speed was believed to be that fast already.
    ("senses", 20500481): "agent/peer/sense_freshness.py",
    ("stalls", 20600789): "agent/peer/sense_freshness.py",
    # A place jumped while the process hung or the senses repeated what they had said: no robot sees that.
    ("stalls", 20600555): "sim/chaos/scenario_judge.py",
    ("stalls", 20600733): "sim/chaos/scenario_judge.py",
    ("stalls", 20600783): "sim/chaos/scenario_judge.py",
    ("senses", 20501085): "sim/chaos/scenario_judge.py",
    ("forged_field", 21800893): "sim/chaos/scenario_judge.py",
    # Its place drifted until the robot stood, and jumped by less than its way before it had moved again.
    ("stalls", 20600507): "sim/chaos/scenario_judge.py",
    # A filter that hung while the process was down repeated what the process had heard before.
    ("all", 20001421): "sim/fleet/sensor_faults.py",
    # An acute corner of a ring was worked for good, with no fault that had to do with it.
    ("corners", 0): "agent/field/bar_swing.py",
    # What follows is what the first way to notice hung fixes took for them: a push, slip and a jump.
    ("body", 70400167): "agent/peer/place_progress.py",
    ("senses", 70500033): "agent/peer/place_progress.py",
    ("senses", 70500148): "agent/peer/place_progress.py",
    # Wheels that slipped moved a robot faster than told, and its next command followed that.
    ("senses", 40500055): "agent/avoidance/stopping_constraint.py",
    # A place fell back by a millimetre as the robot turned round, and a jump of 1 m made up for it.
    ("traffic", 81700168): "agent/peer/place_progress.py",
    # A jump of 1 m replaced one of a kilometre, which had begun while the process did nothing.
    ("stalls", 80700178): "sim/chaos/fault_profiles.py",
    # A robot that a person pushed touched one that stood, and moved it by 4 cm.
    ("body", 80400236): "sim/chaos/scenario_judge.py",
    # A jump of 10 m was one of 1 m when the frozen place showed it.
    ("senses", 60500215): "sim/chaos/scenario_judge.py",
    # A robot pressed a stop by itself, and the press of a person right after that sends no other one.
    ("devices", 61100646): "sim/fleet/simulated_fleet.py",
    ("devices", 61100789): "sim/fleet/simulated_fleet.py",
    ("devices", 61100896): "sim/fleet/simulated_fleet.py",
    # Wheels that do not answer go on by their last command until that expires.
    ("implement", 60800694): "sim/chaos/scenario_judge.py",
    # A point behind a fence was kept in mind, beside a ray that ended as far away at the fence.
    ("senses", 60500613): "agent/motion/obstacle_detector.py",
    # A vehicle of somebody else was shut in by robots that waited for it to leave.
    ("traffic", 61600575): "sim/fleet/moving_obstacles.py",
    # A broken device said one epoch twice by chance, and was believed.
    ("strangers", 61200596): "agent/peer/work_admission.py",
    # A second jump began before the robot believed its place again after the first one.
    ("senses", 60500973): "sim/chaos/scenario_judge.py",
    # A place that drifted while the robot stood made it fast, so a jump right after it was believed.
    ("senses", 40500025): "agent/peer/sense_freshness.py",
    # A small jump began before the robot believed its place again.
    ("senses", 40500009): "sim/chaos/scenario_judge.py",
    # Its place was frozen until after a person let go of it.
    ("body", 40400037): "sim/chaos/scenario_judge.py",
    # Its place was frozen while a person pushed it.
    ("body", 20400443): "sim/chaos/scenario_judge.py",
    # No rays were missed while the senses repeated what they had said.
    ("all", 20000196): "sim/chaos/scenario_judge.py",
    # Wheels were told to drive in vain: a small jump cannot be told from what they might have driven.
    ("senses", 20500080): "sim/chaos/scenario_judge.py",
    # A person started the robot while its place was wrong, and so said that it was right.
    ("stop", 20300169): "sim/chaos/scenario_judge.py",
    # A person pushed a robot with its implement down, which is no driving.
    ("body", 20400183): "sim/chaos/scenario_judge.py",
    # Two or three faults held one implement at a time, and its way counted two or three times.
    ("implement", 20800572): "sim/chaos/scenario_judge.py",
    ("implement", 20800902): "sim/chaos/scenario_judge.py",
    # An implement that did not rise was dragged along a line in the section of another robot.
    ("implement", 20800506): "sim/world/checkers.py",
    # A vehicle of somebody else appeared on a robot that stood.
    ("traffic", 21600124): "sim/fleet/moving_obstacles.py",
    # A robot with a new disk started while its place was wrong, which it cannot know.
    ("crash", 20200123): "sim/chaos/fault_profiles.py",
    # A fleet was started while a place was frozen: what the robot had driven until then became a jump.
    ("all", 20000681): "agent/peer/sense_freshness.py",
    ("stop", 20300781): "agent/peer/sense_freshness.py",
    # A box fell on a robot that had no place, and pushed it away.
    ("all", 20000835): "sim/fleet/dropped_box.py",
    ("body", 20400417): "sim/fleet/dropped_box.py",
    # The time of a bus-off passed for time in which two robots were connected.
    ("claims", 96000005): "sim/fleet/contact_history.py",
    # A robot that stood because its place led nowhere was pushed on, which passed for a jump.
    ("corners", 96000065): "agent/peer/place_jumps.py",
    # A wrong place left a point before a fence, which passed for an obstacle.
    ("fixes", 99000154): "agent/motion/obstacle_detector.py",
    # A robot that swayed at the end of its section took the bar to be where its velocity pointed.
    ("all", 102000117): "agent/field/field_mission.py",
    # People pushed a robot for more than 3 s, and against a vehicle at the end.
    ("steered", 102000168): "sim/chaos/scenario_judge.py",
    # A robot died while a broken device sent claims from its address, which were signs of its life.
    ("protocol", 103000046): "sim/fleet/strangers.py",
    # A start that waited in the operator's device during a flood arrived after a later stop.
    ("flood", 104000086): "sim/fleet/fault_injector.py",
    # The disk of a robot was full at its start, and it told an incarnation that it did not keep.
    ("crash", 103000061): "agent/runtime/peer_runner.py",
    # A flood hid a stop from a robot, which first heard of it by its clearing.
    ("stop", 104000389): "agent/safety/stop_controller.py",
    # A place came back from a jump while it was late, along the way on which the body braked.
    ("stalls", 104000407): "sim/chaos/fault_profiles.py",
    # An echo that noise had put just before another robot stayed in mind, and both stood for good.
    ("rays", 106000098): "agent/motion/obstacle_detector.py",
    # A robot was pushed across the end of a unit, which counted before the push was noticed.
    ("steered", 106000090): "agent/field/displacement_detector.py",
    # What wheels had been told in vain counted twice, so a jump was believed.
    ("traffic", 106000207): "agent/peer/place_progress.py",
    # A place jumped while it was too inaccurate for the field, so that nobody compared it.
    ("senses", 107000097): "agent/peer/sense_freshness.py",
    # A receiver hung at a corner, and each fall of the place turned the command across the motion.
    ("fixes", 110000064): "agent/peer/place_progress.py",
    # A person pushed a robot whose clock had gone back, and did not start it.
    ("all", 112001244): "sim/chaos/fault_profiles.py",
    # A start came just after a place froze, while the body still drove.
    ("all", 112001178): "agent/peer/sense_freshness.py",
    # A robot drove 0.3 m before it found its place frozen, and another one touched it there.
    ("senses", 114001205): "agent/motion/obstacle_detector.py",
    # The senses of a robot with a hung receiver went away, and came back while it still hung.
    ("fixes", 115200000): "sim/chaos/scenario_judge.py",
    # A hung place was not found while the body braked before its goal.
    ("fixes", 115600014): "agent/peer/place_progress.py",
    # A process hung 36 ms after a place had jumped, and its senses repeated the place before the jump.
    ("stalls", 115600035): "sim/chaos/scenario_judge.py",
    # Two robots that were cut off from each other drove to one row.
    ("apart", 115500072): "agent/motion/obstacle_detector.py",
    # A stop was pressed at the time at which the bus was cut, and its robot lost its memory of it.
    ("stop", 115400199): "sim/chaos/scenario_judge.py",
    # A hung place made the robot turn to and fro before its goal. A hung place jumped away and back.
    ("fixes", 115400116): "agent/peer/place_progress.py",
    ("fixes", 115400127): "agent/peer/place_progress.py",
    # Wheels slipped, and each command beside a fence was the speed at which that moved the body.
    ("senses", 115900022): "agent/avoidance/fence_braking.py",
    # A tractor braked for one that came at full speed, and stood in its way.
    ("steered", 116000006): "agent/motion/tractor_motion.py",
    # A box fell before a robot, which stood at it until it was gone.
    ("body", 116000005): "sim/chaos/scenario_judge.py",
    # A place jumped on along the way that a robot was told to drive while a person held it back.
    ("shapes", 116000023): "sim/chaos/scenario_judge.py",
    # The robot that had worked units lost its disk, and the other one had been off meanwhile.
    ("crash", 116000004): "sim/chaos/scenario_judge.py",
    # The implement of a body that was turned by 13 degrees came down where a unit begins.
    ("steered", 115900003): "agent/field/tractor_mission.py",
    # A place jumped by less than a body brakes while it drifted by more than its robot compares.
    ("senses", 116200035): "sim/chaos/fault_profiles.py",
    # A robot told units just before it died, and the only other one that knew them died next.
    ("crash", 116200154): "sim/chaos/scenario_judge.py",
    # A robot told units behind a cut, and lost its disk before the others heard of them.
    ("apart", 116200100): "sim/chaos/unit_knowledge.py",
}


@pytest.mark.slow
@pytest.mark.parametrize(("profile", "seed"), MENDED)
def test_a_seed_that_broke_a_rule_keeps_it_now(profile: str, seed: int) -> None:
    verdict = judge(draw(seed, profile))
    assert verdict.ok, f"headland chaos --profile {profile} --seeds {seed}: {verdict.broken}"
