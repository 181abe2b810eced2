"""Physics: settle many commands at once, or step many arms in time."""

from qjrl.simulation.settling import SettleConfig, SettleResult, settle

__all__ = ["SettleConfig", "SettleResult", "settle"]
