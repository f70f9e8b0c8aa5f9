"""Exclude the objects that exist at the start of work from garbage collection.

A full collection visits every object. With the libraries of a robot imported it takes tens of
milliseconds, at any moment, and no stop is processed meanwhile. Objects that were imported and
built by then live until the process ends, so there is nothing to collect in them.
"""

import gc


def freeze_gc() -> None:
    """Call once in a process with real-time duties, when all is built and before it starts work."""
    gc.collect()
    gc.freeze()
