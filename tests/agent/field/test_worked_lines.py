"""The lines of a field that are worked, for pictures: they follow the progress, unit by unit."""

from math import dist

import numpy as np

from agent.field.field_map import Field, Section
from agent.field.field_mission import FieldMission
from agent.paths.route import Route
from crdt import Progress


def test_lines_follow_the_progress() -> None:
    section = Section(3, (((2.0, 5.0), (42.0, 5.0)), ((42.0, 9.0), (2.0, 9.0))), (8, 8))
    fences = ((0.0, 0.0), (50.0, 0.0), (50.0, 20.0), (0.0, 20.0))
    field = Field("lines", fences, (), (0.0, 0.0), (1.0, 1.0), 4.0, 0.2, 5.0, (section,))
    route = Route(np.zeros((100, 220), dtype=np.bool_), -1.0, -1.0, 0.25)
    work, progress = FieldMission(field, route, 0.8, 2.5, 1.5), Progress({3: 16})
    assert list(work.worked_lines(progress)) == []
    for unit in (0, 1, 6, 12):
        progress.cover(3, unit)
    lines = list(work.worked_lines(progress))
    lengths = [round(dist(line[0], line[-1]), 3) for line in lines]
    assert lengths == [10.0, 5.0, 5.0], "units that touch are one line"
    assert lines[0] == [(2.0, 5.0), (12.0, 5.0)] and lines[2][0][1] == 9.0
