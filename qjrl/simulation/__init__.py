"""Physics: settle many commands at once, or step many arms in time."""

from qjrl.simulation.settle_problem import SettleConfig
from qjrl.simulation.settling import SettleResult, settle

__all__ = ["SettleConfig", "SettleResult", "settle"]
