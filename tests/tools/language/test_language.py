"""The language: more than a hundred phrases with their meaning, and what is never understood wrongly."""

from pathlib import Path
from random import Random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agent.interface.lifecycle import State
from agent.peer import fleet_summary
from agent.peer.fleet_summary import FleetSummary, MemberRow
from protocol.frames.codec import encode
from protocol.frames.fleet_frames import NOWHERE_M, PLACE_UNKNOWN_M_S, Member, Pose
from sim.files.whole_file import write_whole
from tests.examples import examples
from tools.bench.phrases import Case, misspelt, phrases, understood
from tools.inspect.inspector import Inspector
from tools.language import view
from tools.language.alarm import may_be_alarm
from tools.language.answer import answer
from tools.language.authorize import Authorization, weigh
from tools.language.fleet_state import FleetNow, RobotNow
from tools.language.intent import INTENTS, INTENTS_MAX, At, Control, Goal, Query, plain
from tools.language.parse import read, together
from tools.language.places import Places, PlacesError
from tools.language.question import Question, QuestionReason
from tools.language.vocabulary import TABLE

FILE = phrases()
WORKING = FleetNow({n: RobotNow(n, "WORKING", 10.0 * n, 0.0, 2.0) for n in range(3)}, {})


@pytest.mark.parametrize("case", FILE.known, ids=lambda case: case.say)
def test_a_phrase_of_the_file(case: Case) -> None:
    reading = read(case.say, FILE.places)
    if isinstance(reading, Question):
        assert case.intents is None
    else:
        assert [plain(intent) for intent in reading] == case.intents
        assert INTENTS.validate_json(INTENTS.dump_json(reading)) == reading
    result = understood(case.say, FILE)
    if isinstance(result, Question):
        assert result.reason.name == case.asks
        assert result.text and "\n" not in str(result)
    else:
        assert case.asks is None and result == case.gives


def test_the_file_has_a_hundred_and_dangerous_ones() -> None:
    assert len(FILE.known) >= 100 and len({case.say for case in FILE.known}) == len(FILE.known)
    asked = [case.asks for case in FILE.known if case.asks]
    assert {reason.name for reason in QuestionReason} == set(asked) and asked.count("UNSAFE") >= 10


@pytest.mark.parametrize("verb", ["stop", "start", "send"])
def test_no_robot_is_sent_to_where_another_one_stays(verb: str) -> None:
    """Any order for the other robot in the same phrase was taken for one to leave."""
    fleet = FleetNow({n: RobotNow(n, "IDLE", 10.0 * n, 0.0) for n in range(3)}, {})
    places = Places({"shed": (10.0, 0.0), "gate": (50.0, 0.0)})
    phrase = {"send": "send robot 1 to gate"}.get(verb, f"{verb} robot 1")
    intents = read(f"{phrase} and send robot 2 to shed", places)
    assert not isinstance(intents, Question)
    result = weigh(intents, fleet, places)
    if verb == "send":
        assert isinstance(result, Authorization) and len(result.orders) == 2
    else:
        assert isinstance(result, Question) and result.reason is QuestionReason.UNSAFE


def answered(phrase: str, fleet: FleetNow) -> str:
    reading = read(phrase, Places({}))
    assert not isinstance(reading, Question)
    (query,) = reading
    assert isinstance(query, Query)
    return answer(query, fleet, Places({}), ()).text


def test_a_robot_that_is_named_twice_gets_one_order() -> None:
    """The order was sent to it twice, and listed twice in the answer."""
    assert read("robot 1 and robot 1 go home", FILE.places) == (
        Control(action="go_home", robots=(1,)),
    )


def test_a_robot_that_does_not_know_where_it_is_is_not_at_the_origin() -> None:
    """It was told to be at 0.0, 0.0, was the nearest to what is there, and was sent."""
    heard = Inspector()
    lost = Pose(NOWHERE_M, NOWHERE_M, 0.0, PLACE_UNKNOWN_M_S, State.IDLE, False, 255)
    for slot, pose in ((0, Pose(30.0, 0.0, 0.0, 0.0, State.IDLE, False, 255)), (1, lost)):
        heard.hear(1.0, encode(Member(slot, 1, 0), 0x80 + slot))
        heard.hear(1.0, encode(pose, 0x80 + slot))
    summary = compose_of([(0, 30.0), (1, NOWHERE_M)])
    for fleet in (view.as_heard(heard), view.as_told(summary)):
        assert answered("where is robot 1", fleet) == "robot 1: it does not know where it is"
        assert "does not know where it is" in answered("status of robot 1", fleet)
        assert "does not know where it is" in answered("how far is robot 1 from 1, 1", fleet)
        assert answered("which robot is nearest to 1, 1", fleet).startswith("robot 0, ")
        nearest = fleet.nearest((1.0, 1.0))
        assert nearest is not None and nearest.slot == 0
        alone = fleet._replace(robots={1: fleet.robots[1]})
        told = answered("which robot is nearest to 1, 1", alone)
        assert (
            told == "no robot that knows its place is heard" and alone.nearest((1.0, 1.0)) is None
        )


