"""What the command line prints on, and how it says a sentence there."""

import sys
from typing import Final

from rich.console import Console

_PLAIN_WIDTH: Final = 140  # of tables that go to a file or a pipe


def terminal() -> Console:
    """Return what to print on: tables keep their width in files and pipes."""
    return Console() if sys.stdout.isatty() else Console(width=_PLAIN_WIDTH)


def say(console: Console, sentence: str) -> None:
    """Print a sentence as it stands: brackets are no markup, and paths in it are not broken over lines."""
    console.print(sentence, markup=False, highlight=False, soft_wrap=True)
