"""What the user typed, as Hydra's grammar wants it: paths and names need no quotes of Hydra's own."""

import itertools
import re
from collections.abc import Sequence

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException

_SWEEP_FLAGS = {"-m", "--multirun"}
# Hydra's own flags whose value is the next argument, so that a word without = may follow.
_FLAGS_WITH_VALUE = {"--cfg", "-c", "--package", "-p", "--config-path", "-cp", "--config-name", "-cn", "--config-dir"}
_FLAGS_WITH_VALUE |= {"-cd", "--info", "-i"}


def literal(arguments: Sequence[str]) -> list[str]:
    """Return the arguments with every value quoted that Hydra would refuse, or take for a sweep that was not asked for.

    ``seq=one,two`` and ``rig.videos=/my rig (1)/*.mp4`` mean what they say; with ``-m``, which may stand anywhere, a
    comma still separates the values of a sweep.
    """
    quoted = [_literal(argument, is_sweep(arguments)) for argument in arguments]
    return sorted(quoted, key=lambda argument: argument not in _SWEEP_FLAGS)  # Hydra wants its flag before the rest


def is_sweep(arguments: Sequence[str]) -> bool:
    """Return whether a sweep is asked for."""
    return bool(_SWEEP_FLAGS & set(arguments))


def asks_hydra(arguments: Sequence[str]) -> bool:
    """Return whether arguments are more than parameters of ours: flags, a sweep, or settings of Hydra's own."""
    return any(argument.startswith("-") or argument.lstrip("+~").startswith("hydra") for argument in arguments)


def has_values_of_sweep(override: str) -> bool:
    """Return whether an override, as `literal` gives it, stands for several values."""
    return bool(OverridesParser.create().parse_override(override).is_sweep_override())


def stray_word(arguments: Sequence[str]) -> str | None:
    """Return the first argument that is no ``parameter=value`` and no flag."""
    if _FLAGS_WITH_VALUE & set(arguments):
        return None
    return next((a for a in arguments if a.find("=") < 1 and not a.startswith(("-", "~"))), None)


def name_words(arguments: Sequence[str], *parameters: str) -> list[str]:
    """Return the arguments with leading words as values of these parameters: ``A B`` as ``run=A other=B``."""
    words = list(itertools.takewhile(lambda argument: "=" not in argument and not argument.startswith("-"), arguments))
    names = [f"{name}={word}" for name, word in zip(parameters, words, strict=False)]
    return [*names, *arguments[len(names) :]]


def _literal(argument: str, may_sweep: bool) -> str:
    key, sign, value = argument.partition("=")
    if not sign or argument.startswith("-"):
        return argument
    try:
        parsed = OverridesParser.create().parse_override(argument)
        if may_sweep or not parsed.is_sweep_override():
            return argument
    except HydraException:
        pass
    # In Hydra's quotes, backslashes count only before a quote.
    escaped = re.sub(r"(\\*)('|$)", lambda found: found[1] * 2 + ("\\'" if found[2] else ""), value)
    return f"{key}='{escaped}'"
