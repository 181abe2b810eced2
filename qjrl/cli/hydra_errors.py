"""Errors of Hydra and OmegaConf, said in the words of the command."""

from qjrl.artifacts import ArtifactError
from qjrl.cli.values import comma_hint
from qjrl.config import ConfigError, known_names, unknown_key


def in_our_words(error: Exception, overrides: list[str]) -> Exception | None:
    """Hydra's or OmegaConf's error as one of ours; None: it is nothing that the input explains."""
    import yaml
    from hydra.errors import HydraException
    from omegaconf.errors import OmegaConfBaseException

    cause: BaseException | None = error
    while cause is not None:
        if isinstance(cause, (ConfigError, ArtifactError)):
            return cause
        cause = cause.__cause__ or cause.__context__
    known = (HydraException, OmegaConfBaseException, yaml.YAMLError, OSError, ValueError)
    if isinstance(error, known):
        return _readable(error, overrides)
    if _is_raised_by(error, ("hydra", "omegaconf", "antlr4")):  # it meets a value that it did not expect
        return ConfigError(f"{' '.join(overrides)}: Hydra cannot read this ({type(error).__name__}: {error})")
    return None


def _is_raised_by(error: Exception, packages: tuple[str, ...]) -> bool:
    place = error.__traceback__
    while place is not None and place.tb_next is not None:
        place = place.tb_next
    return place is not None and place.tb_frame.f_globals.get("__name__", "").partition(".")[0] in packages


def _readable(error: Exception, overrides: list[str]) -> Exception:
    from hydra.errors import MissingConfigException
    from omegaconf.errors import OmegaConfBaseException

    if isinstance(error, OmegaConfBaseException) and error.full_key:  # of a value that refers to another
        return ConfigError(f"{error.full_key}: {str(error).partition(chr(10))[0]}")
    if isinstance(error, MissingConfigException) and error.options is not None:
        group, _, choice = (error.missing_cfg_file or "").rpartition("/")
        return ConfigError(f"{group}: got '{choice}', {known_names(choice, error.options)}")
    cause = error.__cause__
    if isinstance(cause, OmegaConfBaseException) and cause.full_key and "not in struct" in str(cause):
        values = [value for key, _, value in (text.partition("=") for text in overrides) if cause.full_key in key]
        known = [key for key in getattr(cause.parent_node, "keys", list)() if key != "hydra"]
        return unknown_key(cause.full_key, values[0] if values else None, known)
    text, override = str(error).partition("\nSee http")[0], getattr(error, "override", None)
    if "Ambiguous value" in text:
        several = "several values; add -m (--multirun) to run each of them, or write [a,b] for a list"
        hint = comma_hint(text.partition("'")[2].partition("'")[0].partition("=")[2])
        return ConfigError(f"{override or text.partition(chr(10))[0]}: {several}{hint}")
    if text.startswith("LexerNoViableAlt"):
        return ConfigError(
            f"{override or text}: cannot be read; a value with such letters needs quotes: KEY=\"'VALUE'\""
        )
    return ConfigError(f"{override}: {text}" if override and override not in text else text)
