"""How XLA shall compile long chains of small bodies on a CPU."""

# XLA fuses the chain so that every link computes all links before it again, its time doubling with each: MJX's kinematics
# of 8 joints took 100 s to compile and 4 s to run a row; without fusion 12 s and 0.3 ms.
CPU_COMPILER_OPTIONS = {"xla_disable_hlo_passes": "fusion"}
