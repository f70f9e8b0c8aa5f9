"""Generated buildings to test robots in: corridors of one robot's width, and halls of many
rooms."""

from random import Random

CORRIDOR = """
....#######....
...............
....#######....
....#######....
"""  # two rooms of twelve places, connected by a corridor of seven cells
JUNCTION = """
###########
...........
#####.#####
#####.#####
"""  # a robot that wants to pass has to use the stem
DEAD_END = """
....#######
...........
....#######
....#######
"""  # one room; a robot at the blind end has to leave before another can enter


def rooms(seed: int, side: int = 64, pitch: int = 8, doors: float = 0.7) -> str:
    """A square of `side` cells with square rooms, one every `pitch` cells, like the benchmark map
    room-64-64-8: one-cell walls between them, doors of one cell, all rooms connected.

    `doors`: share of the walls with a door.
    """
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


def office() -> str:
    """A building of 14 m by 10 m in cells of 0.2 m: rooms, a corridor, blocks, doors of 1.4 m and
    one of 1.0 m. The thesis shows its hall only as a picture; this is a similar one."""
    width, depth, cell_m = 70, 50, 0.2
    cells = [["."] * width for _ in range(depth)]
    walls = (  # west, south, east, north in metres
        (4.6, 0.0, 4.8, 1.6), (4.6, 3.0, 4.8, 7.0), (4.6, 8.0, 4.8, 10.0),
        (9.2, 0.0, 9.4, 2.8), (9.2, 4.2, 9.4, 8.2), (9.2, 9.6, 9.4, 10.0),
        (4.8, 5.0, 6.4, 5.2), (7.8, 5.0, 9.2, 5.2), (12.2, 2.0, 12.4, 8.0),
        (1.8, 4.4, 2.8, 5.4), (10.4, 2.4, 11.0, 3.6), (6.6, 7.0, 7.4, 7.8), (2.0, 8.0, 2.6, 8.6),
    )  # fmt: skip
    for west, south, east, north in walls:
        for row in range(round(south / cell_m), round(north / cell_m)):
            for column in range(round(west / cell_m), round(east / cell_m)):
                cells[row][column] = "#"
    return "\n".join("".join(row) for row in reversed(cells))


def warehouse(
    blocks: int = 5, rows: int = 6, shelf: int = 8, deep: int = 2, aisle: int = 1, side: int = 4
) -> str:
    """Shelves of `shelf` by `deep` cells, `blocks` beside each other and `rows` behind each other,
    with aisles of `aisle` cells between them and a hall of `side` cells in the west and the
    east."""
    width = 2 * side + blocks * shelf + (blocks - 1) * aisle
    lines = ["." * width] * aisle
    for _ in range(rows):
        run = ("." * aisle).join("#" * shelf for _ in range(blocks))
        lines += ["." * side + run + "." * side] * deep + ["." * width] * aisle
    return "\n".join(lines)
