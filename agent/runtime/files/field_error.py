"""The error in a user's field file, as one line."""

from agent.runtime.files.printable_text import one_line

FILE_BYTES_MAX = 64 << 20  # a boundary is kilobytes; a task file with a season's logs is megabytes
# Points of a field, its holes included: five hours of walking its edge with a position each second.
# Dividing a field takes proportional time, 5 s for 10,000 points.
POINTS_MAX = 20_000
# Formats that farm software exports as well, by the suffix of the file.
NOT_READ = {".kml": "KML", ".kmz": "KMZ", ".gpx": "GPX", ".shp": "a shapefile"}
LINE_MAX = 400  # it contains names from the file, and a name may be anything

LonLat = tuple[float, float]


class FieldFileError(Exception):
    """One line for the user of the file; no content of the file can break or colour it."""

    def __init__(self, text: str) -> None:
        super().__init__(one_line(text, LINE_MAX))
