"""Packages that a base install leaves out, and the extra that installs each."""

EXTRA_OF = {
    "numpy": "sim", "scipy": "sim", "numba": "sim", "shapely": "sim", "pyproj": "sim",
    "pymunk": "sim", "matplotlib": "sim", "PIL": "sim", "pandas": "frames",
    "textual": "operator", "mcap": "operator", "httpx": "operator",
    "isoxml": "isoxml",
    "prometheus_client": "metrics",
    "foxglove": "foxglove",
    "cantools": "formats",
    "rosbags": "ros",
    "aiomqtt": "vda5050",
    "rclpy": "ros2", "nav_msgs": "ros2", "geometry_msgs": "ros2", "sensor_msgs": "ros2",
    "std_msgs": "ros2", "std_srvs": "ros2", "visualization_msgs": "ros2", "diagnostic_msgs": "ros2",
    "pymapf": "mapf", "pettingzoo": "mapf", "gymnasium": "mapf",
    "pynmeagps": "nmea", "serial": "nmea",
    "zenoh": "backbone", "distributed": "backbone", "dask": "backbone",
    "atheris": "fuzz",
}  # fmt: skip


def needed(problem: ImportError) -> str | None:
    """One line for the person; None where it is no package of an extra that is missing."""
    package = (problem.name or "").partition(".")[0]
    extra = EXTRA_OF.get(package)
    if extra is None:
        return None
    return f"this needs {package}: pip install 'headland[{extra}]'"
