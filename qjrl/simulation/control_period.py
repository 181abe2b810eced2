"""How many time steps of the physics a control period holds: a whole number, or the period is refused."""

from qjrl.config import ConfigError


def substeps_of(period: float, timestep: float, key: str = "control_period") -> int:
    """Time steps [s] in a control period [s].

    Args:
        key: of the period in the configuration, for the error line.
    Raises:
        ConfigError: the period is no multiple of the time step, so that another period would be played than the one asked for.
    """
    count = round(period / timestep)
    if count < 1 or abs(count * timestep - period) > 1e-9 * period:
        raise ConfigError(
            f"{key}: got {period:g} s, allowed: a multiple of the physics' time step, {timestep:g} s; "
            f"time steps that fit are {_fitting(period, timestep)}"
        )
    return count


def _fitting(period: float, timestep: float) -> str:
    """The two time steps nearest to the one asked for."""
    count = max(1, int(period / timestep))
    return f"{period / count:g} and {period / (count + 1):g} s"
