"""Drawn buildings to try robots in: corridors of one robot's width, and halls of many rooms."""

from random import Random

CORRIDOR = """
....#######....
...............
....#######....
....#######....
"""  # two rooms of twelve places, seven cells of corridor between them
JUNCTION = """
###########
...........
#####.#####
#####.#####
"""  # whoever wants past has to use the stem
DEAD_END = """
....#######
...........
....#######
....#######
"""  # one room; whoever is at the blind end has to get out before another gets in


def rooms(seed: int, side: int = 64, pitch: int = 8, doors: float = 0.7) -> str:
    """A square of square rooms like the benchmark map room-64-64-8: one-cell walls between them,
    doors of one cell, all rooms connected; `doors`: share of the walls with a door."""
    rng = Random(f"{seed}/rooms")
    cells = [["."] * side for _ in range(side)]
    count = side // pitch
    for k in range(1, count):
        for n in range(side):
            cells[k * pitch - 1][n] = cells[n][k * pitch - 1] = "#"
    group = list(range(count * count))

    def root(k: int) -> int:
        while group[k] != k:
            k = group[k]
        return k

    walls = [(r, c, True) for r in range(count) for c in range(count - 1)]
    walls += [(r, c, False) for r in range(count - 1) for c in range(count)]
    rng.shuffle(walls)
    for r, c, east in walls:
        a, b = root(r * count + c), root(r * count + c + (1 if east else count))
        if a == b and rng.random() >= doors:
            continue
        group[a] = b
        along, across = (r, c) if east else (c, r)
        at, wall = along * pitch + rng.randrange(pitch - 1), (across + 1) * pitch - 1
        cells[at if east else wall][wall if east else at] = "."
    return "\n".join("".join(row) for row in cells)
