"""Names of parameter groups that Headland does not speak and that are common on a tractor's bus."""

NAMES = {
    0x0AA00: "device to file server",
    0x0AB00: "file server to device",
    0x0AC00: "guidance machine status",
    0x0AD00: "guidance system command",
    0x0CA00: "transfer: an answer to Request2",
    0x0F003: "EEC2: engine, accelerator",
    0x0F004: "EEC1: engine speed",
    0x0F022: "machine selected speed",
    0x0FD43: "machine selected speed command",
    0x0FE08: "hitch and PTO commands",
    0x0FE0C: "working set member",
    0x0FE0F: "language command",
    0x0FE43: "rear PTO output shaft",
    0x0FE45: "rear hitch",
    0x0FE47: "maintain power",
    0x0FE48: "wheel-based speed and distance",
    0x0FE49: "ground-based speed and distance",
    0x0FEE5: "engine hours",
    0x0FEE6: "time and date",
    0x0FEE8: "vehicle direction and speed",
    0x0FEEE: "engine temperature",
    0x0FEEF: "engine fluid level and pressure",
    0x0FEF1: "CCVS: cruise control, vehicle speed",
    0x0FEF3: "vehicle position",
    0x0FEF2: "fuel economy",
    0x1F801: "position, rapid update (NMEA 2000)",
    0x1F802: "course and speed over ground, rapid update (NMEA 2000)",
    0x1F805: "GNSS position data (NMEA 2000)",
}


def group_name(pgn: int) -> str:
    """The number, as ISO 11783 writes it, and what it is where we know it."""
    name = NAMES.get(pgn)
    return f"PGN {pgn}" if name is None else f"PGN {pgn} ({name})"
