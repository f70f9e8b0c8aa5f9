"""Binary time logs of ISO 11783-10 (TLG, type 1): a header in XML that defines a record, and the
records.

    bytes 0..3   time of day, ms         4..5   days since 1 January 1980
    bytes 6..9   latitude, 1e-7 degrees  10..13 longitude, 1e-7 degrees
    byte 14      position status (4: RTK fixed)
    byte 15      values that follow: 1, or 0 where the value is as before
    bytes 16..20 index 0 and the work state: 0 up, 1 down (DDI 141), little endian throughout
"""

from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from struct import Struct

from protocol.device_description import WORK_STATE
from sim.runs.work_record import LogPoint

EPOCH = datetime(1980, 1, 1, tzinfo=UTC)
END = EPOCH + timedelta(days=1 << 16)  # of the days that two bytes can count: in the year 2159
RTK_FIXED = 4
DEGREE = 10_000_000
DAY_MS = 86_400_000
FIXED = Struct("<IHiiBB")
VALUE = Struct("<Bi")
MILLISECOND = timedelta(milliseconds=1)

HEADER = (
    '<?xml version="1.0" encoding="UTF-8"?>\n'
    '<TIM A="" D="4">\n'
    '    <PTN A="" B="" D=""/>\n'
    '    <DLV A="{ddi:04X}" B="" C="{element}"/>\n'
    "</TIM>\n"
)


def header(element: str) -> str:
    """The XML file beside the records; `element` is the device element with the work state."""
    return HEADER.format(ddi=WORK_STATE, element=element)


def pack(log: Sequence[LogPoint], started: datetime) -> bytes:
    """Records of one robot's track, from `EPOCH` to `END`."""
    start_at_ms = (started - EPOCH) // MILLISECOND
    records, before = [], None
    for point in log:
        days, day_at_ms = divmod(start_at_ms + point.t_ms, DAY_MS)
        values = VALUE.pack(0, int(point.working)) if point.working is not before else b""
        before = point.working
        lat, lon = round(point.lat * DEGREE), round(point.lon * DEGREE)
        records.append(FIXED.pack(day_at_ms, days, lat, lon, RTK_FIXED, bool(values)) + values)
    return b"".join(records)
