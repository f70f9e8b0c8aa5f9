"""Standard JSON: infinite values and NaN become null.

Python writes `Infinity` and `NaN`, which other JSON readers reject.
"""

import json
from math import isfinite
from typing import Any


def dumps(value: Any, **how: Any) -> str:
    """Like `json.dumps`. TypeError if a value is not plain."""
    return json.dumps(_finite(value), allow_nan=False, **how)


def _finite(value: Any) -> Any:
    if isinstance(value, float):
        return value if isfinite(value) else None
    if isinstance(value, dict):
        return {_finite(key): _finite(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(each) for each in value]
    return value
