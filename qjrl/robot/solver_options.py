"""Numerical settings of the physics that the MJCF of every kind of robot takes."""

from typing import Annotated

from qjrl.config import Range, configuration


@configuration
class SolverOptions:
    """Numerical settings of the physics: the settled pose must not depend on any of them."""

    timestep: Annotated[float, Range(low=1e-4, high=0.006)] = 0.004
    """Time step [s]; above 6 ms the strands' stiffness makes the integration chatter."""
    equality_time_constant: Annotated[float, Range(low=0.001, high=0.1)] = 0.008
    """First number of solref of the equality rows [s], at least two time steps."""
    armature_scale: Annotated[float, Range(above=0.0)] = 1.0
    """Factor on every armature."""
    damping_scale: Annotated[float, Range(low=0.1, high=100.0)] = 1.0
    """Factor on the joints' damping: speeds up settling, leaves the equilibrium where it is."""
    solver_iterations: Annotated[int, Range(low=1, high=100)] = 20
    """Newton iterations at most."""
    strand_damping_scale: Annotated[float, Range(low=0.0, high=10.0)] = 1.0
    """Factor on the strands' damping, which leaves the equilibrium where it is, too."""
    lumping: Annotated[int, Range(low=1, high=2)] = 1
    """With 2, strands cross every second joint of a segment twice instead of every joint once, and that joint's slide leads
    the next one's: the coupling hands on what each would have got itself. The same equilibrium with half the tendon
    branches: for settling with little strand damping. With all of it the arm chatters, as the implicit damping of one of
    two equal joints weakens what holds them equal."""