def test_a_robot_is_not_the_nearest_to_itself() -> None:
    heard = FleetNow({n: RobotNow(n, "IDLE", 10.0 * n, 0.0) for n in range(3)}, {})
    assert answered("which robot is nearest to robot 2", heard) == "robot 1, 10.0 m away (IDLE)"
    alone = heard._replace(robots={2: heard.robots[2]})
    assert answered("which robot is nearest to robot 2", alone) == "no other robot is heard"


def test_nothing_is_measured_to_a_robot_that_does_not_know_where_it_is() -> None:
    """It was taken to be at the origin of the field."""
    lost = RobotNow(2, "IDLE", 0.0, 0.0, placed=False)
    fleet = FleetNow({0: RobotNow(0, "IDLE", 30.0, 40.0), 2: lost}, {})
    for asked in ("how far is robot 0 from robot 2", "which robot is nearest to robot 2"):
        assert answered(asked, fleet) == "robot 2: it does not know where it is"


def compose_of(places: list[tuple[int, float]]) -> FleetSummary:
    """Of idle robots, by their slots and metres east, as a peer writes it and a tool reads it."""
    rows = [MemberRow(slot, State.IDLE, "LIVE", x_m, x_m, 0.0, (), 0.1) for slot, x_m in places]
    found = fleet_summary.read(fleet_summary.write(FleetSummary(0, 0, 0, tuple(rows))))
    assert found is not None
    return found


def test_the_document_counts_as_the_file_does() -> None:
    text = (Path(__file__).parents[3] / "docs" / "measured" / "operator.md").read_text()
    asked = sum(case.asks is not None for case in FILE.known)
    meant = sum(bool(case.gives) for case in FILE.unseen)
    assert f"| {len(FILE.known)} phrases obeyed" in text and f"{asked} of them to be asked" in text
    assert f"{len(FILE.unseen)} unseen phrases" in text and f"of {meant} unseen ones" in text


def test_every_example_of_the_document_is_read() -> None:
    text = (Path(__file__).parents[3] / "docs" / "use" / "language.md").read_text()
    table = text.split("| | for example |")[1].split("\n\n")[0]
    rows = [line.split("|")[2] for line in table.splitlines() if line.count("|") == 3]
    examples = [say.strip() for row in rows for say in row.split("·") if "---" not in row]
    assert len(examples) > 20
    for say in examples:
        assert not isinstance(read(say, FILE.places), Question), say


def test_what_was_not_foreseen_is_asked_back_and_never_taken_for_something_else() -> None:
    for case in FILE.unseen:
        result = understood(case.say, FILE)
        assert isinstance(result, Question) or result == case.gives, case.say


@pytest.mark.parametrize("seed", range(3))
def test_a_misspelt_phrase_is_read_alike_or_asked_back(seed: int) -> None:
    rng = Random(seed)
    for case in FILE.known:
        said = misspelt(case.say, rng)
        result = understood(said, FILE)
        assert isinstance(result, Question) or result == case.gives, (seed, said)


@settings(max_examples=examples(200), deadline=None)
@given(st.text(max_size=60))
def test_any_text_is_an_answer_or_a_question(text: str) -> None:
    result = read(text, FILE.places)
    assert isinstance(result, Question) or INTENTS.validate_python(result)


@settings(max_examples=examples(300), deadline=None)
@given(
    st.lists(
        st.sampled_from([*sorted(" ".join(group) for group in TABLE), "2", "shelf", "zzz"]),
        max_size=9,
    )
)
def test_any_words_of_the_language_are_an_answer_or_a_question(words: list[str]) -> None:
    """Word salad: whatever is obeyed can be weighed, and names nobody that was not said."""
    result = read(" ".join(words), FILE.places)
    if isinstance(result, Question):
        return
    assert "zzz" not in words
    for intent in result:
        if isinstance(intent, Goal) and isinstance(intent.robot, int):
            assert (
                "2" in words or any(word in ("one", "two") for word in words) or intent.robot == 2
            )
    assert isinstance(weigh(result, FILE.fleet, FILE.places), Authorization | Question)


def test_nobody_idle_is_a_queue_and_not_a_refusal() -> None:
    reading = read("send the nearest robot to the shelf", FILE.places)
    assert not isinstance(reading, Question)
    verdict = weigh(reading, WORKING, FILE.places)
    assert isinstance(verdict, Authorization)
    assert verdict.orders == () and [goal.name for goal in verdict.waiting] == ["shelf"]


