"""How many of the machine's cores are ours."""

import os


def usable_cores() -> int:
    """Those that a cluster's scheduler leaves to this process, not all of the machine's."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
