"""Networks, one fitting loop, and PPO. This floor knows arrays, not robots."""
