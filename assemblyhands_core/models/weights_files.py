"""Weights files from elsewhere, held against what they say of themselves before any room is made for a network."""

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import MISSING, fields
from pathlib import Path
from typing import Any, Final, Literal, TypeVar, get_args, get_origin, get_type_hints

import torch
from safetensors import SafetensorError, safe_open
from torch import nn

from assemblyhands_core.data.json_files import FormatError, json_object, kind_of, member

Config = TypeVar("Config")
Network = TypeVar("Network", bound=nn.Module)

_MAX_NUMBER: Final = 1024
_MAX_NUMBERS: Final[Mapping[str, int]] = {"num_voxels": 128, "num_depths": 256, "num_levels": 8, "num_persons": 16}
"""What a network's size may be; four times and more what any network of ours has."""


def read_card(path: Path) -> dict[str, str]:
    """Return what the header of a weights file says, with `network` and `config`.

    Raises:
        FormatError: The file is missing or no safetensors file.
    """
    try:
        with safe_open(path, framework="pt") as file:
            return dict(file.metadata() or {})
    except (OSError, SafetensorError) as error:
        raise FormatError(f"{path}: cannot be read as weights ({error}); get the file again.") from error


def card_entry(card: Mapping[str, str], key: str, path: Path) -> dict[str, Any]:
    """Return the JSON object that a card has under a key.

    Raises:
        FormatError: There is none.
    """
    try:
        value = json.loads(member(card, key, str(path)))
    except RecursionError as error:
        raise FormatError(f"{path}: its {key} is nested without end; get the file again.") from error
    except json.JSONDecodeError as error:
        raise FormatError(f"{path}: its {key} is no JSON ({error}); get the file again.") from error
    return json_object(value, f"{path}: its {key}")


def checked_config(kind: type[Config], values: Mapping[str, Any], where: str) -> Config:
    """Return a config dataclass of what a file says, if every value has the field's type and a sensible size.

    Raises:
        FormatError: One has not, is missing or unknown.
    """
    hints, known = get_type_hints(kind), fields(kind)  # type: ignore[arg-type]
    needed = {field.name for field in known if field.default is MISSING}
    if odd := sorted(set(values) - set(hints) | needed - set(values)):
        raise FormatError(f"{where}: {', '.join(map(kind_of, odd))} is missing or unknown; get the file again.")
    for name, value in values.items():
        if not _fits(value, hints[name], _MAX_NUMBERS.get(name, _MAX_NUMBER)):
            raise FormatError(f"{where}: its {name} is {kind_of(value)}, which no network of ours has.")
    try:
        return kind(**values)
    except ValueError as error:
        raise FormatError(f"{where}: {error}") from error


def built(path: Path, build: Callable[[], Network]) -> Network:
    """Return a network that has the size of a file's weights; arguments and errors as of `check_shapes`."""
    check_shapes(path, build)
    return build()


def check_shapes(path: Path, build: Callable[[], nn.Module]) -> None:
    """Hold the names and shapes of a file's weights against a network's; neither is made room for.

    Args:
        path: The file.
        build: Makes the network.

    Raises:
        FormatError: A weight is missing, of another shape or one too many, or there is no such network.
    """
    try:
        with torch.device("meta"):  # shapes alone, no numbers
            wanted = {name: tuple(tensor.shape) for name, tensor in build().state_dict().items()}
        with safe_open(path, framework="pt") as file:
            found = {name: tuple(file.get_slice(name).get_shape()) for name in file.keys()}  # noqa: SIM118
    except (ArithmeticError, AssertionError, LookupError, RuntimeError, TypeError, ValueError) as error:
        raise FormatError(f"{path}: there is no network as it describes ({error}); get the file again.") from error
    if odd := sorted(name for name in {**wanted, **found} if wanted.get(name) != found.get(name)):
        shapes = f"{found.get(odd[0], 'missing')} instead of {wanted.get(odd[0], 'none')}"
        raise FormatError(f"{path}: {len(odd)} weights are others than its network's, {odd[0][:80]} is {shapes}.")


def _fits(value: object, kind: Any, max_number: int) -> bool:
    if get_origin(kind) is Literal:
        return isinstance(value, str) and value in get_args(kind)
    if get_origin(kind) is tuple:
        return isinstance(value, tuple) and all(map(_fits, value, get_args(kind), [max_number] * len(value)))
    if kind in (int, float) and type(value) in (int, kind):
        return math.isfinite(value) and 0 <= value <= max_number  # type: ignore[arg-type, operator]
    return type(value) is kind