def test_m13_an_offer_is_a_phrase_that_can_be_said_and_no_other_verb() -> None:
    for said in ("remove robot 3", "robot 3 is broken", "shut down", "kill the engines"):
        result = understood(said, FILE)
        assert isinstance(result, Question)
        assert not any(word in str(result) for word in ("move robot 3", "own", "brake", "will"))
    corrected = understood("sned robot 2 to the gate", FILE)
    assert isinstance(corrected, Question) and corrected.instead == ("send robot 2 to the gate",)


def test_m13_a_phrase_of_the_language_is_no_alarm_unless_it_stops() -> None:
    for case in FILE.known:
        if case.intents is not None and may_be_alarm(case.say, FILE.places):
            stops = [i.get("action") in ("stop", "emergency_stop", "wait") for i in case.intents]
            asks = [i["kind"] == "query" for i in case.intents]
            assert all(one or two for one, two in zip(stops, asks, strict=True)), case.say


@pytest.mark.parametrize("number", ["twenty five", "twenty-five", "25"])
def test_a_number_of_two_words_is_one_number(number: str) -> None:
    """A robot that was sent to "twenty five" drove to 20, 5."""
    places = Places({})
    assert isinstance(read(f"send robot 1 to {number}", places), Question)
    there = read(f"send robot 1 to {number}, three", places)
    assert there == (Goal(robot=1, place=At(x_m=25.0, y_m=3.0)),)
    assert read(f"stop robot {number}", places) == (Control(action="stop", robots=(25,)),)
    apart = read("send robot 1 to twenty, five", places)
    assert apart == (Goal(robot=1, place=At(x_m=20.0, y_m=5.0)),)


def test_two_goals_for_the_nearest_go_to_two_robots() -> None:
    said = "send the nearest robot to the shelf and a robot to the gate"
    assert understood(said, FILE) == ["4 set-goal 10,0", "0 set-goal 50,50"]


def test_a_stop_is_never_made_smaller() -> None:
    for robots in ("all", "unnamed"):
        verdict = weigh((Control(action="stop", robots=robots),), WORKING, FILE.places)
        assert isinstance(verdict, Authorization) and verdict.stop_all


def test_starting_all_asks_first() -> None:
    verdict = weigh((Control(action="start", robots="all"),), WORKING, FILE.places)
    assert (
        isinstance(verdict, Authorization)
        and len(verdict.first_ask) == 1
        and len(verdict.orders) == 3
    )


def test_orders_of_one_phrase_do_not_contradict_each_other() -> None:
    there = Goal(robot=1, place=At(x_m=1.0, y_m=2.0))
    for other in (
        there,
        Control(action="stop", robots=(1, 2)),
        Control(action="go_home", robots="all"),
    ):
        result = together((there, other))
        assert isinstance(result, Question) and result.reason is QuestionReason.AMBIGUOUS
    assert isinstance(together((there,) * (INTENTS_MAX + 1)), Question)
    assert together((there, Query(ask="status"))) == (there, Query(ask="status"))


@pytest.mark.parametrize("name", ["stop", "the", "S7", "r2", "12", "go home", "and", "", "robot"])
def test_a_place_is_not_named_like_a_word_of_the_language(name: str) -> None:
    with pytest.raises(PlacesError):
        Places({name: (0.0, 0.0)})


def test_places_come_from_a_file(tmp_path: Path) -> None:
    path = tmp_path / "places.toml"
    path.write_text(
        Places.write({"north gate": (1.0, -2.5), "shelf 3": (0.0, 9.0)}, {"S0": (3.0, 4.0)})
    )
    places = Places.read(path)
    assert places.points == {"north gate": (1.0, -2.5), "shelf 3": (0.0, 9.0), "S0": (3.0, 4.0)}
    assert understood("robot 0 go to the north gate", FILE._replace(places=places)) == [
        "0 set-goal 1,-2.5"
    ]
    assert understood("send r4 to shelf 3", FILE._replace(places=places)) == ["4 set-goal 0,9"]


@pytest.mark.parametrize("name", ["dock \U0001f69c", 'größe "a"', "dock\x7f b", "dock\tb"])
def test_a_place_of_any_name_is_read_as_it_was_written(name: str, tmp_path: Path) -> None:
    """A name with an emoji was no TOML, and `headland say stop` ended with that."""
    path = tmp_path / "places.toml"
    write_whole(path, Places.write({name: (1.0, 2.0)}, {}))
    assert Places.read(path).points == {name: (1.0, 2.0)}


WRONG = (
    "places = 3", "[places]\nx1y = [1]", "[places]\ngate = [1, 99999]", "[", "[sections]\nA = [1, 2]",
)  # fmt: skip


@pytest.mark.parametrize("text", WRONG)
def test_a_wrong_file_of_places_is_one_line(text: str, tmp_path: Path) -> None:
    path = tmp_path / "places.toml"
    path.write_text(text)
    with pytest.raises(PlacesError) as problem:
        Places.read(path)
    assert "\n" not in str(problem.value) and str(path) in str(problem.value)
