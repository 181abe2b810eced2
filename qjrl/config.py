"""Strict configuration: a plain mapping becomes a frozen dataclass, or one line says why it does not.

The dataclass beside the code holds meaning, unit, range, default of every field and where the default comes from; the YAML
files of `conf/` hold what a choice or an experiment has otherwise, see `shipped`.
Field types: int, float, str, bool, Path, dict (left as it is), Literal, tuple, nested dataclasses, ``X | None``,
``Annotated[T, Range(...)]`` for bounds, and unions of dataclasses, see `tagged_union`. A class made by `configuration` holds
its values against them wherever it is made: from YAML, from the command, in Python.
"""

import dataclasses
import functools
import re
import sys
import types
from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, NoReturn, Union, dataclass_transform, get_args, get_origin

from qjrl import machine, plain_yaml
from qjrl.field_words import OneOf as OneOf
from qjrl.field_words import Range, describe, kinds_of, known_names, plain_kind, show
from qjrl.tagged_union import Tags, tags_of
from qjrl.text_file import NotUTF8, read_text


class ConfigError(ValueError):
    """A value of the configuration is not allowed. The message is the one line a user reads."""


@dataclass_transform(frozen_default=True, field_specifiers=(dataclasses.field,))
def configuration[T](cls: type[T]) -> type[T]:
    """Makes a frozen dataclass that refuses what its field types do not allow, whoever makes it.

    A list becomes the tuple and a NumPy number the plain number that the field asks for. `__post_init__` comes afterwards.
    """
    check = cls.__dict__.get("__post_init__", lambda self: None)

    def hold_values(self: Any) -> None:
        kinds = kinds_of(type(self))  # a subclass has more fields
        for field in dataclasses.fields(self):
            value = _convert(getattr(self, field.name), kinds[field.name], f"{cls.__name__}.{field.name}")
            object.__setattr__(self, field.name, value)
        check(self)

    cls.__post_init__ = hold_values  # pyright: ignore[reportAttributeAccessIssue]
    return dataclasses.dataclass(frozen=True)(cls)


def build[T](cls: type[T], mapping: Any, where: str = "") -> T:
    """Builds the (frozen) dataclass `cls` from a plain mapping.

    Args:
        cls: or a union of such classes, see above.
        mapping: field name -> plain value, as YAML gives it; nested mappings for nested dataclasses.
        where: dotted key of `mapping` in the whole configuration, for the error line.
    Raises:
        ConfigError: unknown or missing key, wrong type, value out of range, or a ValueError of `__post_init__`.
    """
    if not (dataclasses.is_dataclass(cls) and isinstance(cls, type)):
        return _convert(mapping, cls, where)
    if not isinstance(mapping, Mapping):
        _refuse(where, mapping, describe(cls))
    kinds = kinds_of(cls)
    fields = {field.name: field for field in dataclasses.fields(cls) if field.init}  # pyright: ignore[reportArgumentType]
    for key in mapping:
        if key not in fields:
            raise unknown_key(_join(where, key), mapping[key], fields)
    for name, field in fields.items():
        if name not in mapping and field.default is field.default_factory is dataclasses.MISSING:
            raise ConfigError(f"{_join(where, name)}: missing, allowed: {describe(kinds[name])}")
    values = {name: _convert(mapping[name], kinds[name], _join(where, name)) for name in fields if name in mapping}
    try:
        return cls(**values)
    except ConfigError:
        raise
    except ValueError as error:
        raise ConfigError(_placed(str(error), where, fields)) from error


@dataclasses.dataclass(frozen=True)
class NotIdentity:
    """Marks a field that cannot change a bit of a result, which is therefore no part of what a result depends on:
    ``Annotated[int, Range(0, 1024), NotIdentity()]``."""

    given: Callable[[Any], bool] = lambda config: True
    """Of the configuration that holds the field: whether that is so."""


def identity_of(value: Any) -> Any:
    """`as_mapping` without the fields that cannot change a result: what is hashed to tell results apart."""
    return _plain(value, lambda config, marks: any(mark.given(config) for mark in marks))


def as_mapping(value: Any) -> Any:
    """The inverse of `build`: nested dataclasses, tuples and paths as plain dicts, lists and strings."""
    return _plain(value, lambda config, marks: False)


