"""A grid map as a fleet shares it: cells have numbers that fit a frame; 40 in a row are a section.

Numbers go along one walk over all free cells that depends on the map alone. So what a robot covers
in sequence mostly lies in one block of progress, which is one frame, and a section is a stretch
that one robot can begin and finish.
"""

from collections.abc import Mapping
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from agent.coverage.walk import walk
from agent.interface.geometry import Cell, Point
from crdt.progress import BLOCK_UNITS

Walls = NDArray[np.bool_]
NUMBERS_MAX = 1 << 16  # free cells: a number is a u16 on the wire
NONE = -1


class CellMap:
    """The free cells of a map: their numbers, their sections, and their places in the world."""

    def __init__(self, walls: Walls, cell_m: float) -> None:
        """`walls`: (rows, columns), True for blocked cells. ValueError: too many free cells."""
        if int(np.count_nonzero(~walls)) > NUMBERS_MAX:
            raise ValueError(f"more than {NUMBERS_MAX} free cells do not fit the wire")
        self.walls, self.cell_m = walls, cell_m
        self.rows, self.columns = walls.shape
        self.width = self.columns + 2
        free = np.ascontiguousarray(np.pad(~walls, 1).astype(np.uint8).ravel())
        self.padded = self._walk(free)  # (numbers,): cells of the padded grid
        self.number_of: NDArray[np.int32] = np.full(free.size, NONE, np.int32)
        self.number_of[self.padded] = np.arange(self.padded.size, dtype=np.int32)
        self.check = crc32(np.packbits(walls).tobytes(), crc32(repr(walls.shape).encode()))
        self.check &= 0xFFFFFF
        count = self.padded.size
        self.section_units: Mapping[int, int] = {
            section: min(BLOCK_UNITS, count - section * BLOCK_UNITS)
            for section in range(-(-count // BLOCK_UNITS))
        }

    def __len__(self) -> int:
        return int(self.padded.size)

    def _walk(self, free: NDArray[np.uint8]) -> NDArray[np.int32]:
        """Room by room, in the order of their first cells."""
        self.room = np.full(free.size, NONE, np.int32)
        orders = [np.empty(0, np.int32)]
        for start in np.flatnonzero(free).tolist():
            if self.room[start] != NONE:
                continue
            stack, members = [start], [start]
            self.room[start] = len(orders)
            while stack:
                cell = stack.pop()
                for near in (cell - 1, cell + 1, cell - self.width, cell + self.width):
                    if free[near] and self.room[near] == NONE:
                        self.room[near] = len(orders)
                        stack.append(near)
                        members.append(near)
            inside = np.zeros_like(free)
            inside[members] = 1
            orders.append(walk(inside, inside.copy(), self.width, 1, False))
        return np.concatenate(orders).astype(np.int32)

    # ---------------------------------------------------------------- names of a cell

    def unit(self, number: int) -> tuple[int, int]:
        """The section of a cell, and its unit of work there."""
        return divmod(number, BLOCK_UNITS)

    def cell(self, number: int) -> Cell:
        """The row and column of a number; row 0 is in the north."""
        row, column = divmod(int(self.padded[number]), self.width)
        return row - 1, column - 1

    def number(self, cell: Cell) -> int:
        """The number of a cell; -1 where there is a wall or no map."""
        row, column = cell
        if not (0 <= row < self.rows and 0 <= column < self.columns):
            return NONE
        return int(self.number_of[(row + 1) * self.width + column + 1])

    def centre(self, number: int) -> Point:
        """The centre of a numbered cell, from the middle of the map."""
        return self.centre_of(self.cell(number))

    def centre_of(self, cell: Cell) -> Point:
        """The centre of a cell, from the middle of the map; the cell may be a wall."""
        row, column = cell
        x_m = (column - (self.columns - 1) / 2) * self.cell_m
        return x_m, ((self.rows - 1) / 2 - row) * self.cell_m

    def cell_at(self, x_m: float, y_m: float) -> Cell:
        """The cell that a place is in; it may be a wall."""
        column = round(x_m / self.cell_m + (self.columns - 1) / 2)
        return round((self.rows - 1) / 2 - y_m / self.cell_m), column

    def at(self, x_m: float, y_m: float) -> int:
        """The number of the free cell that a place is in; -1 in a wall."""
        return self.number(self.cell_at(x_m, y_m))
