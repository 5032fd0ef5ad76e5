"""Put a run's page together and write it."""

from collections.abc import Callable, Iterable, Mapping
from functools import partial
from pathlib import Path
from typing import Final

from rich.console import Console

from assemblyhands_core.data.drafts import replaced_whole
from pipeline.finished import FinishedRun
from pipeline.html_report import annotation, instants, joints, making, networks, overview, rounds
from pipeline.html_report.page import Block, Page, sections
from pipeline.terminal import say

FILE: Final = "report.html"
_MAX_COMMAND: Final = 200  # letters of it under the head; provenance has all
_PARTS: Final[Mapping[str, Callable[[FinishedRun], Iterable[Block]]]] = {
    "Summary": overview.summary,
    "Annotation against the truth": annotation.annotation,
    "Error by joint": joints.joints,
    "Sequences": annotation.sequences,
    "Reprojection": rounds.reprojection,
    "From round to round": rounds.displacement,
    "Worst and random hands": instants.instants,
    "Overlays": instants.drawn,
    "Egocentric hands": networks.egocentric,
    "Verbs": networks.verbs,
    "Quality without truth": making.quality,
    "Time and cost": making.times,
    "Provenance": making.provenance,
}


def write_page(console: Console, run: FinishedRun) -> Path:
    """Write a run's ``report/report.html``, say where it is, and return its path."""
    folder = run.folder / "report"
    folder.mkdir(exist_ok=True)
    return save(console, run_page(run), folder / FILE)


def run_page(run: FinishedRun) -> Page:
    """Return the page of a run; of a part that the run has nothing for, a line says why."""
    command, ended, commit = (str(run.record.get(name, "unknown")) for name in ("command", "time", "commit"))
    shown = command if len(command) <= _MAX_COMMAND else f"{command[:_MAX_COMMAND]}…"
    lead = f"Command: `{shown}`. Ended: {ended}. Commit: {commit}."
    return Page(f"Run {run.name}", lead, sections((title, partial(part, run)) for title, part in _PARTS.items()))


def save(console: Console, page: Page, path: Path) -> Path:
    """Write a page whole, and say where it is."""
    with replaced_whole(path) as draft:
        draft.write_text(page.render(), encoding="utf-8")
    say(console, f"report: {path}")
    return path