def _plain(value: Any, is_left_out: Callable[[Any, list[NotIdentity]], bool]) -> Any:
    if dataclasses.is_dataclass(value):
        marks = _marks(type(value))
        names = [field.name for field in dataclasses.fields(value) if not is_left_out(value, marks[field.name])]
        return {name: _plain(getattr(value, name), is_left_out) for name in names}
    if isinstance(value, Mapping):
        return {str(key): _plain(item, is_left_out) for key, item in value.items()}
    if isinstance(value, (tuple, list)):
        return [_plain(item, is_left_out) for item in value]
    return str(value) if isinstance(value, Path) else value


@functools.cache
def _marks(cls: type) -> dict[str, list[NotIdentity]]:
    """Field name -> its marks."""
    kinds = kinds_of(cls)
    return {name: [mark for mark in get_args(kind) if isinstance(mark, NotIdentity)] for name, kind in kinds.items()}


def read_yaml(path: str | Path) -> dict[str, Any]:
    """The mapping in one YAML file, as `plain_yaml` reads it: 065 is 65, ``no`` is a text, every key stands once.

    Raises:
        ConfigError: the file is missing, is not YAML, or holds something else than a mapping.
        OSError: the disk or the rights are at fault.
    """
    try:
        content = plain_yaml.load(read_text(path))
    except OSError as error:
        if not machine.is_of_input(error):
            raise
        raise ConfigError(f"{path}: cannot be read ({error.strerror}), expected a YAML file") from error
    except NotUTF8 as error:
        raise ConfigError(f"{path}: cannot be read: {error}") from error
    except ValueError as error:  # of plain_yaml, of a path with a zero byte
        raise ConfigError(f"{path}: is not YAML: {' '.join(str(error).split())}") from error
    if not isinstance(content, dict):
        raise ConfigError(f"{path}: holds {show(content)}, expected a mapping of keys to values")
    return content


def read_literal_yaml(path: str | Path) -> dict[str, Any]:
    """`read_yaml` of a file that holds values only: the same for every reader, whoever composes configurations. ~ is the
    home directory.

    Raises:
        ConfigError: see `read_yaml`; or the file has a defaults list or an interpolation such as ``${name}``.
    """
    try:
        content = read_yaml(Path(path).expanduser())
    except RuntimeError as error:
        raise ConfigError(f"{path}: cannot be read ({error})") from error
    if "defaults" in content:
        raise ConfigError(f"{path}: defaults: got a list of files to build on, allowed: the values themselves")
    waiting: list[tuple[str, Any]] = [("", content)]
    while waiting:
        where, value = waiting.pop()
        if isinstance(value, (dict, list)):
            items = value.items() if isinstance(value, dict) else enumerate(value)
            waiting += [(_join(where, key), item) for key, item in items] + [(where, str(key)) for key, _ in items]
        elif isinstance(value, str) and ("${" in value or value == "???"):
            raise ConfigError(f"{path}: {where}: got {show(value)}, allowed: the value itself, no ${{...}} and no ???")
    return content


def is_yaml(name: str) -> bool:
    """Whether a name is that of a YAML file, by its end."""
    return name.lower().endswith((".yaml", ".yml"))


def in_file(name: str, error: ConfigError) -> ConfigError:
    """The error of a robot's value with the file that holds it; any other as it is."""
    return ConfigError(f"{name}: {error}") if str(error).startswith(("robot.", "robot:")) else error


def conf_folder() -> Path:
    """The folder of the shipped YAML files: inside an installed package, beside it in a checkout."""
    package = Path(__file__).parent
    return package / "conf" if (package / "conf").is_dir() else package.parent / "conf"


def shipped[T](cls: type[T], choice: str) -> T:
    """The settings that a choice of the command names, in Python: ``shipped(PolicyConfig, "policy/paper")``.

    Args:
        choice: group and choice; a file of the folder `conf/`, which holds what differs from the defaults.
    Raises:
        ConfigError: there is no such file.
    """
    content = read_yaml(conf_folder() / f"{choice}.yaml")
    return build(cls, {key: value for key, value in content.items() if key != "defaults"}, choice)


def unknown_key(where: str, value: Any, known: Collection[Any]) -> ConfigError:
    """The error for a key that does not exist: what does exist, and what was probably meant."""
    names = known_names(where.rpartition(".")[2], known)
    return ConfigError(f"{where}: got {show(value)}, but there is no such key; {names}")


