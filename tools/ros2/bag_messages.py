"""Standard ROS 2 messages without ROS: the classes of `rosbags`, made as those of rclpy are made.

`Odometry()` has all its fields, at zero; `Odometry(header=...)` the rest at zero; fields can be set.
"""

from collections.abc import Iterable
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore


def jazzy() -> Typestore:
    """The messages of ROS 2 Jazzy."""
    return get_typestore(Stores.ROS2_JAZZY)


def kinds_of(store: Typestore, names: Iterable[str]) -> SimpleNamespace:
    """Classes by the last part of their names."""
    return SimpleNamespace(**{name.rpartition("/")[2]: _kind(store, name) for name in names})


@cache
def _kind(store: Typestore, name: str) -> type:
    _, fields = store.fielddefs[name]

    def made(self: Any, **values: Any) -> None:
        for field, kind in fields:
            setattr(self, field, values.pop(field) if field in values else _zero(store, kind))
        if values:
            raise TypeError(f"{name} has no {', '.join(values)}")

    return type(name.rpartition("/")[2], (store.types[name],), {"__init__": made})


def _zero(store: Typestore, kind: Any) -> Any:
    node, what = kind
    if node == Nodetype.BASE:
        return _plain_zero(what[0])
    if node == Nodetype.NAME:
        return _kind(store, what)()
    (inner, element), size = what
    count = size if node == Nodetype.ARRAY else 0
    if inner == Nodetype.BASE and element[0] != "string":
        return np.zeros(count, dtype=_dtype(element[0]))
    return [_zero(store, (inner, element)) for _ in range(count)]


def _plain_zero(kind: str) -> Any:
    if kind == "string":
        return ""
    if kind == "bool":
        return False
    return 0.0 if kind.startswith("float") else 0


def _dtype(kind: str) -> Any:
    return np.dtype({"byte": "uint8", "octet": "uint8", "char": "uint8"}.get(kind, kind))
