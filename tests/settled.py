"""One small settled data set of the two-segment arm, made once for all tests of a run."""

import functools

import numpy as np
from arms import arm_named

from qjrl.simulation.sampling import SampleConfig, sample_rows
from qjrl.simulation.settle_problem import SettleConfig

ARM = arm_named("qj_22")


@functools.cache
def settled_rows(count: int = 64) -> dict[str, np.ndarray]:
    """Columns of a data set; the same arrays at every call, not to be written to."""
    rows = sample_rows(ARM, SettleConfig(), seed=0, start=0, count=count, home_share=SampleConfig.home_share)
    for column in rows.values():
        column.flags.writeable = False
    return rows