def _convert(value: Any, kind: Any, where: str) -> Any:
    """`value` as the type `kind`, or a ConfigError."""
    value = (
        value.tolist() if hasattr(value, "tolist") else value
    )  # of NumPy and JAX: the plain number, or lists of them
    kind = plain_kind(kind)
    origin, arguments = get_origin(kind), get_args(kind)
    if origin is Annotated:
        return _bounded(value, kind, where)
    if origin in (Union, types.UnionType):
        return _one_of(value, kind, where)
    if origin is tuple:
        return _tuple(value, kind, where)
    if dataclasses.is_dataclass(kind) and isinstance(kind, type):
        if isinstance(value, kind):  # made in Python
            kind, value = (
                type(value),
                {one.name: getattr(value, one.name) for one in dataclasses.fields(value) if one.init},
            )
        return build(kind, value, where)  # pyright: ignore[reportArgumentType]
    if origin is Literal and any(value == choice and type(value) is type(choice) for choice in arguments):
        return value
    kind = origin or kind
    if kind is dict and isinstance(value, Mapping):
        return dict(value)
    if kind is float and type(value) in (int, float) and abs(value) <= sys.float_info.max:
        return float(value)
    if kind is Path and isinstance(value, (str, Path)) and str(value):
        return Path(value)
    if kind in (int, str, bool, types.NoneType) and type(value) is kind:  # `type is`: a bool is not an int
        return value
    _refuse(where, value, describe(kind if origin is not Literal else Literal[arguments]))


def _bounded(value: Any, kind: Any, where: str) -> Any:
    inner, *bounds = get_args(kind)
    try:
        number = _convert(value, inner, where)
    except ConfigError as error:
        _refuse(where, value, describe(kind), error)
    if number is not None and not all(number in bound for bound in bounds if isinstance(bound, Range)):
        _refuse(where, value, describe(kind))
    return number


def _one_of(value: Any, kind: Any, where: str) -> Any:
    """The class that a mapping names, or the first option that takes the value; the error of the only structured option."""
    options = get_args(kind)
    for option in options:
        if dataclasses.is_dataclass(option) and isinstance(option, type) and isinstance(value, option):
            return _convert(value, option, where)
    if isinstance(value, Mapping) and (tags := tags_of(kind)):
        return build(_named_class(tags, value, where), value, where)
    structured = [option for option in options if get_origin(option) is tuple or dataclasses.is_dataclass(option)]
    for option in options:
        try:
            return _convert(value, option, where)
        except ConfigError:
            if [option] == structured and isinstance(value, (Mapping, list, tuple)):
                raise
    _refuse(where, value, describe(kind))


def _named_class(tags: Tags, value: Mapping[str, Any], where: str) -> type:
    """The class of a union that a mapping means; refuses a key that only another class has with that one's name."""
    named = _join(where, tags.name)
    if tags.name in value:
        chosen = tags.classes[_convert(value[tags.name], Literal[tuple(tags.classes)], named)]
    elif (chosen := tags.default) is None:
        raise ConfigError(f"{named}: missing, allowed: {describe(Literal[tuple(tags.classes)])}")
    for key in value:
        having = [str(tag) for tag, cls in tags.classes.items() if key in kinds_of(cls)]
        if having and key not in kinds_of(chosen):
            raise ConfigError(
                f"{_join(where, key)}: got {show(value[key])}, allowed with {tags.name}={' or '.join(having)}"
            )
    return chosen


def _tuple(value: Any, kind: Any, where: str) -> tuple[Any, ...]:
    arguments = get_args(kind)
    if not isinstance(value, (list, tuple)):
        _refuse(where, value, describe(kind))
    kinds = [arguments[0]] * len(value) if arguments[-1] is Ellipsis else arguments
    if len(kinds) != len(value):
        _refuse(where, value, describe(kind))
    pairs = enumerate(zip(value, kinds, strict=True))
    return tuple(_convert(item, item_kind, f"{where}[{i}]") for i, (item, item_kind) in pairs)


def _join(where: str, key: Any) -> str:
    name = str(key) if str(key).isprintable() else repr(key)
    return f"{where}.{name}" if where else name


def _placed(text: str, where: str, fields: Collection[str]) -> str:
    """The text of a cross-field check under its full key; "length: ..." names the field itself."""
    named = re.match(r"(\w+)[\w.\[\]]*: ", text)
    return _join(where, text) if not where or (named and named[1] in fields) else f"{where}: {text}"


def _refuse(where: str, value: Any, allowed: str, cause: Exception | None = None) -> NoReturn:
    raise ConfigError(f"{where or 'configuration'}: got {show(value)}, allowed: {allowed}") from cause
