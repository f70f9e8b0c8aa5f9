"""The colours of robots, by slot: the same in the map, in every picture, in the report and in plans.

Ten hues that can be distinguished on black and on white, then the same hues lighter. Text also
names every robot, because not everyone can distinguish ten colours.
"""

RGB = tuple[float, float, float]

ROBOTS = (
    "#3b8ede", "#e69f00", "#14a87a", "#d86fa5", "#9a7df0", "#d9601a", "#c9b800", "#39b8c4", "#a87f5d",
    "#84a830",
    "#8cc0f5", "#f5c869", "#79d6b8", "#f0b3d2", "#c8b8fa", "#f5a06b", "#e6dc6e", "#96e0e5", "#d0b096",
    "#c4d67e",
)  # fmt: skip


def colour_of(slot: int) -> str:
    """The colour in the form of HTML and matplotlib: #rrggbb."""
    return ROBOTS[slot % len(ROBOTS)]


def rgb_of(slot: int) -> RGB:
    """Red, green and blue, 0 to 1."""
    text = colour_of(slot)
    return int(text[1:3], 16) / 255, int(text[3:5], 16) / 255, int(text[5:7], 16) / 255
