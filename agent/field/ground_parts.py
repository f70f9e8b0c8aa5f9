"""Parts of a field between which no body can drive, because the ground is too narrow there."""

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry import Point as Spot

from agent.field.field_map import Field
from agent.interface.geometry import Point

Whole = NDArray[np.int64]


class GroundParts:
    """The parts of one field for one size of bodies, from its outline alone. Places are (x, y) metres."""

    def __init__(self, field: Field, keep_m: float) -> None:
        """`keep_m`: between the middle of a body and a fence, at least."""
        self._parts = [
            part
            for part in shapely.get_parts(field.polygon.buffer(-keep_m)).tolist()
            if not part.is_empty
        ]
        self._sections: list[int] = []  # the part of each section
        self._others: dict[int, frozenset[int]] = {}  # part -> sections of all others
        if len(self._parts) > 1:
            self._sections = [self.part_at(section.ends[0]) for section in field.sections]
            for part in range(len(self._parts)):
                self._others[part] = frozenset(
                    number for number, own in enumerate(self._sections) if own != part
                )

    def part_at(self, place: Point) -> int:
        """The part in which a body at this place is: the nearest one."""
        if len(self._parts) < 2:
            return 0
        return int(np.argmin(shapely.distance(self._parts, Spot(place))))

    def apart_from(self, place: Point) -> frozenset[int]:
        """The sections that a body at this place cannot reach, by number."""
        return self._others[self.part_at(place)] if self._others else frozenset()
