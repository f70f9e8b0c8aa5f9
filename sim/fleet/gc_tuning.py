"""What stands when a process begins its work: the garbage collector leaves it alone from then on.

A full collection looks at every object there is. With the libraries of a robot imported that takes tens
of milliseconds, at any moment, and meanwhile a stop is not heard. What was imported and built by then
stays until the process ends, so there is nothing in it to collect.
"""

import gc


def leave_standing() -> None:
    """Once, in a process that answers in real time, when all is built and before it goes to work."""
    gc.collect()
    gc.freeze()
